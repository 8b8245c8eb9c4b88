"""Writer of recordings in the ``folder`` format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.files import target_of
from monoloc.io.dataset_description import FILE_NAME
from monoloc.io.recording import Recording, recorded_down, scale_sd_of
from monoloc.io.tum_trajectory import write_tum
from monoloc.partial_files import whole_folder
from monoloc.progress import NoProgress, Progress

_DEPTH_SCALE = 1000.0
_MOST_STORED = 65534  # 65535 marks missing depth


def write_folder(
    folder: Path, recording: Recording, depths: Sequence[NDArray[np.float32]], progress: Progress = NoProgress()
) -> None:
    """Write a recording with poses as PNG images, poses and a ``dataset.toml``, or nothing.

    Args:
        folder: to make; an empty one may exist.
        recording: with poses.
        depths: of its frames, (h, w) metres of the colour images' shape, 0 where unknown; they keep their size.

    Raises:
        DataError: the folder holds files or cannot be written, or a frame cannot be read.
    """
    assert recording.poses is not None
    require_empty(folder)
    try:
        place = target_of(folder)
        with whole_folder(place, is_synced=False) as partial, progress.task("write", len(recording)) as step:
            (partial / "color").mkdir()
            (partial / "depth").mkdir()
            write_tum(partial / "poses.txt", recording.timestamps_s, recording.poses)
            (partial / FILE_NAME).write_text(_description(recording), encoding="utf-8")
            for index, depth_m in enumerate(depths):
                color = np.asarray(cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2BGR), dtype=np.uint8)
                (partial / "color" / f"{index:06d}.png").write_bytes(_png(color))
                (partial / "depth" / f"{index:06d}.png").write_bytes(_png(_stored(depth_m)))
                step(index + 1)
    except OSError as error:
        fix = "make room for it, or name a place you can write to"
        raise DataError(folder, f"cannot be written ({error.strerror})", fix) from error


def require_empty(folder: Path) -> None:
    """Refuse a folder that holds something, before long work starts.

    Raises:
        DataError: it does.
    """
    if folder.is_dir() and any(folder.iterdir()):
        raise DataError(folder, "holds files", "name a new folder")


def _png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def _stored(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    stored = np.round(_DEPTH_SCALE * depth_m)
    return np.where(stored <= _MOST_STORED, stored, 0.0).astype(np.uint16)


def _description(recording: Recording) -> str:
    camera, scale_sd, down = recording.camera, scale_sd_of(recording), recorded_down(recording)
    lines = [
        'kind = "sequence"',
        'color = "color/{index:06d}.png"',
        'depth = "depth/{index:06d}.png"',
        'poses = "poses.txt"',
        f"count = {len(recording)}",
        *(f"{name} = {getattr(camera, name)!r}" for name in ("width", "height", "fx", "fy", "cx", "cy")),
        f'distortion_model = "{camera.distortion_model}"',
        f"distortion = [{', '.join(repr(value) for value in camera.distortion)}]",
        f"depth_scale = {_DEPTH_SCALE:g}",
        *([] if scale_sd is None else [f"scale_sd = {scale_sd!r}"]),
        *([] if down is None else [f"down = {down.tolist()!r}"]),
    ]
    return "\n".join([*lines, ""])
