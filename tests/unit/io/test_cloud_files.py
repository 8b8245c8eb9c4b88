"""Clouds from PLY, PCD, XYZ and NPZ files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from capture_writers import Capture, pinhole_of, write_colmap
from monoloc.errors import DataError
from monoloc.io.cloud_files import read_cloud
from monoloc.io.pcd import decompress_lzf, write_pcd
from refusals import refuses_data

POINTS = np.array([[0.5, -1.25, 2.0], [3.0, 4.5, -0.125], [1e3, 0.0, 7.0]])


def ply_header(encoding: str, count: int = 3) -> bytes:
    return (
        f"ply\nformat {encoding} 1.0\ncomment made by hand\nelement vertex {count}\nproperty uchar red\n"
        "property double x\nproperty float32 nx\nproperty double y\nproperty double z\n"
        "element edge 1\nproperty list uchar int vertex_pair\nend_header\n"
    ).encode()


def test_ply_skips_other_properties_and_elements(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    rows = "".join(f"7 {x} 0.5 {y} {z}\n" for x, y, z in POINTS)
    path.write_bytes(ply_header("ascii") + rows.encode() + b"3 0 1 2\n")
    np.testing.assert_array_equal(read_cloud(path), POINTS)

    for encoding, order in (("binary_little_endian", "<"), ("binary_big_endian", ">")):
        kinds = [("red", "u1"), ("x", f"{order}f8"), ("nx", f"{order}f4"), ("y", f"{order}f8"), ("z", f"{order}f8")]
        vertices = np.zeros(3, np.dtype(kinds))
        for axis, name in enumerate("xyz"):
            vertices[name] = POINTS[:, axis]
        path.write_bytes(ply_header(encoding) + vertices.tobytes() + b"\x03" + bytes(12))
        np.testing.assert_array_equal(read_cloud(path), POINTS)


def write_mesh(path: Path, vertices: np.ndarray, faces: list[list[int]]) -> None:
    rows = [" ".join(map(str, row)) for row in vertices.tolist()]
    rows += [" ".join(map(str, [len(face), *face])) for face in faces]
    path.write_text(
        f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_index\nend_header\n"
        + "\n".join(rows)
        + "\n"
    )


def test_faces_of_a_mesh_are_sampled_by_area(tmp_path: Path) -> None:
    """A square of one metre at z = 1, and a triangle of a quarter of its area at z = 2: a point for each 2.25 cm2."""
    vertices = np.array(
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1], [0, 0, 2], [1, 0, 2], [0, 0.5, 2], [np.nan, 0, 0]]
    )
    write_mesh(tmp_path / "a.ply", vertices, [[0, 1, 2, 3], [4, 5, 6], [4, 5, 7], [0, 1]])
    notes: list[str] = []
    points = read_cloud(tmp_path / "a.ply", notes)
    assert notes == [
        "5555 points on the faces of a mesh are added to its 8 vertices",
        "1 of 5563 points are left out: they are not finite",
    ]
    np.testing.assert_array_equal(points, read_cloud(tmp_path / "a.ply"))
    square, triangle = (points[7:][points[7:, 2] == z] for z in (1.0, 2.0))
    assert len(square) + len(triangle) == 5555
    assert len(triangle) == pytest.approx(1111, abs=100)
    counts, _, _ = np.histogram2d(square[:, 0], square[:, 1], bins=5, range=[[0, 1], [0, 1]])
    assert counts.sum() == len(square) and counts.min() > 120 and counts.max() < 240  # 178 expected
    assert (triangle[:, :2] >= 0.0).all() and (triangle[:, 0] + 2.0 * triangle[:, 1] <= 1.0 + 1e-12).all()


def test_mesh_with_faces_of_no_area_is_its_vertices(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.ply", POINTS, [[0, 0, 1]])
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.ply"), POINTS)


def test_face_without_its_vertex_is_refused(tmp_path: Path) -> None:
    write_mesh(tmp_path / "a.ply", POINTS, [[0, 1, 3]])
    with pytest.raises(DataError, match="a face refers to a vertex beyond the 3 that there are"):
        read_cloud(tmp_path / "a.ply")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_ply_with_lists_before_vertices(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.ply"
    header = (
        f"ply\nformat {encoding} 1.0\nelement strip 2\nproperty list uchar int vertices\nproperty float area\n"
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


def test_written_pcd_is_read_back(tmp_path: Path) -> None:
    write_pcd(tmp_path / "a.pcd", POINTS)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.pcd"), POINTS)


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


def lzf_literals(data: bytes) -> bytes:
    """An LZF stream without repetitions."""
    runs = [data[start : start + 32] for start in range(0, len(data), 32)]
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def test_compressed_pcd(tmp_path: Path) -> None:
    """Column by column; zeros at the end are a repetition."""
    columns = POINTS.T.astype("<f4").tobytes() + np.array([255] * 3, "<u4").tobytes()
    content = columns + bytes(12)
    # 12 zeros: one literal, then 11 = 9 + 2 bytes from a distance of 0 + 1.
    stream = lzf_literals(columns) + b"\x00\x00" + bytes([7 << 5, 9 - 7, 0])
    path = tmp_path / "a.pcd"
    header = pcd_header("binary_compressed")
    path.write_bytes(header + struct.pack("<II", len(stream), len(content)) + stream)
    np.testing.assert_array_equal(read_cloud(path), POINTS)


def test_lzf_repeats_what_it_writes() -> None:
    assert decompress_lzf(b"\x02abc" + bytes([4 << 5, 2]) + b"\x00d", 10) == b"abcabcabcd"


@pytest.mark.parametrize("suffix", ["xyz", "txt"])
def test_xyz_takes_the_first_three_columns(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_text("# x y z intensity\n" + "".join(f"{x} {y} {z} 9\n" for x, y, z in POINTS))
    np.testing.assert_array_equal(read_cloud(path), POINTS)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "x,y,z,red\n{0},{1},{2},9\n"),
        ("a.csv", "Intensity;Z;X;Y\n9;{2};{0};{1}\n"),
        ("a.txt", "//X Y Z\n{0} {1} {2}\n"),
        ("a.xyz", "{0}, {1}, {2}\n"),
        ("a.csv", "Point ID;x [m];y [m];z [m];\n9;{0};{1};{2};\n"),
        ("a.csv", "id,x,y,z\n,{0},{1},{2}\n"),
        ("a.csv", '"","x","y","z"\n"9",{0},{1},{2}\n'),
    ],
)
def test_commas_and_headers(tmp_path: Path, name: str, text: str) -> None:
    """As spreadsheets, CloudCompare and R write them."""
    *header, row = text.splitlines(keepends=True)
    (tmp_path / name).write_text("".join([*header, *(row.format(*point) for point in POINTS)]))
    np.testing.assert_array_equal(read_cloud(tmp_path / name), POINTS)


@pytest.mark.parametrize("first", ["# Column order: x y z r g", "# exported x y z", "x y z"])
def test_first_line_without_a_name_for_each_column_is_refused(tmp_path: Path, first: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text(f"{first}\n1 0.5 2.5 1.5 7\n2 0.5 2.5 1.6 7\n")
    problem = f"has 5 columns, and its first line names {len(first.strip('# ').split())}"
    refuses_data(lambda: read_cloud(path), path, problem, "name each column by one word in the first line")


def test_rows_may_end_in_a_separator(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x,y,z\n0.5,2.5,1.5,\n")
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.csv"), [[0.5, 2.5, 1.5]])


@pytest.mark.parametrize("header", ["", "x;y;z\n"])
def test_decimal_commas_between_semicolons(tmp_path: Path, header: str) -> None:
    (tmp_path / "a.csv").write_text(f"{header}1,637;1,270;1,041\n-0,5; 2 ;3,25\n")
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.csv"), [[1.637, 1.27, 1.041], [-0.5, 2.0, 3.25]])


@pytest.mark.parametrize(
    "text",
    ["1,637 1,270 1,041\n", "1,637\t1,270\t1,041\n", "1;2;3\n1.234,5;2;3\n", "1,2,3\n1;2;3\n", "1,2,3\n1,,3\n"],
)
def test_unclear_columns_are_refused(tmp_path: Path, text: str) -> None:
    """A decimal comma is no separator, and no column is skipped."""
    (tmp_path / "a.csv").write_text(text)
    problem = r"cannot be read as csv \(could not convert string"
    refuses_data(
        lambda: read_cloud(tmp_path / "a.csv"), tmp_path / "a.csv", problem, "decimal comma needs semicolons"
    )


@pytest.mark.parametrize("binary", [False, True])
def test_points_of_a_colmap_model(tmp_path: Path, capture: Capture, binary: bool) -> None:
    write_colmap(tmp_path, capture, binary, [pinhole_of(capture.camera)], POINTS)
    path = tmp_path / f"sparse/0/points3D.{'bin' if binary else 'txt'}"
    np.testing.assert_array_equal(read_cloud(path), POINTS)


def test_a_byte_order_mark_is_no_number(tmp_path: Path) -> None:
    (tmp_path / "room.xyz").write_bytes(b"\xef\xbb\xbf1 2 3\n4 5 6\n")
    np.testing.assert_array_equal(read_cloud(tmp_path / "room.xyz"), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])


def test_points_that_are_not_finite_are_counted(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\nnan 2 3\n1 inf 3\n")
    notes: list[str] = []
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.xyz", notes), [[1.0, 2.0, 3.0]])
    assert notes == ["2 of 3 points are left out: they are not finite"]


def test_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS.astype(np.float32))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npz"), POINTS)


def pcd_of(points: int, count: int) -> bytes:
    """A header of any numbers, and 16 bytes."""
    return (
        f"FIELDS x y z a\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 {count}\nPOINTS {points}\nDATA binary\n".encode()
        + bytes(16)
    )


def ply_of_faces(length: str, count: int = 1) -> bytes:
    return (
        f"ply\nformat binary_little_endian 1.0\nelement face {count}\n"
        f"property list {length} int vertex_indices\nelement vertex 1\nproperty float x\nend_header\n"
    ).encode()


INVALID_FILES: dict[str, tuple[bytes, str]] = {
    "a.obj": (b"", "has the unknown suffix '.obj'; give one of .bin, .csv, .npz, .pcd, .ply, .txt, .xyz"),
    "empty.ply": (b"", "cannot be read as ply .the first line is not 'ply'."),
    "cut.ply": (ply_header("ascii") + b"7 1 0 1 1\n", "it ends after 1 of 3 rows of 'vertex'"),
    "cutbinary.ply": (ply_header("binary_little_endian") + bytes(40), "it ends after 1 of 3 rows of 'vertex'"),
    "none.ply": (ply_header("ascii", 0), "holds no points; export the cloud again"),
    "nomesh.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 0\nelement face 1\n"
        b"property list uchar int vertex_index\nend_header\n",
        "it ends after 0 of 1 rows of 'face'",
    ),
    "headless.ply": (b"ply\nformat ascii 1.0\n", "the header has no end_header"),
    "zip.ply": (ply_header("binary_zip"), "format 'binary_zip' is none of ascii, binary_little_endian"),
    "pixels.ply": (b"ply\nformat ascii 1.0\nelement pixel 1\nend_header\n\n", "it has no element 'vertex'"),
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
    "zip.pcd": (pcd_header("zip"), "DATA zip is none of ascii, binary, binary_compressed"),
    "headless.pcd": (pcd_header("binary_compressed"), "the compressed data is cut short"),
    "size.pcd2.pcd": (
        pcd_header("binary_compressed") + struct.pack("<II", 3, 1 << 31),
        "the compressed data is of 2147483648 bytes, but 3 points are 60",
    ),
    "cut.pcd": (pcd_header("binary_compressed") + struct.pack("<II", 9, 60), "the compressed data is cut short"),
    "short.pcd": (
        pcd_header("binary_compressed") + struct.pack("<II", 2, 60) + b"\x00a",
        "the compressed data holds 1 of 60 bytes",
    ),
    "far.pcd": (
        pcd_header("binary_compressed") + struct.pack("<II", 4, 60) + b"\x00a\x20\x05",
        "the compressed data is damaged",
    ),
    "uncounted.pcd": (
        b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS -1\nDATA ascii\n",
        "the header does not say how many points there are",
    ),
    "noend.pcd": (b"FIELDS x y z\n", "the header has no DATA"),
    "weights.bin": (b"", "of .bin files, only COLMAP's points3D.bin is a cloud"),
    "points3D.bin": (struct.pack("<Q", 3), "is cut short; export the cloud again"),
    "nofields.pcd": (b"POINTS 3\nDATA ascii\n", "the header has no FIELDS"),
    "type.pcd": (b"FIELDS x\nSIZE 4\nTYPE Q\nPOINTS 3\nDATA ascii\n", "field 'x' has the unknown type 'Q'"),
    "size.pcd": (b"FIELDS x y z\nSIZE 3 3 3\nTYPE F F F\nPOINTS 3\nDATA binary\n", "cannot be read as pcd"),
    "words.xyz": (b"one two three\n", "cannot be read as xyz"),
    "blank.txt": (b"", "holds no points"),
    "nan.xyz": (b"nan 2 3\n1 inf 3\n", "none of its 2 points is finite"),
    "far.xyz": (b"1e6 2 3\n1e300 0 0\n", "all its points are 100 km from the origin and farther; subtract"),
    "endless.pcd": (pcd_of(10**30, 1), "does not say how many points there are"),
    "longer.pcd": (pcd_of(2 * 10**8, 1), "it ends after 1 of 200000000 points"),
    "wide.pcd": (pcd_of(1, 10**12), "COUNT is 1 1 1 1000000000000"),
    "narrow.pcd": (pcd_of(1, 0), "COUNT is 1 1 1 0"),
    "bomb.pcd": (
        pcd_of(10**7, 1)[:-16].replace(b"DATA binary", b"DATA binary_compressed")
        + struct.pack("<II", 2, 160_000_000),
        "the compressed data is cut short",
    ),
    "infinite.ply": (ply_of_faces("float") + struct.pack("<f", np.inf), "a list of 'face' has the length inf"),
    "manyfaces.ply": (ply_of_faces("uchar", 10**9) + bytes(100), "it has 1000000000 rows of 'face', more than"),
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
    for name in ("absent.ply", "points3D.bin", "points3D.txt"):
        with pytest.raises(DataError, match=rf"{name}: there is no such file; check the path"):
            read_cloud(tmp_path / name)
    np.savez(tmp_path / "other.npz", cloud=POINTS)
    with pytest.raises(DataError, match="it has no array 'points'"):
        read_cloud(tmp_path / "other.npz")
    np.savez(tmp_path / "flat.npz", points=np.zeros(3))
    with pytest.raises(DataError, match=r"points must be numbers of shape \(N, 3\), got float64 of shape \(3,\)"):
        read_cloud(tmp_path / "flat.npz")
