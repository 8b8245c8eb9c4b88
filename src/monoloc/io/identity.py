"""What recordings and files are by their content, so that work on them is known again, and work on others is not."""

from __future__ import annotations

import hashlib
import zlib
from pathlib import Path
from typing import Any

from monoloc.errors import DataError
from monoloc.io.recording import Recording


def recording_identity(recording: Recording) -> dict[str, Any]:
    """What a recording is, ready for JSON: camera, times, poses, and its first, middle and last frame.

    Raises:
        DataError: one of those frames cannot be read.
    """
    looked_at = sorted({0, len(recording) // 2, len(recording) - 1})
    poses = b"" if recording.poses is None else recording.poses.tobytes()
    return {
        "name": recording.name,
        "length": len(recording),
        "camera": repr(recording.camera),
        "times_sha256": hashlib.sha256(recording.timestamps_s.tobytes()).hexdigest(),
        "poses_sha256": hashlib.sha256(poses).hexdigest(),
        "images": [zlib.crc32(recording.color(index).tobytes()) for index in looked_at],
        "depths": [zlib.crc32(recording.depth(index).tobytes()) for index in looked_at if recording.has_depth],
    }


def file_sha256(path: Path) -> str:
    """Of a file's content.

    Raises:
        DataError: it cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "check the path") from error
