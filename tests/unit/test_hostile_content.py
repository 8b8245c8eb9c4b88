"""Damaged and hostile content of every kind of file is read, or refused in one line; nothing else happens."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import synthetic_recordings as synthetic
from capture_writers import Capture, pinhole_of, write_colmap, write_nerfstudio
from map_helpers import make_mixture
from monoloc.builder.build_config import BuildConfig
from monoloc.bundle import read_network
from monoloc.camera import Camera
from monoloc.config import load_settings
from monoloc.depth.network_check import check_network
from monoloc.errors import MonolocError
from monoloc.io.camera_file import read_camera
from monoloc.io.cloud_files import read_cloud
from monoloc.io.pose_files import read_tum
from monoloc.io.registry import open_recording
from monoloc.map.mixture import GaussianMixture
from onnx_networks import MIDAS, onnx_network, toml_of

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


def opened(path: Path) -> None:
    """Open the recording that a file belongs to, and read its first frame."""
    recording = open_recording(str(path))
    recording.color(0)
    if recording.has_depth:
        recording.depth(0)


def colmap(binary: bool) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        made = capture()
        write_colmap(path.parents[2], made, binary, [pinhole_of(made.camera)], POINTS)

    return make


def network_and_description(path: Path) -> None:
    path.write_text(toml_of(MIDAS))
    (path.parent / "another.onnx").write_bytes(onnx_network(MIDAS))


def of_workspace(path: Path) -> None:
    opened(path.parents[2])


def of_folder(path: Path) -> None:
    opened(path.parent)


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
    "map": Target("map.npz", lambda path: make_mixture(5, 0).save(path), GaussianMixture.load),
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


@st.composite
def damage(draw: st.DrawFn, whole: bytes) -> bytes:
    """The content after a few changes: cuts, repetitions, bytes and numbers that nobody expects."""
    data = bytearray(whole)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(data)) | st.integers(0, min(len(data), 200)))
        kind = draw(st.sampled_from(["number", "overwrite", "insert", "delete", "repeat", "cut"]))
        found = list(NUMBER.finditer(data)) if kind == "number" else []
        if found:
            one = draw(st.sampled_from(found))
            data[one.start() : one.end()] = draw(st.sampled_from(NUMBERS))
        elif kind == "cut":
            del data[at:]
        elif kind == "delete":
            del data[at : at + draw(st.sampled_from([1, 4, 100]))]
        elif kind == "repeat":
            data[at:at] = data[at : at + draw(st.sampled_from([4, 64]))] * draw(st.sampled_from([1, 50]))
        else:
            piece = draw(st.sampled_from(PIECES) | st.binary(min_size=1, max_size=8))
            data[at : at + (len(piece) if kind == "overwrite" else 0)] = piece
    return bytes(data)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of NumPy, about numbers that are then refused
@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@settings(
    max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_file_is_read_or_refused(tmp_path: Path, target: Target, data: st.DataObject) -> None:
    path = tmp_path / target.file
    whole = tmp_path.parent / f"{tmp_path.name}-whole"
    if not whole.exists():
        target.make(path)
        target.read(path)  # so that what follows can fail
        whole.write_bytes(path.read_bytes())
    path.write_bytes(data.draw(damage(whole.read_bytes())))
    try:
        target.read(path)
    except MonolocError as error:
        assert "\n" not in str(error)
