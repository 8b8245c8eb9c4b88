"""Reader of nerfstudio's ``transforms.json``, which ``ns-process-data`` and other tools write.

Poses ``transform_matrix`` are camera to world with OpenGL's camera axes. Intrinsics ``fl_x, fl_y, cx, cy, w, h`` and
``k1, k2, k3, k4, p1, p2`` are stated once or for each frame, with the centre of the top-left pixel at (0.5, 0.5).
Files of instant-ngp and Blender may state the horizontal field of view ``camera_angle_x`` in radians in place of the
intrinsics, and name .png images without their suffix.
``depth_file_path`` is optional, in millimetres by default. NeRFCapture and instant-ngp name it ``depth_path``, and
``integer_depth_scale`` is then the metres of a stored one. The unit of poses that COLMAP found is arbitrary, and so
is that of depth from its points. Where poses were scaled by ``applied_scale``, this is undone; ``applied_transform``
turns the world, and stays. Sources: nerfstudio's ``nerfstudio_dataparser.py``, and its documentation, *Data
conventions*; instant-ngp's ``nerf_loader.cu``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from monoloc.camera import Camera
from monoloc.distortion import DistortionModel
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import json_number, json_rows, read_bytes, read_json, require_file, require_folder
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.image_cameras import one_camera, stated_by
from monoloc.io.image_files import checked_header
from monoloc.io.images import ImageRecording, names_of, natural_order
from monoloc.io.pose_files import OPENGL_AXES, UNTIMED, UNTIMED_RATE_HZ, checked_poses
from monoloc.io.reader_options import ReaderOptions, depth_scale_problem
from monoloc.io.recording import Remark

FILE_NAME = "transforms.json"
DEPTH_SCALE = 1000.0
_PERSPECTIVE = ("OPENCV", "PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
_INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy")
_CENTRED = "cx and cy are not stated; the optical axis is taken to be in the centre of the image"
_SCALE = Remark(
    "the poses' unit is taken to be one metre; if COLMAP found them, it is not: scale its model with colmap "
    "model_aligner, and give that"
)
_OF_COLMAP = "colmap_im_id"  # in a frame's entry: ns-process-data, of COLMAP's poses; of a phone's it writes none
_METRES = "integer_depth_scale"
_LEAST_SCALE = 1e-6
_AGAIN = "run ns-process-data again"
_NO_IMAGES = "copy the images to where it says, or correct file_path"


def recognises(path: Path) -> bool:
    """Whether the path is a ``transforms.json``, or a folder that contains one."""
    return path.name == FILE_NAME or (path / FILE_NAME).is_file()


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open a ``transforms.json`` or its folder. Frames are sorted by name; they have no times.

    Frames without an image file are left out, and so are those without depth if others have it.

    Raises:
        DataError: the file is malformed, a pose is not rigid, the camera model is unknown, or no frame remains.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("nerfstudio", "camera", "depth_scale")
    file = path if path.name == FILE_NAME else path / FILE_NAME
    require_folder(file.parent)
    require_file(file, f"give a {FILE_NAME} or its folder")
    content = read_json(file)
    entries = _frames(content, file)
    color_paths = [_color_path(entry, file.parent) for entry in entries]
    frames = FrameFilter(len(entries))
    frames.require([each.is_file() for each in color_paths], "without an image")
    depth_paths = [_depth_path(entry, file.parent) for entry in entries]
    has_depth = frames.require_if_any([each is not None for each in depth_paths], "without depth")
    shared, is_centred = _completed(content, color_paths[frames.positions(file, _NO_IMAGES)[0]], file)
    camera, cameras = one_camera([_camera(shared | entry, file) for entry in entries], options, frames)
    used = frames.positions(file, _NO_IMAGES)
    used_color_paths = [color_paths[p] for p in used]
    is_metric = has_depth and not any(_OF_COLMAP in entry for entry in entries)
    return ImageRecording(
        name=file.resolve().parent.name,
        folder=file.parent,
        camera=camera,
        frame_names=names_of(used_color_paths, file.parent),
        timestamps_s=np.arange(len(used)) / UNTIMED_RATE_HZ,
        poses=_poses(content, entries, file)[used],
        color_paths=used_color_paths,
        depth_paths=[each for p in used if (each := depth_paths[p]) is not None] if has_depth else None,
        depth_scale=options.depth_scale or _depth_scale(content, file),
        cameras=None if cameras is None else [cameras[p] for p in used],
        notes=[
            *frames.notes(),
            *([_CENTRED] if is_centred and options.camera is None else []),
            *([UNTIMED] if is_metric else [UNTIMED, _SCALE]),
        ],
    )


def _frames(content: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    """Entries of ``frames``, sorted by name."""
    entries = content.get("frames")
    if not isinstance(entries, list) or not entries:
        raise DataError(path, "has no list of frames", _AGAIN)
    for number, entry in enumerate(entries):
        if not isinstance(entry, dict) or not isinstance(entry.get("file_path"), str):
            raise DataError(path, f"entry {number} of frames has no file_path", _AGAIN)
    return sorted(entries, key=lambda entry: natural_order(entry["file_path"]))


def _color_path(entry: dict[str, Any], folder: Path) -> Path:
    name: str = entry["file_path"]
    path = folder / name
    return path if path.suffix or path.is_file() else path.with_name(f"{path.name}.png")


def _depth_path(entry: dict[str, Any], folder: Path) -> Path | None:
    name = entry.get("depth_file_path", entry.get("depth_path"))
    path = folder / name if isinstance(name, str) else None
    return path if path is not None and path.is_file() else None


def _depth_scale(content: dict[str, Any], path: Path) -> float:
    """Stored depth value of one metre."""
    if _METRES not in content:
        return DEPTH_SCALE
    metres = json_number(content, _METRES, path)
    if metres <= 0.0 or depth_scale_problem(1.0 / metres) is not None:
        raise DataError(path, f"{_METRES} is {metres!r}, that of no program", "give --depth-scale")
    return 1.0 / metres


def _poses(content: dict[str, Any], entries: list[dict[str, Any]], path: Path) -> FloatArray:
    """``T_world_camera`` of all frames, (N, 4, 4)."""
    names = [entry["file_path"] for entry in entries]
    matrices = []
    for entry, name in zip(entries, names, strict=True):
        matrix = np.eye(4)
        rows = json_rows(entry, "transform_matrix", 4, path)
        if len(rows) not in (3, 4):
            raise DataError(path, f"transform_matrix of {name} has {len(rows)} rows", _AGAIN)
        matrix[: len(rows)] = rows
        matrices.append(matrix)
    poses = np.stack(matrices)
    if "applied_scale" in content:
        scale = json_number(content, "applied_scale", path)
        if not _LEAST_SCALE <= scale <= 1.0 / _LEAST_SCALE:
            raise DataError(path, f"applied_scale is {scale!r}, that of no program", _AGAIN)
        poses[:, :3, 3] /= scale
    return checked_poses(poses, [path] * len(names), names) @ OPENGL_AXES


def _completed(content: dict[str, Any], image: Path, path: Path) -> tuple[dict[str, Any], bool]:
    """What is stated for all frames, with the intrinsics of a field of view in place of those that are not stated.

    Returns:
        This content, and whether the principal point is taken to be in the centre.
    """
    if "camera_angle_x" not in content or "fl_x" in content:
        return content, False
    header = checked_header(read_bytes(image), image)
    stated = {"w": header.width, "h": header.height} | content
    width, height = (json_number(stated, key, path) for key in ("w", "h"))
    fl_x = _focal_px(content, "camera_angle_x", width, path)
    fl_y = _focal_px(content, "camera_angle_y", height, path) if "camera_angle_y" in content else fl_x
    implied = {"fl_x": fl_x, "fl_y": fl_y, "cx": width / 2.0, "cy": height / 2.0}
    return implied | stated, not {"cx", "cy"} <= content.keys()


def _focal_px(content: dict[str, Any], key: str, size: float, path: Path) -> float:
    """Focal length of a field of view, radians, over a side of the image, pixels."""
    angle_rad = json_number(content, key, path)
    if not 0.0 < angle_rad < np.pi:
        raise DataError(path, f"{key} is {angle_rad!r}, no field of view", "write it in radians")
    return float(0.5 * size / np.tan(0.5 * angle_rad))


def _camera(entry: dict[str, Any], path: Path) -> Camera:
    """Camera of a frame's entry, completed by what is stated for all frames."""
    missing = [key for key in _INTRINSICS if key not in entry]
    if missing:
        raise DataError(path, f"{missing[0]} is missing", f"write {', '.join(_INTRINSICS)}, or camera_angle_x")
    model, distortion = _lens(entry, path)
    with stated_by(path):
        return Camera(
            int(json_number(entry, "w", path)),
            int(json_number(entry, "h", path)),
            json_number(entry, "fl_x", path),
            json_number(entry, "fl_y", path),
            json_number(entry, "cx", path) - 0.5,
            json_number(entry, "cy", path) - 0.5,
            distortion,
            model,
        )


def _lens(entry: dict[str, Any], path: Path) -> tuple[DistortionModel, tuple[float, ...]]:
    name = entry.get("camera_model", "OPENCV")
    k1, k2, k3, k4, p1, p2 = (
        json_number({key: 0.0} | entry, key, path) for key in ("k1", "k2", "k3", "k4", "p1", "p2")
    )
    if name in _FISHEYE or entry.get("is_fisheye") is True:
        return "fisheye", (k1, k2, k3, k4)
    if name not in _PERSPECTIVE or k4 != 0.0:
        problem = f"camera_model is {name!r}" if name not in _PERSPECTIVE else f"k4 is {k4!r} in a model without it"
        raise DataError(
            path, problem, f"undistort the images (colmap image_undistorter), or use one of {', '.join(_PERSPECTIVE)}"
        )
    return "brown", (k1, k2, p1, p2, k3)
