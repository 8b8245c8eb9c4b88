"""Reader of RTAB-Map's export: images, depth, a calibration and a pose for each node of the map.

``rtabmap-export --images_id --poses_camera --poses_format 11 X.db`` writes ``X_rgb/ID.jpg``, ``X_depth/ID.png``
(16-bit millimetres, registered, and possibly smaller than colour), ``X_calib/ID.yaml`` and ``X_camera_poses.txt``:
``stamp x y z qx qy qz qw id``, poses of the camera's optical frame, z up in the world. Format 10 has no id. With
``--images`` the files are named by time stamp. Sources: RTAB-Map's ``tools/Export/main.cpp`` and
``corelib/src/CameraModel.cpp``.

Where a calibration has a projection matrix, RTAB-Map takes the images as rectified by it, and so does this reader;
otherwise the distortion coefficients apply.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.distortion import DistortionModel
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_rows, read_text, visible
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.image_cameras import one_camera, stated_by
from monoloc.io.images import ImageRecording, natural_order
from monoloc.io.pose_files import check_increasing, poses_from_quaternions
from monoloc.io.reader_options import ReaderOptions

DEPTH_SCALE = 1000.0
_POSES = "_camera_poses.txt"
_FIX = "export again: rtabmap-export --images_id --poses_camera --poses_format 11 X.db"


def recognises(path: Path) -> bool:
    """Whether a folder contains ``X_rgb`` beside ``X_camera_poses.txt`` or ``X_calib``, or the path is such poses.

    An export without ``--poses_camera`` has no such poses, and :func:`read` asks for them.
    """
    images = visible(path, "_rgb") if path.is_dir() else []
    return bool(_exports(path)) or any(
        each.with_name(each.name.removesuffix("_rgb") + "_calib").is_dir() for each in images
    )


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open the folder of an export, or its ``X_camera_poses.txt`` if the folder holds several.

    Images without a pose, a calibration or depth are left out. Poses without an image are those of nodes between
    images.

    Raises:
        DataError: there is no export or more than one, a file is malformed, or no frame remains.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("rtabmap", "camera", "depth_scale")
    exports = _exports(path)
    if len(exports) != 1:
        raise _not_one_export(path, exports)
    poses_path = exports[0]
    folder, name = poses_path.parent, poses_path.name.removesuffix(_POSES)
    color_paths = sorted(visible(folder / f"{name}_rgb", ".jpg"), key=lambda each: natural_order(each.stem))
    if not color_paths:
        raise DataError(folder / f"{name}_rgb", "has no images", _FIX)
    stems = [each.stem for each in color_paths]
    known, times_s, poses = _poses_of(stems, poses_path)

    frames = FrameFilter(len(stems))
    frames.require(known, "without a pose")
    calibrations = [folder / f"{name}_calib" / f"{stem}.yaml" for stem in stems]
    frames.require([each.is_file() for each in calibrations], "without a calibration")
    depth_paths = [folder / f"{name}_depth" / f"{stem}.png" for stem in stems]
    has_depth = frames.require_if_any([each.is_file() for each in depth_paths], "without depth")
    order = frames.positions(folder, _FIX)
    order = order[np.argsort(times_s[order], kind="stable")]
    check_increasing(times_s[order], poses_path)

    remaining = FrameFilter(len(order))
    camera, cameras = one_camera([_read_camera(calibrations[p]) for p in order], options, remaining)
    chosen = remaining.positions(folder, _FIX)
    used = order[chosen]
    return ImageRecording(
        name=name,
        folder=folder,
        camera=camera,
        frame_names=[stems[p] for p in used],
        timestamps_s=times_s[used],
        poses=poses[used],
        color_paths=[color_paths[p] for p in used],
        depth_paths=[depth_paths[p] for p in used] if has_depth else None,
        depth_scale=options.depth_scale or DEPTH_SCALE,
        cameras=None if cameras is None else [cameras[c] for c in chosen],
        down_world=np.array([0.0, 0.0, -1.0]),
        notes=frames.notes() + remaining.notes(),
    )


def _exports(path: Path) -> list[Path]:
    """Files of camera poses that have images beside them."""
    files = [path] if path.name.endswith(_POSES) else sorted(visible(path, _POSES)) if path.is_dir() else []
    return [file for file in files if file.with_name(file.name.removesuffix(_POSES) + "_rgb").is_dir()]


def _not_one_export(path: Path, exports: list[Path]) -> DataError:
    if exports:
        names = ", ".join(file.name for file in exports)
        return DataError(path, f"holds several exports ({names})", f"give one of them, such as {exports[0]}")
    if not path.exists():
        return DataError(path.absolute(), "does not exist", "check the path")
    if next(path.glob("*_camera_poses_0.txt"), None) is not None:
        return DataError(path, "is an export of several cameras", "map with one camera, or write a dataset.toml")
    if next(path.glob("*_left"), None) is not None:
        return DataError(path, "is an export of a stereo camera", "map with a depth camera, or write a dataset.toml")
    return DataError(path, "has no X_camera_poses.txt beside a folder X_rgb", _FIX)


def _poses_of(stems: list[str], path: Path) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    """Whether each image has a pose (N,), its time stamp (N,) in seconds, and ``T_world_camera`` (N, 4, 4)."""
    rows = read_rows(path, 8, "stamp x y z qx qy qz qw id", optional=1)
    poses = poses_from_quaternions(rows[:, 4:8], rows[:, 1:4], path)
    by_name = {f"{stamp:f}": row for row, stamp in enumerate(rows[:, 0])}
    if rows.shape[1] == 9:
        by_name |= {f"{int(node)}": row for row, node in enumerate(rows[:, 8]) if np.isfinite(node)}
    elif not any(stem in by_name for stem in stems):
        # Format 10 with images named by id: both are sorted by id.
        if len(stems) != len(rows):
            raise DataError(path, f"has {len(rows)} poses without an id for {len(stems)} images", _FIX)
        by_name = {stem: row for row, stem in enumerate(stems)}
    row_of = np.array([by_name.get(stem, -1) for stem in stems])
    return row_of >= 0, rows[row_of, 0], poses[row_of]


def _read_camera(path: Path) -> Camera:
    """Camera of a calibration file of RTAB-Map, which OpenCV's FileStorage wrote."""
    try:
        file = cv2.FileStorage(read_text(path), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        width, height = (file.getNode(key).real() for key in ("image_width", "image_height"))
        k, projection, distortion = (
            _numbers(file.getNode(key)) for key in ("camera_matrix", "projection_matrix", "distortion_coefficients")
        )
    except (cv2.error, SystemError) as error:
        raise DataError(path, "cannot be read as a calibration of RTAB-Map", _FIX) from error
    coefficients, model = ([], "brown") if projection else _lens(distortion, path)
    matrix = projection or k
    if len(matrix) not in (9, 12):
        raise DataError(path, "has no camera_matrix of 9 numbers or projection_matrix of 12", _FIX)
    (fx, cx), (fy, cy) = (matrix[0], matrix[2]), np.reshape(matrix, (3, -1))[1, 1:3].tolist()
    with stated_by(path):
        return Camera(int(width), int(height), fx, fy, cx, cy, tuple(coefficients), model)


def _numbers(node: Any) -> list[float]:
    """Entries of a matrix; none if it is absent."""
    data = node.getNode("data")
    return [data.at(index).real() for index in range(data.size())] if data.isSeq() else []


def _lens(values: list[float], path: Path) -> tuple[list[float], DistortionModel]:
    """Distortion coefficients and their model, which RTAB-Map tells by their number."""
    if not any(values):
        return [], "brown"
    if len(values) in (4, 5):
        return values, "brown"
    if len(values) == 6:  # k1, k2, p1, p2, k3, k4 of a fisheye lens, whose p1 and p2 are not used
        return [*values[:2], *values[4:]], "fisheye"
    if len(values) == 8:
        return values, "rational"
    raise DataError(path, f"has {len(values)} distortion coefficients", "rectify the images before mapping")
