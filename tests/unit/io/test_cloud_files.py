"""Clouds from PLY, PCD, XYZ and NPZ files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc.io.cloud_files import read_cloud

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
def test_ply_with_faces_before_vertices(tmp_path: Path, encoding: str) -> None:
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
    """As the Point Cloud Library writes points that are aligned in memory."""
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


INVALID_FILES: dict[str, tuple[bytes, str]] = {
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
        "rows of 'vertex' do not have 5 numbers each, as in the header",
    ),
    "words.ply": (ply_header("ascii") + 3 * b"7 1 0 one 1\n", "it contains text that is not a number"),
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


@pytest.mark.parametrize("name", INVALID_FILES)
def test_invalid_file_is_named_with_its_problem(tmp_path: Path, name: str) -> None:
    content, message = INVALID_FILES[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(DataError, match=message) as error:
        read_cloud(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_missing_file_and_invalid_npz_are_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"absent\.ply: there is no such file; check the path"):
        read_cloud(tmp_path / "absent.ply")
    np.savez(tmp_path / "other.npz", cloud=POINTS)
    with pytest.raises(DataError, match="it has no array 'points'"):
        read_cloud(tmp_path / "other.npz")
    np.savez(tmp_path / "flat.npz", points=np.zeros(3))
    with pytest.raises(DataError, match=r"points must be numbers of shape \(N, 3\), got float64 of shape \(3,\)"):
        read_cloud(tmp_path / "flat.npz")
