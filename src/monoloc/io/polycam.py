"""Reader of Polycam's raw data (iPhone or iPad with LiDAR, developer mode): images, depth and poses of keyframes.

Layout: ``keyframes/{images,depth,confidence,cameras}/STAMP.{jpg,png,png,json}``, and ``corrected_images`` with
``corrected_cameras`` where Polycam optimised the poses; these are used if they are there. A camera file holds ``fx,
fy, cx, cy, width, height`` and ``t_00`` to ``t_23``, camera to world by rows, with OpenGL's camera axes and y up in
the world. STAMP is in microseconds. Depth is 16-bit millimetres of the same field of view as colour, and confidence
is 0, 127 or 255.

Only depth of the highest confidence is used, for the reason in :mod:`monoloc.io.stray_scanner`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import json_number, read_json, require_folder, visible
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.image_cameras import one_camera, stated_by
from monoloc.io.images import ImageRecording
from monoloc.io.pose_files import DOWN_OF_ARKIT, OPENGL_AXES, checked_poses
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.stray_scanner import NO_CONFIDENCE

DEPTH_SCALE = 1000.0
HIGH_CONFIDENCE = 255
_AGAIN = "export the raw data from Polycam again, with developer mode on"


def recognises(path: Path) -> bool:
    """Whether a folder is, or contains, ``keyframes`` with cameras or images; :func:`read` asks for cameras."""
    folder = _keyframes(path)
    return folder.resolve().name == "keyframes" and any(
        (folder / f"{prefix}{name}").is_dir() for prefix in ("", "corrected_") for name in ("cameras", "images")
    )


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open the folder that contains ``keyframes``, or that folder. Frames without an image or depth are left out.

    Raises:
        DataError: there are no camera files, one is malformed, or no frame remains.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("polycam", "camera", "depth_scale")
    require_folder(path)
    folder = _keyframes(path)
    is_corrected = all((folder / name).is_dir() for name in ("corrected_cameras", "corrected_images"))
    prefix = "corrected_" if is_corrected else ""
    files = sorted(visible(folder / f"{prefix}cameras", ".json"), key=_stamp)
    if not files:
        raise DataError(folder, f"has no {prefix}cameras/STAMP.json", _AGAIN)
    stamps = [_stamp(file) for file in files]
    cameras, matrices = zip(*(_read_camera(file) for file in files), strict=True)
    poses = checked_poses(np.stack(matrices), files, [file.stem for file in files]) @ OPENGL_AXES

    frames = FrameFilter(len(files))
    color_paths = [folder / f"{prefix}images" / f"{file.stem}.jpg" for file in files]
    frames.require([each.is_file() for each in color_paths], "without an image")
    depth_paths = [folder / "depth" / f"{file.stem}.png" for file in files]
    has_depth = frames.require_if_any([each.is_file() for each in depth_paths], "without depth")
    confidence_paths = [folder / "confidence" / f"{file.stem}.png" for file in files]
    with_confidence = [each.is_file() for each in confidence_paths]
    has_confidence = has_depth and frames.require_if_any(with_confidence, "without confidence")
    camera, own_cameras = one_camera(cameras, options, frames)
    used = frames.positions(folder, _AGAIN)
    return ImageRecording(
        name=folder.resolve().parent.name,
        folder=folder,
        camera=camera,
        frame_names=[files[p].stem for p in used],
        timestamps_s=np.array([1e-6 * stamps[p] for p in used]),
        poses=poses[used],
        color_paths=[color_paths[p] for p in used],
        depth_paths=[depth_paths[p] for p in used] if has_depth else None,
        depth_scale=options.depth_scale or DEPTH_SCALE,
        confidence_paths=[confidence_paths[p] for p in used] if has_confidence else None,
        least_confidence=HIGH_CONFIDENCE,
        cameras=None if own_cameras is None else [own_cameras[p] for p in used],
        down_world=DOWN_OF_ARKIT,
        notes=[*frames.notes(), *([NO_CONFIDENCE] if has_depth and not has_confidence else [])],
    )


def _keyframes(path: Path) -> Path:
    return path / "keyframes" if (path / "keyframes").is_dir() else path


def _stamp(file: Path) -> int:
    """Microseconds in a file's name."""
    if not (file.stem.isascii() and file.stem.isdigit()):
        raise DataError(file, "is not named by a time in microseconds", _AGAIN)
    return int(file.stem)


def _read_camera(path: Path) -> tuple[Camera, FloatArray]:
    """Intrinsics, and the camera-to-world matrix (4, 4) with OpenGL's axes."""
    content = read_json(path)
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    width, height, fx, fy, cx, cy = (json_number(content, key, path) for key in keys)
    matrix = np.eye(4)
    matrix[:3] = [[json_number(content, f"t_{row}{column}", path) for column in range(4)] for row in range(3)]
    with stated_by(path):
        return Camera(int(width), int(height), fx, fy, cx, cy), matrix
