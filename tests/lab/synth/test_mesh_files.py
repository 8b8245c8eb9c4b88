"""Meshes from ply files, and rooms from meshes."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc_lab.synth.layout import imported_room
from monoloc_lab.synth.mesh_files import read_mesh
from monoloc_lab.synth.rooms import Room


def cube_ply(encoding: str, side: float = 2.0) -> bytes:
    """A hollow cube of six quads."""
    corners = np.array(list(itertools.product((0.0, side), repeat=3)))
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    header = (
        f"ply\nformat {encoding} 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if encoding == "ascii":
        lines = [f"{x} {y} {z} 200" for x, y, z in corners] + [f"4 {a} {b} {c} {d}" for a, b, c, d in quads]
        return header + "\n".join(lines).encode() + b"\n"
    body = b"".join(c.astype("<f4").tobytes() + b"\xc8" for c in corners)
    return header + body + b"".join(b"\x04" + np.array(q, dtype="<i4").tobytes() for q in quads)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_room_from_a_mesh(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "scan.ply").write_bytes(cube_ply(encoding))
    mesh = read_mesh(tmp_path / "scan.ply")
    assert len(mesh.faces) == 12 and np.ptp(mesh.vertices, axis=0) == pytest.approx([2.0, 2.0, 2.0])
    room = imported_room(tmp_path / "scan.ply")
    assert room.size == (2.0, 2.0, 2.0) and "scan" in room.names
    assert room.clearance_m(np.array([[1.0, 1.0, 0.5]]))[0] == pytest.approx(0.5, abs=0.1)
    assert Room.from_json(room.to_json()) == room


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_further_properties_of_faces_are_ignored(tmp_path: Path, encoding: str) -> None:
    """A colour before the corners, a list of numbers after them, and edges after the faces."""
    header, _, body = cube_ply(encoding).partition(b"end_header\n")
    corners = b"property list uchar int vertex_indices\n"
    more = b"property uchar red\n" + corners + b"property list uchar float texcoord\n"
    header = header.replace(corners, more + b"element edge 1\nproperty int vertex1\nproperty int vertex2\n")
    if encoding == "ascii":
        lines = body.decode().splitlines()
        faces = [f"7 {line} {count} {'0.5 ' * count}" for count, line in enumerate(lines[8:])]
        body = "\n".join([*lines[:8], *faces, "0 1"]).encode()
    else:
        vertices, quads = body[: 8 * 13], np.frombuffer(body[8 * 13 :], np.uint8).reshape(6, 17)
        floats = [bytes([count]) + np.full(count, 0.5, "<f4").tobytes() for count in range(6)]
        faces = [b"\x07" + quad.tobytes() + after for quad, after in zip(quads, floats, strict=True)]
        body = vertices + b"".join(faces) + np.array([0, 1], "<i4").tobytes()
    (tmp_path / "plain.ply").write_bytes(cube_ply(encoding))
    (tmp_path / "scan.ply").write_bytes(header + b"end_header\n" + body)
    plain, mesh = (read_mesh(tmp_path / f"{name}.ply") for name in ("plain", "scan"))
    np.testing.assert_array_equal(mesh.vertices, plain.vertices)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"ply\nformat ascii 1.0\n",
        b"solid x",
        cube_ply("ascii")[:-20],
        cube_ply("binary_little_endian")[:-20],
        cube_ply("ascii").replace(b"format ascii 1.0\n", b""),
        cube_ply("ascii").replace(b"ascii", b"binary_big_endian"),
        cube_ply("ascii").replace(b"list uchar int", b"uchar"),
        cube_ply("ascii").replace(b"vertex_indices", b"other"),
        cube_ply("ascii").replace(b"4 0", b"-4 0"),
        cube_ply("ascii").replace(b"4 0", b"4 nan"),
        cube_ply("ascii").replace(b"4 0", b"inf 0"),
    ],
)
def test_broken_mesh_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "scan.ply").write_bytes(content)
    with pytest.raises(DataError, match=r"scan.ply: .*export it as a ply of triangles"):
        read_mesh(tmp_path / "scan.ply")
