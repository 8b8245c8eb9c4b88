"""Reader of 7-Scenes (Shotton et al., CVPR 2013): Kinect RGB-D with KinectFusion poses.

Layout: ``SCENE/seq-NN/frame-NNNNNN.{color.png|color.jpg, depth.png, pose.txt}``. Depth is 16-bit millimetres; 0 and
65535 mean no depth. A pose is the 4x4 camera-to-world matrix of the depth camera.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.geometry import invert, make_pose, nearest_rotation
from monoloc.io.file_access import read_rows, require_folder
from monoloc.io.images import ImageRecording
from monoloc.io.pose_files import checked_poses, read_matrix_pose
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registration import DepthRegistration

FRAME_RATE_HZ = 30.0
_SEQUENCE_GAP_S = 1.0  # between sequences, so that time stamps increase over the whole scene

# Colour and depth come from two cameras. The data set states the focal length of the depth camera. That of the colour
# camera was estimated by structure from motion on RedKitchen's 7,000 training images. Its radial distortion was
# chosen so that corners tracked through RedKitchen seq-01 (every second frame, 0 to 398) rotate as the given poses
# do. It reduces the rotation error of visual odometry over 100 frames from 4.0 to 1.8 degrees.
COLOR_CAMERA = Camera(
    width=640, height=480, fx=525.5, fy=525.5, cx=320.0, cy=240.0, distortion=(-0.08, 0.0, 0.0, 0.0, 0.0)
)
DEPTH_CAMERA = Camera(width=640, height=480, fx=585.0, fy=585.0, cx=320.0, cy=240.0)

# Calibration of another Kinect that DSAC* and ACE use for 7-Scenes:
# https://projet.liris.cnrs.fr/voir/activities-dataset/kinect-calibration.html
_PUBLISHED = np.array(
    [
        [0.99996518, 0.00267651, -0.00790410, -0.02555894],
        [-0.00274093, 0.99996303, -0.00815045, 0.00010110],
        [0.00788199, 0.00817183, 0.99993554, 0.00203183],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
# Eight digits give the rotation an error of 1e-8. An exact rotation makes inverses exact.
T_COLOR_DEPTH = make_pose(nearest_rotation(_PUBLISHED[:3, :3]), _PUBLISHED[:3, 3])

_COLOR_NAME = re.compile(r"frame-(\d+)\.color\.(png|jpg)")
_SEQUENCE_NAME = re.compile(r"seq-\d+")


def recognises(path: Path) -> bool:
    """Whether a folder is a ``seq-NN`` folder or contains some."""
    return path.is_dir() and bool(_sequence_folders(path) or next(path.glob("frame-*.color.*"), None))


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open a scene folder (all its sequences, in order) or one sequence folder.

    Depth is registered to the colour camera, and the poses are those of the colour camera,
    ``T_world_color = T_world_depth @ inv(T_color_depth)``. A ``camera-intrinsics.txt`` (3x3) in the scene folder
    replaces the intrinsics of the depth camera. The recording has no depth if no frame has a depth image, and no
    poses if no frame has a pose file.

    Raises:
        DataError: there are no frames, a frame lacks depth or a pose that others have, a pose is not rigid, or images
            have another size.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("7scenes", "camera", "depth_scale")
    require_folder(path)
    folders = _sequence_folders(path) or [path]
    color_paths: list[Path] = []
    times_s: list[float] = []
    for folder in folders:
        start_s = times_s[-1] + _SEQUENCE_GAP_S if times_s else 0.0
        frames = _frames(folder)
        color_paths += frames.values()
        times_s += [start_s + number / FRAME_RATE_HZ for number in frames]
    stems = [p.name.split(".")[0] for p in color_paths]
    # Names include the sequence, so that they are the same if one sequence is opened.
    names = [f"{p.absolute().parent.name}/{stem}" for p, stem in zip(color_paths, stems, strict=True)]

    pose_paths = [p.with_name(f"{stem}.pose.txt") for p, stem in zip(color_paths, stems, strict=True)]
    poses = None
    if any(p.is_file() for p in pose_paths):
        matrices = np.stack([read_matrix_pose(p) for p in pose_paths])
        poses = checked_poses(matrices, pose_paths, names) @ invert(T_COLOR_DEPTH)

    depth_paths = [p.with_name(f"{stem}.depth.png") for p, stem in zip(color_paths, stems, strict=True)]
    has_depth = any(p.is_file() for p in depth_paths)
    for depth_path in depth_paths if has_depth else []:
        if not depth_path.is_file():
            raise DataError(depth_path, "is missing", "restore it or remove the frame's other files")

    color_camera = options.camera_or(COLOR_CAMERA)
    return ImageRecording(
        name=path.resolve().name,
        folder=path,
        camera=color_camera,
        frame_names=names,
        timestamps_s=np.array(times_s),
        poses=poses,
        color_paths=color_paths,
        depth_paths=depth_paths if has_depth else None,
        depth_scale=options.depth_scale or 1000.0,
        registration=DepthRegistration(_depth_camera(path), color_camera, T_COLOR_DEPTH),
    )


def _sequence_folders(path: Path) -> list[Path]:
    return sorted(p for p in path.iterdir() if p.is_dir() and _SEQUENCE_NAME.fullmatch(p.name))


def _frames(folder: Path) -> dict[int, Path]:
    """Colour images of a sequence by frame number, in ascending order."""
    matches = ((_COLOR_NAME.fullmatch(p.name), p) for p in folder.iterdir())
    frames = {int(match[1]): p for match, p in matches if match}
    if not frames:
        raise DataError(
            folder, "has no frame-NNNNNN.color images", "give a 7-Scenes scene or sequence folder, unpacked"
        )
    return dict(sorted(frames.items()))


def _depth_camera(path: Path) -> Camera:
    """Depth camera from ``camera-intrinsics.txt`` in the given folder or its parent, or the data set's default."""
    file = next((p for p in (path, path.resolve().parent) if (p / "camera-intrinsics.txt").is_file()), None)
    if file is None:
        return DEPTH_CAMERA
    file = file / "camera-intrinsics.txt"
    rows = read_rows(file, 3, "three numbers of the 3x3 intrinsic matrix")
    fix = "write the depth camera's fx 0 cx / 0 fy cy / 0 0 1"
    if rows.shape != (3, 3):
        raise DataError(file, f"has {len(rows)} rows instead of 3", fix)
    try:
        return Camera(DEPTH_CAMERA.width, DEPTH_CAMERA.height, rows[0, 0], rows[1, 1], rows[0, 2], rows[1, 2])
    except SettingError as error:
        raise DataError(file, f"does not fit: {error}", fix) from error
