"""Small files of every kind that monoloc reads, to damage, and what reads them."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import struct
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

import synthetic_recordings as synthetic
from bag_writers import Bag, bag_of
from capture_writers import (
    Capture,
    pinhole_of,
    record3d_members,
    write_colmap,
    write_nerfstudio,
    write_polycam,
    write_record3d,
    write_rtabmap,
    write_stray_scanner,
)
from map_helpers import make_mixture
from mavlink_helpers import result_at, step_at
from monoloc.builder.build_config import BuildConfig
from monoloc.bundle import read_bundle, read_network, write_bundle
from monoloc.camera import Camera
from monoloc.config import load_settings
from monoloc.depth.network_check import check_network
from monoloc.flight.flight_file import read_flight_file
from monoloc.flight.flight_recording import FlightHeader, FlightRecorder, read_events, read_header
from monoloc.flight.flight_settings import FlightSettings, Mount
from monoloc.io.camera_file import read_camera
from monoloc.io.cloud_files import read_cloud
from monoloc.io.gyroscope_file import read_gyroscope
from monoloc.io.pose_files import read_tum
from monoloc.io.pose_table import read_pose_table
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording
from monoloc.io.rgbd_scenes_v2 import read_pose_file
from monoloc.live.frame_source import EndOfStreamError
from monoloc.live.mjpeg_stream import MjpegStream
from monoloc.map.mixture import GaussianMixture
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.mavlink.messages import dialect
from onnx_networks import MIDAS, onnx_network, toml_of
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture

POINTS = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 3))
ROWS = "\n".join(" ".join(f"{value:.4f}" for value in point) for point in POINTS) + "\n"
PLY = (
    "ply\nformat {} 1.0\nelement vertex 20\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
PCD = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 20\nHEIGHT 1\nPOINTS 20\nDATA {}\n"
CAMERA = "width = 640\nheight = 480\nfx = 500.0\nfy = 500.0\ncx = 320.0\ncy = 240.0\ndistortion = [0.1, 0, 0, 0, 0]\n"
BUILD = (
    "components = 20\nvoxel_m = 0.05\n[localizer]\nparticles = 100\n[localizer.motion_noise]\nspeed_sd_m_s = 1.0\n"
)

FLIGHT = """room = "kitchen.monoloc"
source = "7scenes:kitchen"
camera = "cam.toml"
mavlink = "udpout:127.0.0.1:14540"
firmware = "px4"
start = "0,0,1,0,0,0,1"
record = "flight-%Y"
north_deg = 75.5
down = [0, 0, -1.0]
[mount]
pitch_deg = -90
[[marker]]
id = 7
size_m = 0.16
position_m = [1.0, 2.0, 0.5]
rpy_deg = [90, 0, 0]
"""


@dataclass(frozen=True)
class Target:
    """A file to damage, below a folder, and what reads it."""

    file: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]


def content(data: bytes | str) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(data if isinstance(data, bytes) else data.encode())


def capture() -> Capture:
    colors = [synthetic.make_color(32, 24, number) for number in range(3)]
    depths = [synthetic.constant_depth(32, 24, 1500)] * 3
    camera = Camera(32, 24, 30.0, 31.0, 15.5, 11.5)
    return Capture(camera, np.arange(3.0), synthetic.make_poses(3), colors, depths)


def check_finite(value: object) -> None:
    """Arrays, and those in tuples, must not hold NaN or infinity: what is nonsense is refused."""
    for each in value if isinstance(value, tuple) else (value,):
        if isinstance(each, np.ndarray) and each.dtype.kind == "f":
            assert np.isfinite(each).all(), "NaN or infinity was accepted"


def opened(path: Path, options: ReaderOptions | None = None) -> None:
    """Open a recording, and read its first frame."""
    recording = open_recording(str(path), options)
    recording.color(0)
    check_finite((recording.timestamps_s, recording.poses, recording.depth(0) if recording.has_depth else None))


def colmap(binary: bool) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        made = capture()
        write_colmap(path.parents[2], made, binary, [pinhole_of(made.camera)], POINTS)

    return make


def network_and_description(path: Path) -> None:
    path.write_text(toml_of(MIDAS))
    (path.parent / "another.onnx").write_bytes(onnx_network(MIDAS))


def arrays_of_map(path: Path) -> tuple[object, ...]:
    mixture = GaussianMixture.load(path)
    return mixture.means, mixture.covariances, mixture.weights


def of_workspace(path: Path) -> None:
    opened(path.parents[2])


def of_grandparent(path: Path) -> None:
    opened(path.parents[1])


def of_folder(path: Path) -> None:
    opened(path.parent)


FLOWN = Camera(16, 12, 15.0, 15.0, 7.5, 5.5)


def bag(version: int) -> Bag:
    made = capture()
    return bag_of(replace(made, times_s=made.times_s + 1_700_000_000.0), version)


def write_ros2(path: Path, storage: str) -> None:
    shutil.rmtree(path.parent, ignore_errors=True)
    bag(2).write(path.parent, storage)


def write_unpacked_record3d(path: Path) -> None:
    write_record3d(path.parent, record3d_members(capture()), unpacked=True)


def write_stray_scanner_of(path: Path) -> None:
    write_stray_scanner(path.parent, capture())


def write_flight(path: Path) -> None:
    """A recorded flight of two frames, and a tenth of a second without any."""
    settings = FlightSettings(mount=Mount(pitch_deg=-30.0))
    header = FlightHeader(
        bundle="room.monoloc", digest="ab" * 32, camera=FLOWN, start=None, seed=7, settings=settings, firmware=None
    )
    shutil.rmtree(path.parent, ignore_errors=True)
    recorder = FlightRecorder(path.parent, header)
    for index in range(2):
        made = result_at(1234.5 + index / 3.0, step_at(np.eye(4)))
        color = np.full((FLOWN.height, FLOWN.width, 3), index, dtype=np.uint8)
        recorder.take(replace(made, frame=replace(made.frame, color=color), down_camera=np.array([0.0, 1.0, 0.0])))
        recorder.idle(1234.6)
    recorder.close()


def write_mavlink(path: Path) -> None:
    """What an autopilot says: heartbeat, attitudes, a parameter, and an answer to TIMESYNC."""
    autopilot = dialect().MAVLink(None, srcSystem=1, srcComponent=1)
    kinds = dialect()
    messages = [
        kinds.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3),
        *(kinds.MAVLink_attitude_message(100 * index, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0) for index in range(3)),
        kinds.MAVLink_param_value_message(b"EKF2_EV_CTRL", 1e-44, 6, 1, 0),
        kinds.MAVLink_timesync_message(0, 12345),
    ]
    path.write_bytes(b"".join(message.pack(autopilot) for message in messages))


@cache
def listener() -> AutopilotLink:
    return AutopilotLink("udpout:127.0.0.1:9")


def hear(path: Path) -> None:
    """In the thread of the test: an exception in the link's own would end that thread in silence."""
    link = listener()
    link._take_bytes(path.read_bytes())
    link.turn_between(0.0, 0.1)


def write_motion_jpeg(path: Path) -> None:
    colors = [synthetic.make_color(32, 24, number) for number in range(3)]
    path.write_bytes(b"".join(cv2.imencode(".jpg", color)[1].tobytes() for color in colors))


def watch(path: Path) -> None:
    stream = MjpegStream(BytesIO(path.read_bytes()), capture().camera)
    with suppress(EndOfStreamError):
        while True:
            stream.grab()


def write_body(path: Path) -> None:
    """A bundle, and beside its manifest the same without its seal."""
    shutil.rmtree(path.parent, ignore_errors=True)
    room = RoomRecording(Room(), make_path(2), SMALL_CAMERA)
    write_bundle(path.parent, make_bundle(room_mixture(Room(), 20), room))
    body = json.loads((path.parent / "manifest.json").read_text())
    del body["manifest_sha256"]
    path.write_text(json.dumps(body))


def read_sealed(path: Path) -> None:
    """Read the bundle with the body as its manifest, sealed as anybody can."""
    content = path.read_bytes()
    with suppress(ValueError, RecursionError):
        body = json.loads(content)
        if isinstance(body, dict):
            digest = hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()
            content = json.dumps(body | {"manifest_sha256": digest}).encode()
    (path.parent / "manifest.json").write_bytes(content)
    room = read_bundle(path.parent)
    assert np.isfinite([room.thresholds.low, room.thresholds.lost]).all()


def read_packed(path: Path, name: str, read: Callable[[Path], object]) -> None:
    """Read the file as a member of an archive, whose checksums fit."""
    archive = path.with_suffix(".npz")
    with zipfile.ZipFile(archive, "w") as members:
        members.write(path, f"{name}.npy")
    read(archive)


FACES = struct.pack("<B3i", 3, 0, 1, 2) * 2
TARGETS = {
    "points as text": Target("a.xyz", content(ROWS), read_cloud),
    "ply as text": Target("a.ply", content(PLY.format("ascii") + ROWS + "3 0 1 2\n3 1 2 3\n"), read_cloud),
    "ply": Target(
        "a.ply",
        content(PLY.format("binary_little_endian").encode() + POINTS.astype("<f4").tobytes() + FACES),
        read_cloud,
    ),
    "pcd as text": Target("a.pcd", content(PCD.format("ascii") + ROWS), read_cloud),
    "pcd": Target("a.pcd", content(PCD.format("binary").encode() + POINTS.astype("<f4").tobytes()), read_cloud),
    "npz": Target("a.npz", lambda path: np.savez(path, points=POINTS), read_cloud),
    "map": Target("map.npz", lambda path: make_mixture(5, 0).save(path), arrays_of_map),
    "trajectory": Target(
        "a.txt", content(synthetic.tum_lines(np.arange(3.0), synthetic.make_poses(3))), lambda path: read_tum(path)
    ),
    "camera": Target("camera.toml", content(CAMERA), read_camera),
    "settings": Target("build.toml", content(BUILD), lambda path: load_settings(path, BuildConfig)),
    "network": Target("a.onnx", content(onnx_network(MIDAS)), lambda path: check_network(path.read_bytes(), path)),
    "description of a network": Target("a.toml", network_and_description, read_network),
    "description of a folder": Target("dataset.toml", lambda path: synthetic.write_folder(path.parent), of_folder),
    "poses of a folder": Target("poses.txt", lambda path: synthetic.write_folder(path.parent), of_folder),
    "image of a folder": Target(
        "color/000010.jpg", lambda path: synthetic.write_folder(path.parents[1]), lambda path: opened(path.parents[1])
    ),
    "depth of a folder": Target(
        "depth/000010.png", lambda path: synthetic.write_folder(path.parents[1]), lambda path: opened(path.parents[1])
    ),
    "nerfstudio": Target("transforms.json", lambda path: write_nerfstudio(path.parent, capture()), of_folder),
    "cameras of colmap": Target("sparse/0/cameras.bin", colmap(binary=True), of_workspace),
    "images of colmap": Target("sparse/0/images.bin", colmap(binary=True), of_workspace),
    "images of colmap as text": Target("sparse/0/images.txt", colmap(binary=False), of_workspace),
    "points of colmap": Target("sparse/0/points3D.bin", colmap(binary=True), read_cloud),
    # --- Recordings of other programs ---
    "ros 1 bag": Target("walk.bag", lambda path: bag(1).write(path), opened),
    "ros 2 mcap": Target("walk/walk.mcap", lambda path: write_ros2(path, "mcap"), opened),
    "ros 2 sqlite": Target("walk/walk.db3", lambda path: write_ros2(path, "sqlite3"), opened),
    "metadata of a ros 2 bag": Target("walk/metadata.yaml", lambda path: write_ros2(path, "sqlite3"), of_folder),
    "poses of rtabmap": Target(
        "room_camera_poses.txt", lambda path: write_rtabmap(path.parent, capture()), of_folder
    ),
    "calibration of rtabmap": Target(
        "room_calib/9.yaml", lambda path: write_rtabmap(path.parents[1], capture()), of_grandparent
    ),
    "metadata of record3d": Target("metadata", write_unpacked_record3d, of_folder),
    "depth of record3d": Target("rgbd/0.depth", lambda path: write_unpacked_record3d(path.parent), of_grandparent),
    "camera of polycam": Target(
        "keyframes/cameras/435456552349.json", lambda path: write_polycam(path.parents[2], capture()), of_workspace
    ),
    "odometry of stray scanner": Target("odometry.csv", write_stray_scanner_of, of_folder),
    "camera of stray scanner": Target("camera_matrix.csv", write_stray_scanner_of, of_folder),
    "images of tum": Target("rgb.txt", lambda path: synthetic.write_tum(path.parent), of_folder),
    "pose of 7-scenes": Target(
        "seq-01/frame-000002.pose.txt", lambda path: synthetic.write_seven_scenes(path.parents[1]), of_grandparent
    ),
    "calibration of 12-scenes": Target(
        "info.txt", lambda path: synthetic.write_twelve_scenes(path.parent, [1, 2]), of_folder
    ),
    "split of 12-scenes": Target(
        "split.txt", lambda path: synthetic.write_twelve_scenes(path.parent, [1, 2]), of_folder
    ),
    "poses of rgbd-scenes": Target(
        "pc/01.pose",
        lambda path: synthetic.write_rgbd_scenes_v2(path.parents[1]),
        lambda path: read_pose_file(path),
    ),
    "video": Target(
        "walk.avi",
        lambda path: synthetic.write_video(path, 3),
        lambda path: opened(path, ReaderOptions(camera=Camera(64, 48, 50.0, 50.0, 31.0, 23.0))),
    ),
    # --- Flights ---
    "flight": Target("flight.toml", content(FLIGHT), read_flight_file),
    "header of a recorded flight": Target("flight.json", write_flight, lambda path: read_header(path.parent)),
    "frames of a recorded flight": Target(
        "frames.jsonl", write_flight, lambda path: list(read_events(path.parent, FLOWN))
    ),
    "table of poses": Target("poses.csv", write_flight, read_pose_table),
    "gyroscope": Target("imu.csv", content("t_s,wx,wy,wz\n0.0,0.1,0,0\n0.1,0.1,0,1e-3\n"), read_gyroscope),
    "bytes of an autopilot": Target("link.bin", write_mavlink, hear),
    "motion jpeg": Target("stream.mjpeg", write_motion_jpeg, watch),
    # --- Bundles, sealed again after the damage ---
    "manifest": Target("room.monoloc/body.json", write_body, read_sealed),
    "array in an archive": Target(
        "points.npy", lambda path: np.save(path, POINTS), lambda path: read_packed(path, "points", read_cloud)
    ),
}

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = [
    b"nan",
    b"inf",
    b"-1",
    b"0",
    b"1e400",
    b"-1e308",
    b"1e-320",
    b"99999999999999999999",
    b"2147483648",
    b"1_0",
]
NUMBERS += [b"", b"1e", b"\xd9\xa3", b"1" * 5000, b"True", b"[1]", b'"a"']
PIECES = [
    b"..",
    b"/etc/passwd",
    b"\x00",
    b"{0}",
    b"{index.__class__}",
    b"\xff\xfe",
    b"\r",
    b'"',
    b"[" * 3000,
    b"\x1b[2J",
]
PIECES += [
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\x00\x00\x00\x80",
    b"\x00" * 8,
    b"\xff" * 8,
    b"\x00\x00\xc0\x7f",
]
