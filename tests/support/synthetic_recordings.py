"""Small recordings in every format, written to disk, and the poses and depth they hold."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc import geometry
from monoloc.camera import Camera
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Recording

FloatArray = NDArray[np.float64]


# Of the videos that :func:`write_video` writes.
VIDEO_OPTIONS = ReaderOptions(camera=Camera(64, 48, 50.0, 50.0, 31.0, 23.0))


def check_recording(recording: Recording, frames: int) -> None:
    """What every recording promises."""
    assert isinstance(recording, Recording)
    assert len(recording) == len(recording.frame_names) == frames
    assert len(set(recording.frame_names)) == frames
    assert recording.timestamps_s.shape == (frames,)
    assert (np.diff(recording.timestamps_s) > 0).all()
    size = (recording.camera.height, recording.camera.width)
    color = recording.color(frames - 1)
    assert color.shape == (*size, 3)
    assert color.dtype == np.uint8
    if recording.has_depth:
        depth_m = recording.depth(frames - 1)
        assert depth_m.shape == size
        assert depth_m.dtype == np.float32
    if recording.poses is not None:
        assert recording.poses.shape == (frames, 4, 4)
        assert geometry.is_rigid(recording.poses, tolerance=1e-9).all()


def make_poses(count: int) -> FloatArray:
    """Poses along a smooth trajectory, (count, 4, 4)."""
    steps = np.arange(count)[:, None]
    return geometry.se3_exp(steps * np.array([0.05, -0.02, 0.03, 0.02, 0.05, -0.01]))


def make_color(width: int, height: int, number: int = 0) -> NDArray[np.uint8]:
    """A smooth RGB image that differs in every channel and by number, (height, width, 3)."""
    v, u = np.mgrid[0:height, 0:width]
    channels = [u * 255 // width, v * 255 // height, np.full_like(u, 40 + 10 * number)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def write_color(path: Path, rgb: NDArray[np.uint8]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), rgb[..., ::-1])


def write_depth(path: Path, stored: NDArray[np.integer]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), stored)


def constant_depth(width: int, height: int, value: int) -> NDArray[np.uint16]:
    """The value everywhere but in the first row, which has none."""
    stored = np.full((height, width), value, dtype=np.uint16)
    stored[0] = 0
    return stored


def tum_lines(times_s: FloatArray, poses: FloatArray) -> str:
    """Poses as lines of a TUM trajectory."""
    quaternions = geometry.rotation_to_quaternion(poses[:, :3, :3])
    rows = np.column_stack([times_s, poses[:, :3, 3], quaternions])
    return "# t tx ty tz qx qy qz qw\n" + "".join(" ".join(f"{x:.9f}" for x in row) + "\n" for row in rows)


def write_seven_scenes(scene: Path, sequences: int = 1, frames: int = 3, suffix: str = "png") -> FloatArray:
    """A 7-Scenes scene with every second frame; returns the depth camera's poses of all frames."""
    poses = make_poses(sequences * frames)
    for index, pose in enumerate(poses):
        sequence, frame = divmod(index, frames)
        stem = scene / f"seq-{sequence + 1:02d}" / f"frame-{2 * frame:06d}"
        write_color(stem.with_name(stem.name + f".color.{suffix}"), make_color(640, 480, frame))
        stored = constant_depth(640, 480, 2000)
        stored[1] = 65535
        write_depth(stem.with_name(stem.name + ".depth.png"), stored)
        np.savetxt(stem.with_name(stem.name + ".pose.txt"), pose)
    return poses


TWELVE_SCENES_INFO = """\
m_versionNumber = 4
m_sensorName = StructureSensor
m_colorWidth = {color.width}
m_colorHeight = {color.height}
m_depthWidth = {depth.width}
m_depthHeight = {depth.height}
m_depthShift = 1000
m_calibrationColorIntrinsic = {color.fx} 0 {color.cx} 0 0 {color.fy} {color.cy} 0 0 0 1 0 0 0 0 1
m_calibrationColorExtrinsic = 1 0 0 -0 0 1 0 -0 0 0 1 -0 0 0 0 1
m_calibrationDepthIntrinsic = {depth.fx} 0 {depth.cx} 0 0 {depth.fy} {depth.cy} 0 0 0 1 0 0 0 0 1
m_calibrationDepthExtrinsic = 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
m_frames.size = 3
"""


def write_twelve_scenes_texts(scene: Path, color: Camera, depth: Camera, sequences: list[int]) -> None:
    """``info.txt`` and ``split.txt`` of a scene with so many frames in each sequence."""
    (scene / "data").mkdir(parents=True, exist_ok=True)
    (scene / "info.txt").write_text(TWELVE_SCENES_INFO.format(color=color, depth=depth))
    stops = np.cumsum(sequences)
    lines = [
        f"sequence{index} [frames={count}]  [start={stop - count} ; end={stop - 1}]\n"
        for index, (count, stop) in enumerate(zip(sequences, stops, strict=True))
    ]
    (scene / "split.txt").write_text("".join(lines))


def write_twelve_scenes_frame(
    scene: Path, number: int, rgb: NDArray[np.uint8], depth_m: ArrayLike, pose: FloatArray
) -> None:
    """Colour, depth in metres and ``T_world_camera`` of a frame."""
    stem = scene / "data" / f"frame-{number:06d}"
    write_color(stem.with_name(f"{stem.name}.color.jpg"), rgb)
    write_depth(stem.with_name(f"{stem.name}.depth.png"), np.round(1000.0 * np.asarray(depth_m)).astype(np.uint16))
    np.savetxt(stem.with_name(f"{stem.name}.pose.txt"), pose)


def write_twelve_scenes(scene: Path, sequences: list[int]) -> FloatArray:
    """A scene of 12-Scenes whose colour has twice the pixels of depth a side; returns the poses of all frames."""
    color, depth = Camera(64, 48, 50.0, 50.0, 31.2, 23.2), Camera(32, 24, 25.0, 25.0, 15.5, 11.5)
    write_twelve_scenes_texts(scene, color, depth, sequences)
    poses = make_poses(sum(sequences))
    for number, pose in enumerate(poses):
        write_twelve_scenes_frame(scene, number, make_color(64, 48, number), np.full((24, 32), 2.0), pose)
    return poses


def write_tum(folder: Path, frames: int = 4) -> FloatArray:
    """A TUM sequence whose depth lags by 5 ms and whose truth is sampled at 100 Hz.

    Returns the poses at the frames. The motion is a constant twist, so that interpolation is exact.
    """
    twist = np.array([0.3, -0.2, 0.1, 0.2, 0.5, -0.4])
    times_s = 100.0 + np.arange(frames) / 30.0
    for name, number_of_channels, delay_s in (("rgb", 3, 0.0), ("depth", 1, 0.005)):
        lines = ["# made for a test"]
        for index, t in enumerate(times_s + delay_s):
            file = f"{name}/{t:.6f}.png"
            if number_of_channels == 3:
                write_color(folder / file, make_color(640, 480, index))
            else:
                write_depth(folder / file, constant_depth(640, 480, 10000))
            lines.append(f"{t:.6f} {file}")
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    truth_s = np.arange(99.9, 100.0 + frames / 30.0, 0.01)
    (folder / "groundtruth.txt").write_text(tum_lines(truth_s, geometry.se3_exp((truth_s[:, None] - 100.0) * twist)))
    return geometry.se3_exp((times_s[:, None] - 100.0) * twist)


def write_rgbd_scenes_v2(root: Path, scene: str = "01", frames: int = 3) -> FloatArray:
    """A scene of RGB-D Scenes v2 under its root; returns its poses."""
    poses = make_poses(frames)
    folder = root / "imgs" / f"scene_{scene}"
    for index in range(frames):
        write_color(folder / f"{index:05d}-color.png", make_color(640, 480, index))
        write_depth(folder / f"{index:05d}-depth.png", constant_depth(640, 480, 20000))
    (root / "pc").mkdir(exist_ok=True)
    quaternions_wxyz = np.roll(geometry.rotation_to_quaternion(poses[:, :3, :3]), 1, axis=1)
    np.savetxt(root / "pc" / f"{scene}.pose", np.hstack([quaternions_wxyz, poses[:, :3, 3]]))
    return poses


SEQUENCE_TOML = """\
kind = "sequence"
color = "color/{index:06d}.jpg"
depth = "depth/{index:06d}.png"
count = 3
start = 10
step = 5
width = 32
height = 24
fx = 30.0
fy = 31
cx = 15.5
cy = 11.5
distortion = [0.1, -0.2, 0, 0.001, 0]
depth_scale = 1000
poses = "poses.txt"
"""


def write_folder(folder: Path, toml: str = SEQUENCE_TOML) -> FloatArray:
    """A described folder with three frames 10, 15, 20; returns their poses."""
    for index in (10, 15, 20):
        write_color(folder / f"color/{index:06d}.jpg", make_color(32, 24, index // 5))
        write_depth(folder / f"depth/{index:06d}.png", constant_depth(32, 24, 1500))
    poses = make_poses(3)
    (folder / "poses.txt").write_text(tum_lines(np.array([5.0, 5.1, 5.2]), poses))
    (folder / "dataset.toml").write_text(toml)
    return poses


def write_video(path: Path, frames: int = 6, codec: str = "MJPG") -> None:
    """A video at 10 Hz whose frames are grey 20, 40, 60 and so on, 64x48."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10.0, (64, 48))
    assert writer.isOpened()
    for index in range(frames):
        writer.write(np.full((48, 64, 3), 20 * (index + 1), dtype=np.uint8))
    writer.release()


def write_uneven_video(path: Path, shares: list[int]) -> None:
    """As :func:`write_video`, an .mp4 whose frames last these shares of the whole time."""
    write_video(path, len(shares), "mp4v")
    data = path.read_bytes()
    # Box stts: size, name, version, number of entries, then (frames, units of time) of each.
    start = data.index(b"stts") - 4
    size, _, version, entries, count, unit = struct.unpack_from(">I4sIIII", data, start)
    assert (entries, count) == (1, len(shares))
    units = [share * count * unit // sum(shares) for share in shares]
    table = b"".join(struct.pack(">II", 1, each) for each in units)
    longer = 8 * (count - 1)
    box = struct.pack(">I4sII", size + longer, b"stts", version, count) + table
    changed = bytearray(data[:start] + box + data[start + size :])
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        at = data.index(name) - 4
        struct.pack_into(">I", changed, at, struct.unpack_from(">I", data, at)[0] + longer)
    assert data.index(b"mdat") < start  # or the frames would have moved
    path.write_bytes(changed)


def overstate_frames(path: Path, frames: int) -> None:
    """Make the headers of an .avi state this number of frames."""
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, data.index(b"avih") + 8 + 16, frames)
    struct.pack_into("<I", data, data.index(b"strh") + 8 + 32, frames)
    path.write_bytes(data)
