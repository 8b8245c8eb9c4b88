"""Reader of image folders that a ``dataset.toml`` describes: a sequence, or unposed pairs.

::

    kind = "sequence"                 # or "pairs": unrelated images with depth and without poses
    color = "color/{index:06d}.jpg"   # pattern, relative to dataset.toml
    depth = "depth/{index:06d}.png"   # optional for a sequence
    count = 400                       # or stop; defaults: start = 0, step = 1. Without both: the images that exist
    width = 640                       # size of the colour images
    height = 480
    fx = 525.0
    fy = 525.0
    cx = 319.5
    cy = 239.5
    distortion = [0, 0, 0, 0, 0]      # optional: k1, k2, p1, p2, k3 of the stored images
    distortion_model = "brown"        # or "rational" (8 coefficients) or "fisheye" (4)
    depth_scale = 1000                # stored value of one metre; required with depth
    poses = "poses.txt"               # for a sequence: one line per frame, t tx ty tz qx qy qz qw (TUM);
                                      # or a pattern of 4x4 matrices (.txt, .npy), with rate_hz
    rate_hz = 30                      # frame rate of a sequence whose poses have no times, or without poses

Optional, with their defaults: ``pose_axes = "opencv"`` (or ``"opengl"``), ``pose_direction = "camera-to-world"`` (or
``"world-to-camera"``) and ``pose_unit_m = 1``; ``confidence``, a pattern, with ``least_confidence``; ``depth_width``
to ``depth_cy`` of a depth camera of its own, with ``T_color_depth``; ``scale_sd``, the relative standard deviation of
the scale of poses and depth, where ``monoloc reconstruct`` found them; ``down``, the direction of gravity in the
world of the poses, such as ``[0, 0, -1]`` where z is up: images that lie on their side are then turned upright.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert
from monoloc.io.dataset_description import FILE_NAME, DatasetDescription
from monoloc.io.file_access import require_file, require_folder
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.images import ImageRecording, names_of
from monoloc.io.pose_files import OPENGL_AXES, checked_poses, read_matrix_pose, read_tum_with_gaps
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import LEAST_RATE_HZ, MOST_RATE_HZ
from monoloc.io.registration import DepthRegistration

_LEAST_UNIT_M, _MOST_UNIT_M = 1e-6, 1e6
_UNPOSED = "without a pose"


def recognises(path: Path) -> bool:
    """Whether the path is a ``dataset.toml``, or a folder that contains one."""
    return path.name == FILE_NAME or (path / FILE_NAME).is_file()


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open the recording that a ``dataset.toml`` describes; ``path`` is that file or its folder.

    Frames without a pose are left out if the others have one. Where the frames are not stated by ``count`` or
    ``stop``, they are those of the colour images that exist, and frames without a depth image are left out. Pairs
    have no poses, and their time stamps are frame numbers.

    Raises:
        DataError: a key is missing, unknown, of a wrong type or inconsistent with the files, or a pose is not rigid.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("folder", "camera", "depth_scale")
    folder = path.parent if path.name == FILE_NAME else path
    require_folder(folder)
    description = DatasetDescription(folder / FILE_NAME)
    if not description.has("kind"):
        raise description.error("kind", "is missing")
    kind = description.choice("kind", "sequence", "pairs")
    indices = description.indices()
    frames = FrameFilter(len(indices))
    color_paths = description.existing_paths("color", indices)
    has_depth = kind == "pairs" or description.has("depth")
    depth_paths = _depth_paths(description, indices, frames) if has_depth else None

    timestamps_s, poses = np.arange(len(indices), dtype=np.float64), None
    if kind == "sequence":
        timestamps_s, poses = _times_and_poses(description, indices, frames)
    used = frames.positions(description.path, "correct depth and poses, or restore the files")
    used_color_paths = [color_paths[p] for p in used]
    camera = options.camera_or(description.camera())
    return ImageRecording(
        name=folder.resolve().name,
        folder=folder,
        camera=camera,
        frame_names=names_of(used_color_paths, folder),
        timestamps_s=timestamps_s[used],
        poses=None if poses is None else poses[used],
        color_paths=used_color_paths,
        depth_paths=None if depth_paths is None else [depth_paths[p] for p in used],
        depth_scale=options.depth_scale or (description.number("depth_scale") if has_depth else 1.0),
        registration=_registration(description, camera),
        confidence_paths=(
            description.existing_paths("confidence", [indices[p] for p in used])
            if description.has("confidence")
            else None
        ),
        least_confidence=description.integer("least_confidence") if description.has("confidence") else 0,
        scale_sd=description.positive("scale_sd") if description.has("scale_sd") else None,
        down_world=description.down(),
        notes=frames.notes(),
    )


def _depth_paths(description: DatasetDescription, indices: list[int], frames: FrameFilter) -> list[Path]:
    if description.states_frames:
        return description.existing_paths("depth", indices)
    paths = description.paths("depth", indices)
    frames.require([path.is_file() for path in paths], "without depth")
    return paths


def _registration(description: DatasetDescription, color_camera: Camera) -> DepthRegistration | None:
    depth_camera = description.depth_camera()
    if depth_camera is None:
        return None
    return DepthRegistration(depth_camera, color_camera, description.T_color_depth())


def _times_and_poses(
    description: DatasetDescription, indices: list[int], frames: FrameFilter
) -> tuple[FloatArray, FloatArray | None]:
    """Time stamps (N,) and ``T_world_camera`` (N, 4, 4) of a sequence; leaves out frames without a pose."""
    if not description.has("poses"):
        return _times_by_rate(description, indices), None
    unit_m = description.positive("pose_unit_m") if description.has("pose_unit_m") else 1.0
    if not _LEAST_UNIT_M <= unit_m <= _MOST_UNIT_M:
        raise description.error("pose_unit_m", f"is {unit_m:g}, the unit of no program")
    if "{" in description.text("poses"):
        times_s = _times_by_rate(description, indices)
        known, poses = _poses_of_files(description, indices, unit_m)
    else:
        times_s, known, poses = _poses_of_one_file(description, indices, unit_m)
    frames.require(known, _UNPOSED)
    if description.choice("pose_direction", "camera-to-world", "world-to-camera") == "world-to-camera":
        poses = invert(poses)
    if description.choice("pose_axes", "opencv", "opengl") == "opengl":
        poses = poses @ OPENGL_AXES
    return times_s, poses


def _times_by_rate(description: DatasetDescription, indices: list[int]) -> FloatArray:
    """Time stamps (N,) from the frame rate, with the gaps of the numbering."""
    if not description.has("rate_hz"):
        if description.has("poses"):
            raise description.error("rate_hz", "is missing; files of one pose each have no times")
        raise description.error(
            "poses", "is missing, and so is rate_hz, which takes its place where there are no poses"
        )
    numbers = (np.array(indices, dtype=np.float64) - indices[0]) / description.step()
    rate_hz = description.positive("rate_hz")
    if not LEAST_RATE_HZ <= rate_hz <= MOST_RATE_HZ:
        raise description.error("rate_hz", f"is {rate_hz:g}, the rate of no camera")
    return np.asarray(numbers / rate_hz)


def _poses_of_one_file(
    description: DatasetDescription, indices: list[int], unit_m: float
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Time stamps (N,), whether the pose is known (N,), and the poses (N, 4, 4)."""
    path = description.path.parent / description.text("poses")
    require_file(path, f"write it, or correct poses in {FILE_NAME}")
    times_s, known, poses = read_tum_with_gaps(path, unit_m)
    if len(poses) != len(indices):
        problem = f"has {len(poses)} poses for {len(indices)} frames"
        missing = description.paths("color", description.left_out(indices))
        if missing:
            more = f", as {len(missing) - 1} more of the sequence" if len(missing) > 1 else ""
            fix = f"restore what is missing, or delete its line of {path.name}"
            raise DataError(missing[0], f"is missing{more}, and {path.name} {problem}", fix)
        raise DataError(
            path,
            problem,
            "write one line for each frame, with nan in place of an unknown pose's seven numbers; or give rate_hz "
            f"instead of poses in {FILE_NAME}, and a build finds the poses",
        )
    return times_s, known, poses


def _poses_of_files(
    description: DatasetDescription, indices: list[int], unit_m: float
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Whether each frame has a file with a finite pose (N,), and the poses (N, 4, 4)."""
    paths = description.paths("poses", indices)
    poses = np.tile(np.eye(4), (len(indices), 1, 1))
    known = np.zeros(len(indices), dtype=np.bool_)
    for position, path in enumerate(paths):
        if path.is_file():
            matrix = read_matrix_pose(path)
            known[position] = np.isfinite(matrix).all()
            poses[position] = matrix if known[position] else np.eye(4)
    poses[:, :3, 3] *= unit_m
    return known, checked_poses(poses, paths, [path.stem for path in paths])
