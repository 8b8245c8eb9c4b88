"""Clouds: thinning, cleaning, building from frames, and files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth.depth_image import at_discontinuity
from monoloc.errors import DataError, SettingError
from monoloc.geometry import invert, se3_exp, transform
from monoloc.io.cloud_files import read_cloud
from monoloc.map.cloud import (
    DISCONTINUITY,
    VoxelThinner,
    cloud_from_recording,
    remove_outliers,
    voxel_thin,
)
from synthetic_room import Room


class BoxRecording:
    """A camera inside a box |x| <= 1, |y| <= 1, |z| <= 1.5 (world, m), with exact depth."""

    name = "box"
    has_depth = True

    def __init__(self, poses: NDArray[np.float64] | None) -> None:
        self.camera = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)
        self.poses = poses
        self.frame_names = [f"{i}" for i in range(len(self))]
        self.timestamps_s = np.arange(len(self), dtype=np.float64)

    def __len__(self) -> int:
        return 1 if self.poses is None else len(self.poses)

    def color(self, index: int) -> NDArray[np.uint8]:
        raise NotImplementedError

    def depth(self, index: int) -> NDArray[np.float32]:
        assert self.poses is not None
        T_world_camera = self.poses[index]
        directions = self.camera.pixel_rays() @ T_world_camera[:3, :3].T
        half = np.array([1.0, 1.0, 1.5])
        with np.errstate(divide="ignore"):
            reach = (np.sign(directions) * half - T_world_camera[:3, 3]) / directions
        return np.asarray(reach.min(axis=-1), dtype=np.float32)


POSES = se3_exp(np.random.default_rng(0).normal(size=(5, 6)) * np.array([0.2, 0.2, 0.2, 0.5, 0.5, 0.5]))


def test_cloud_lies_on_the_walls() -> None:
    done: list[tuple[int, int]] = []
    cloud = cloud_from_recording(
        BoxRecording(POSES), voxel_m=0.05, stride=2, progress=lambda i, n: done.append((i, n))
    )
    distance = np.abs(np.abs(cloud) / np.array([1.0, 1.0, 1.5]) - 1.0).min(axis=1)
    assert len(cloud) > 500
    # Voxels at an edge average two walls; all others are exact.
    assert np.mean(distance < 1e-4) > 0.9
    assert distance.max() < 0.05
    assert done == [(i, 5) for i in range(1, 6)]


def test_far_depth_is_left_out() -> None:
    recording = BoxRecording(POSES)
    cloud = cloud_from_recording(recording, max_depth_m=1.2)
    nearest = np.min([transform(invert(T), cloud)[:, 2] for T in POSES], axis=0)
    assert len(cloud) > 0
    assert nearest.max() < 1.2 + 0.03


def test_cloud_needs_poses_and_depth() -> None:
    with pytest.raises(DataError, match="box: has no poses; give a recording with poses"):
        cloud_from_recording(BoxRecording(None))
    blind = BoxRecording(POSES)
    blind.has_depth = False
    with pytest.raises(DataError, match="box: has no depth; give a recording with depth"):
        cloud_from_recording(blind)
    with pytest.raises(DataError, match=r"box: has no depth between 0 and 0\.01 m"):
        cloud_from_recording(BoxRecording(POSES), max_depth_m=0.01)
    with pytest.raises(SettingError, match="stride: is 0"):
        cloud_from_recording(BoxRecording(POSES), stride=0)
    with pytest.raises(SettingError, match="max_depth_m: is 0"):
        cloud_from_recording(BoxRecording(POSES), max_depth_m=0.0)


def test_discontinuity_marks_both_sides_and_ignores_holes() -> None:
    depth = np.full((5, 6), 2.0)
    depth[:, 3:] = 3.0
    depth[2, 0] = 0.0
    marked = at_discontinuity(depth, DISCONTINUITY)
    np.testing.assert_array_equal(marked.any(axis=0), [False, False, True, True, False, False])
    assert marked[:, 2:4].all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 200), st.sampled_from([0.03, 0.2, 1.0]))
def test_thinning_leaves_one_centroid_a_voxel(seed: int, count: int, voxel_m: float) -> None:
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))
    thinned = voxel_thin(points, voxel_m)
    cells, inverse = np.unique(np.floor(points / voxel_m), axis=0, return_inverse=True)
    assert len(thinned) == len(cells)
    expected = np.stack([points[inverse.ravel() == i].mean(axis=0) for i in range(len(cells))])
    np.testing.assert_allclose(np.sort(thinned, axis=0), np.sort(expected, axis=0), atol=1e-12)


def test_thinning_in_parts_equals_thinning_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("monoloc.map.cloud._MERGE_AT", 100)  # merges several times
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (3000, 3))
    thinner = VoxelThinner(0.3)
    for part in np.array_split(points, 20):
        thinner.add(part)
    np.testing.assert_allclose(thinner.points(), voxel_thin(points, 0.3), atol=1e-12)


def test_thinning_weighs_points() -> None:
    thinner = VoxelThinner(1.0)
    thinner.add([[0.1, 0.5, 0.5], [0.5, 0.5, 0.5]], [3.0, 1.0])
    np.testing.assert_allclose(thinner.points(), [[0.2, 0.5, 0.5]])


def test_thinning_of_nothing_and_bad_input() -> None:
    assert voxel_thin(np.empty((0, 3)), 0.1).shape == (0, 3)
    assert VoxelThinner(0.1).points().shape == (0, 3)
    with pytest.raises(SettingError, match="voxel_m: is 0"):
        voxel_thin(np.zeros((1, 3)), 0.0)
    with pytest.raises(ValueError, match="points must be finite"):
        voxel_thin([[np.nan, 0.0, 0.0]], 0.01)


def test_outliers_go_and_surfaces_stay() -> None:
    u, v = np.meshgrid(np.arange(0.0, 1.0, 0.03), np.arange(0.0, 1.0, 0.03))
    plane = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
    strays = np.array([[0.5, 0.5, 1.0], [-2.0, 0.0, 0.0], [0.5, 0.5, -3.0]])
    kept = remove_outliers(np.concatenate([plane, strays]))
    np.testing.assert_array_equal(kept, plane)
    assert remove_outliers(np.empty((0, 3))).shape == (0, 3)
    with pytest.raises(SettingError, match="voxel_m: is -1"):
        remove_outliers(plane, voxel_m=-1.0)


@pytest.mark.parametrize("voxel_m", [0.02, 0.03, 0.05, 0.1, 0.2])
def test_surfaces_stay_and_outliers_go_at_every_voxel_size(voxel_m: float) -> None:
    """Of a room, of which next to nothing would be left at 10 cm, were neighbours counted in cells of 5 cm."""
    room = voxel_thin(Room().cloud(voxel_m / 3.0), voxel_m)
    strays = np.array([[0.0, 0.0, 50.0], [0.0, 40.0, 0.0], [30.0, 0.1, 0.1]])
    kept = remove_outliers(np.concatenate([room, strays]), voxel_m)
    assert len(kept) > 0.99 * len(room) and np.abs(kept).max() < 10.0


def test_a_cloud_in_a_country_s_coordinates_is_refused() -> None:
    """The easting and northing of a survey, whose voxels cannot be numbered."""
    cloud = np.random.default_rng(0).uniform(0.0, 3.0, (100, 3)) + np.array([450_000.0, 5_400_000.0, 120.0])
    line = r"^cloud: lies 5400\.0 km from the origin, too far for voxels of 0\.03 m; subtract an offset from cloud"
    with pytest.raises(DataError, match=line):
        voxel_thin(cloud, 0.03)


# --- Files ---

POINTS = np.array([[0.5, -1.25, 2.0], [3.0, 4.5, -0.125], [1e3, 0.0, 7.0]])


def ply_header(encoding: str, count: int = 3) -> bytes:
    return (
        f"ply\nformat {encoding} 1.0\ncomment made by hand\nelement vertex {count}\nproperty uchar red\n"
        "property double x\nproperty float32 nx\nproperty double y\nproperty double z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()


def test_ply_skips_other_properties_and_elements(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    rows = "".join(f"7 {x} 0.5 {y} {z}\n" for x, y, z in POINTS)
    path.write_bytes(ply_header("ascii") + rows.encode() + b"3 0 1 2\n")
    np.testing.assert_array_equal(read_cloud(path), POINTS)

    layout = np.dtype([("red", "u1"), ("x", "<f8"), ("nx", "<f4"), ("y", "<f8"), ("z", "<f8")])
    vertices = np.zeros(3, layout)
    for axis, name in enumerate("xyz"):
        vertices[name] = POINTS[:, axis]
    path.write_bytes(ply_header("binary_little_endian") + vertices.tobytes() + b"\x03" + bytes(12))
    np.testing.assert_array_equal(read_cloud(path), POINTS)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_ply_whose_faces_come_first(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.ply"
    header = (
        f"ply\nformat {encoding} 1.0\nelement face 2\nproperty list uchar int vertex_indices\nproperty float area\n"
        "element vertex 3\nproperty double x\nproperty double y\nproperty double z\nend_header\n"
    ).encode()
    if encoding == "ascii":
        body = b"3 0 1 2 0.5\n4 0 1 2 0 1.5\n\n" + "".join(f"{x} {y} {z}\n" for x, y, z in POINTS).encode()
    else:
        faces = [struct.pack("<B3if", 3, 0, 1, 2, 0.5), struct.pack("<B4if", 4, 0, 1, 2, 0, 1.5)]
        body = b"".join(faces) + POINTS.tobytes()
    path.write_bytes(header + body)
    np.testing.assert_array_equal(read_cloud(path), POINTS)


def pcd_header(data: str) -> bytes:
    return (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb extra\nSIZE 4 4 4 4 2\nTYPE F F F U I\nCOUNT 1 1 1 1 2\n"
        f"WIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA {data}\n"
    ).encode()


def test_pcd(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd_header("ascii") + "".join(f"{x} {y} {z} 255 1 2\n" for x, y, z in POINTS).encode())
    np.testing.assert_array_equal(read_cloud(path), POINTS)
    layout = np.dtype([("xyz", "<f4", 3), ("rgb", "<u4"), ("extra", "<i2", 2)])
    rows = np.zeros(3, layout)
    rows["xyz"] = POINTS
    path.write_bytes(pcd_header("binary") + rows.tobytes())
    np.testing.assert_array_equal(read_cloud(path), POINTS)


def test_pcd_with_padding(tmp_path: Path) -> None:
    """As the Point Cloud Library writes what it keeps aligned in memory."""
    path = tmp_path / "a.pcd"
    header = (
        "VERSION 0.7\nFIELDS x y z _ intensity _\nSIZE 4 4 4 1 4 1\nTYPE F F F U F U\nCOUNT 1 1 1 4 1 12\n"
        "WIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA "
    )
    layout = np.dtype([("xyz", "<f4", 3), ("a", "u1", 4), ("intensity", "<f4"), ("b", "u1", 12)])
    rows = np.full(3, 7, layout)
    rows["xyz"] = POINTS
    path.write_bytes(f"{header}binary\n".encode() + rows.tobytes())
    np.testing.assert_array_equal(read_cloud(path), POINTS)
    padding = " ".join(["0"] * 12)
    path.write_text(f"{header}ascii\n" + "".join(f"{x} {y} {z} 0 0 0 0 7 {padding}\n" for x, y, z in POINTS))
    np.testing.assert_array_equal(read_cloud(path), POINTS)


@pytest.mark.parametrize("suffix", ["xyz", "txt"])
def test_xyz_takes_the_first_three_columns(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_text("# x y z intensity\n" + "".join(f"{x} {y} {z} 9\n" for x, y, z in POINTS))
    np.testing.assert_array_equal(read_cloud(path), POINTS)


def test_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS.astype(np.float32))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npz"), POINTS)


@pytest.mark.data
def test_real_ply(data_root: Path) -> None:
    cloud = read_cloud(data_root / "rgbd-scenes-v2" / "pc" / "03_ascii.ply")
    assert cloud.shape == (20510, 3)
    np.testing.assert_allclose(cloud[0], [-1.99979, -0.0612951, 1.12089])
    assert len(remove_outliers(cloud)) > 20_000


BAD_FILES: dict[str, tuple[bytes, str]] = {
    "a.obj": (b"", "has the unknown suffix '.obj'; give one of .npz, .pcd, .ply, .txt, .xyz"),
    "empty.ply": (b"", "cannot be read as ply .the first line is not 'ply'."),
    "cut.ply": (ply_header("ascii") + b"7 1 0 1 1\n", "it ends after 1 of 3 rows of 'vertex'"),
    "cutbinary.ply": (ply_header("binary_little_endian") + bytes(40), "it ends after 1 of 3 rows of 'vertex'"),
    "none.ply": (ply_header("ascii", 0), "holds no points; export the cloud again"),
    "headless.ply": (b"ply\nformat ascii 1.0\n", "the header has no end_header"),
    "big.ply": (ply_header("binary_big_endian"), "format 'binary_big_endian' is neither"),
    "pixels.ply": (b"ply\nformat ascii 1.0\nelement face 1\nend_header\n\n", "it has no element 'vertex'"),
    "lists.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\n"
        b"property list uchar int x\nproperty int y\nproperty int z\nend_header\n2 5 5 6 7\n",
        "x, y or z are lists",
    ),
    "wide.ply": (
        ply_header("ascii") + 3 * b"7 1 0 1 1 255\n",
        "rows of 'vertex' have not 5 numbers each, as the header has it",
    ),
    "words.ply": (ply_header("ascii") + 3 * b"7 1 0 one 1\n", "it has something that is no number"),
    "type.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n",
        "the header's line 'property half x' cannot be understood",
    ),
    "noz.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n1 2\n",
        "points have no property 'z'",
    ),
    "uncounted.ply": (
        b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n",
        "the header's line 'element vertex many' cannot be understood",
    ),
    "compressed.pcd": (pcd_header("binary_compressed"), "DATA binary_compressed is neither ascii nor binary"),
    "nofields.pcd": (b"POINTS 3\nDATA ascii\n", "the header has no FIELDS"),
    "type.pcd": (b"FIELDS x\nSIZE 4\nTYPE Q\nPOINTS 3\nDATA ascii\n", "field 'x' has the unknown type 'Q'"),
    "size.pcd": (b"FIELDS x y z\nSIZE 3 3 3\nTYPE F F F\nPOINTS 3\nDATA binary\n", "cannot be read as pcd"),
    "words.xyz": (b"one two three\n", "cannot be read as xyz"),
    "blank.txt": (b"", "holds no points"),
    "nan.xyz": (b"1 2 3\nnan 2 3\n1 inf 3\n", "2 of 3 points are not finite; remove them"),
    "notzip.npz": (b"PK\x03\x04 no more", "cannot be read as npz"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_named(tmp_path: Path, name: str) -> None:
    content, message = BAD_FILES[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataError, match=message) as error:
        read_cloud(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_missing_file_and_bad_npz(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"absent\.ply: there is no such file; check the path"):
        read_cloud(tmp_path / "absent.ply")
    np.savez(tmp_path / "other.npz", cloud=POINTS)
    with pytest.raises(DataError, match="it has no array 'points'"):
        read_cloud(tmp_path / "other.npz")
    np.savez(tmp_path / "flat.npz", points=np.zeros(3))
    with pytest.raises(DataError, match=r"points must be numbers of shape \(N, 3\), got float64 of shape \(3,\)"):
        read_cloud(tmp_path / "flat.npz")
