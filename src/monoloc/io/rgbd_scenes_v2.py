"""Reader of RGB-D Scenes v2 (Lai, Bo and Fox, ICRA 2014): 14 furnished rooms, PrimeSense RGB-D.

Layout: ``ROOT/imgs/scene_NN/NNNNN-color.png``, ``NNNNN-depth.png`` and ``ROOT/pc/NN.pose``. Line i of the pose file
is the camera-to-world pose of frame i, ``qw qx qy qz tx ty tz``. Depth is registered to colour.

Public loaders disagree on two numbers:

- **Depth scale**: this reader uses 10000 per metre. Loaders that divide by 1000 follow the older RGB-D Object
  Dataset, which is in millimetres. deep-video-mvs exports with 10000, and its author confirmed this with fused
  clouds (ardaduz/deep-video-mvs, issue 8). Stored depth reaches 3e4 (a loader that scales by the largest value uses
  29842). With 10000 this is 3 m, as in the rooms' clouds; with 1000 it is 30 m, beyond the range of the sensor.
- **Focal length**: this reader uses 570.3 pixels and the principal point (320, 240), as do ``depthtocloud.m`` by the
  second author of the data set and most loaders. 525 is ROS's default for such sensors. 3DMatch's repackaging uses
  540.02 for all its PrimeSense recordings.

``ReaderOptions.depth_scale`` and ``ReaderOptions.camera`` override these numbers.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.io.file_access import read_rows, require_file, require_folder
from monoloc.io.images import ImageRecording
from monoloc.io.pose_files import poses_from_quaternions
from monoloc.io.reader_options import ReaderOptions

DEPTH_SCALE = 10000.0
CAMERA = Camera(width=640, height=480, fx=570.3, fy=570.3, cx=320.0, cy=240.0)
FRAME_RATE_HZ = 30.0

_COLOR_NAME = re.compile(r"(\d+)-color\.png")
_SCENE_NAME = re.compile(r"scene_(\d+)")


def recognises(path: Path) -> bool:
    """Whether a folder contains ``NNNNN-color.png`` files or ``imgs/scene_NN`` folders."""
    return path.is_dir() and bool(next(path.glob("*-color.png"), None) or _scene_folders(path))


def read_pose_file(path: Path) -> NDArray[np.float64]:
    """Read the poses ``T_world_camera`` of a ``.pose`` file (``qw qx qy qz tx ty tz`` per line): (N, 4, 4).

    Raises:
        DataError: the file is missing or malformed, a value is not finite, or a quaternion does not have unit length.
    """
    require_file(path, "put the data set's .pose files into ROOT/pc beside ROOT/imgs")
    rows = read_rows(path, 7, "qw qx qy qz tx ty tz")
    return poses_from_quaternions(rows[:, [1, 2, 3, 0]], rows[:, 4:], path)


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open ``ROOT/imgs/scene_NN``, or ROOT if it contains one scene.

    Raises:
        DataError: there is no scene or more than one, there are no frames, a frame has no depth or pose, or an image
            has another size.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("rgbd-scenes-v2", "camera", "depth_scale")
    require_folder(path)
    folder = _only_scene(path)
    scene = _SCENE_NAME.fullmatch(folder.resolve().name)
    if scene is None:
        raise DataError(folder, "is not named scene_NN", "give ROOT/imgs/scene_NN")
    matches = sorted((int(m[1]), p) for p in folder.iterdir() if (m := _COLOR_NAME.fullmatch(p.name)))
    if not matches:
        raise DataError(folder, "has no NNNNN-color.png images", "unpack the data set's images there")
    numbers = [number for number, _ in matches]
    color_paths = [color_path for _, color_path in matches]
    depth_paths = [p.with_name(p.name.replace("-color", "-depth")) for p in color_paths]
    for depth_path in depth_paths:
        require_file(depth_path, "restore it or remove the frame's colour image")

    pose_path = folder.resolve().parent.parent / "pc" / f"{scene[1]}.pose"
    poses = read_pose_file(pose_path)
    if numbers[-1] >= len(poses):
        raise DataError(
            pose_path, f"has {len(poses)} poses, but frame {numbers[-1]} exists", "use this scene's own .pose"
        )
    return ImageRecording(
        name=folder.resolve().name,
        folder=folder,
        camera=options.camera_or(CAMERA),
        frame_names=[p.name.removesuffix("-color.png") for p in color_paths],
        timestamps_s=np.array(numbers) / FRAME_RATE_HZ,
        poses=poses[numbers],
        color_paths=color_paths,
        depth_paths=depth_paths,
        depth_scale=options.depth_scale or DEPTH_SCALE,
    )


def _scene_folders(root: Path) -> list[Path]:
    return sorted(p for p in root.glob("imgs/scene_*") if p.is_dir())


def _only_scene(path: Path) -> Path:
    scenes = _scene_folders(path)
    if len(scenes) > 1:
        known = ", ".join(p.name for p in scenes)
        raise DataError(path, f"holds several scenes ({known})", f"give one of them, such as {scenes[0]}")
    return scenes[0] if scenes else path
