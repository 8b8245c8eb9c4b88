"""Identities of recordings and files by content, to match saved results with the data that produced them."""

from __future__ import annotations

import hashlib
import zlib
from pathlib import Path
from typing import Any

from monoloc.errors import DataError
from monoloc.io.recording import Recording


def recording_identity(recording: Recording) -> dict[str, Any]:
    """Identity of a recording, serialisable to JSON.

    It covers name, length, camera, time stamps, poses, and images and depth of the first, middle and last frame.

    Raises:
        DataError: one of these frames cannot be read.
    """
    checked = sorted({0, len(recording) // 2, len(recording) - 1})
    poses = b"" if recording.poses is None else recording.poses.tobytes()
    return {
        "name": recording.name,
        "length": len(recording),
        "camera": repr(recording.camera),
        "times_sha256": hashlib.sha256(recording.timestamps_s.tobytes()).hexdigest(),
        "poses_sha256": hashlib.sha256(poses).hexdigest(),
        "images": [zlib.crc32(recording.color(index).tobytes()) for index in checked],
        "depths": [zlib.crc32(recording.depth(index).tobytes()) for index in checked if recording.has_depth],
    }


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal.

    Raises:
        DataError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "check the path") from error
