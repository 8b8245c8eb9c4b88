"""Rooms: repeatable, furnished without collisions, editable; their meshes are what their boxes say."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from monoloc.errors import DataError, SettingError
from monoloc.geometry import make_pose, so3_exp
from monoloc_lab.synth.boxes import Boxes
from monoloc_lab.synth.furniture import chair, table
from monoloc_lab.synth.layout import generate_room, imported_room
from monoloc_lab.synth.materials import Material, wood
from monoloc_lab.synth.mesh_files import read_mesh
from monoloc_lab.synth.rooms import Object, Room, read_room, write_room
from monoloc_lab.synth.scene import room_meshes
from monoloc_lab.synth.shapes import Mesh, box, cylinder, ellipsoid, panel
from monoloc_lab.synth.textures import TEXTURES, texture

SEEDS = range(8)
OAK = wood((0.8, 0.6, 0.4), (0.6, 0.4, 0.3))


@pytest.fixture(scope="module")
def rooms() -> list[Room]:
    return [generate_room(seed) for seed in SEEDS]


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


# --- boxes ---


def test_distance_to_boxes_is_that_to_their_points():
    rng = np.random.default_rng(0)
    pose = make_pose(so3_exp(np.array([0.3, -0.5, 0.8])), np.array([1.0, 2.0, 0.5]))
    boxes = Boxes(pose[None], np.array([[0.3, 0.6, 0.2]]))
    inside = rng.uniform(-1.0, 1.0, (200_000, 3)) * boxes.half_sizes[0]
    cloud = inside @ pose[:3, :3].T + pose[:3, 3]
    points = rng.uniform(-1.0, 4.0, (20, 3))
    distance = boxes.distance_m(points)
    nearest = np.linalg.norm(points[:, None] - cloud[None], axis=2).min(axis=1)
    outside = distance > 0.05
    assert outside.sum() > 10
    np.testing.assert_allclose(distance[outside], nearest[outside], atol=0.03)
    assert boxes.distance_m(pose[None, :3, 3])[0] == pytest.approx(-0.2)


def test_boxes_intersect_exactly_when_a_point_is_in_both():
    rng = np.random.default_rng(1)
    agreed = {True: 0, False: 0}
    for _ in range(60):
        poses = make_pose(so3_exp(rng.normal(size=(2, 3))), rng.uniform(-0.8, 0.8, (2, 3)))
        one, other = (Boxes(pose[None], rng.uniform(0.2, 0.7, (1, 3))) for pose in poses)
        points = rng.uniform(-1.0, 1.0, (20_000, 3)) * one.half_sizes[0] @ poses[0, :3, :3].T + poses[0, :3, 3]
        shared = bool((other.distance_m(points) < -0.01).any())
        if shared:
            assert one.intersect(other) and other.intersect(one)
        elif one.intersect(other):
            continue  # cut by less than the points can tell
        agreed[shared] += 1
    assert min(agreed.values()) > 10


# --- shapes ---


@pytest.mark.parametrize(
    ("mesh", "volume", "area"),
    [
        (box(np.array([0.5, 1.0, 2.0])), 1.0, 7.0),
        (cylinder(np.array([1.0, 1.0, 2.0])), np.pi / 2.0, 2.5 * np.pi),
        (cylinder(np.array([1.0, 1.0, 3.0]), taper=0.0), np.pi / 4.0, None),
        (ellipsoid(np.array([2.0, 2.0, 2.0])), 4.0 * np.pi / 3.0, 4.0 * np.pi),
    ],
)
def test_shapes_are_closed_and_face_outwards(mesh: Mesh, volume: float, area: float | None):
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
    # Gauss: the flux of x / 3 through an outward surface is its volume. Circles of 28 corners lose two percent.
    assert np.sum(corners.mean(axis=1) * normals) / 3.0 == pytest.approx(volume, rel=0.03)
    if area is not None:
        assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(area, rel=0.03)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-9)
    flat = np.linalg.norm(normals, axis=1) > 1e-9
    agrees = np.sum(mesh.normals[mesh.faces].mean(axis=1) * normals, axis=1)
    assert np.all(agrees[flat] > 0.0)


def test_rounded_box_stays_within_the_sharp_one():
    sharp, rounded = np.array([0.4, 0.6, 0.2]), box(np.array([0.4, 0.6, 0.2]), 0.05)
    assert np.all(np.abs(rounded.vertices) <= sharp / 2.0 + 1e-9)
    np.testing.assert_allclose(np.abs(rounded.vertices).max(axis=0), sharp / 2.0)
    assert np.linalg.norm(rounded.vertices, axis=1).max() < np.linalg.norm(sharp / 2.0) - 0.02


def test_panel_shows_its_picture_upright_to_who_stands_before_it():
    mesh = panel(np.array([2.0, 0.0, 1.0]))
    np.testing.assert_allclose(mesh.normals, [[0.0, -1.0, 0.0]] * len(mesh.normals), atol=1e-12)
    np.testing.assert_allclose(mesh.span, mesh.vertices[:, [0, 2]] / [2.0, 1.0] + 0.5)


# --- rooms ---


@pytest.mark.slow
def test_same_seed_same_bytes_other_seed_other_room(rooms):
    assert [generate_room(seed).to_json() for seed in SEEDS] == [room.to_json() for room in rooms]
    assert len({room.to_json() for room in rooms}) == len(rooms)
    for mesh, again in zip(room_meshes(rooms[0]).values(), room_meshes(generate_room(0)).values(), strict=True):
        assert mesh.vertices.tobytes() == again.vertices.tobytes()
        assert mesh.faces.tobytes() == again.faces.tobytes()


def test_rooms_are_furnished(rooms):
    for room in rooms:
        assert {"floor", "ceiling", "door", "ceiling lamp"} <= set(room.names)
        assert sum(name.startswith("wall") for name in room.names) == 4
        assert any(name.endswith("window") for name in room.names)
        assert sum(not thing.fixed for thing in room.objects) >= 10
    everything = {name.rstrip(" 0123456789") for room in rooms for name in room.names}
    assert {
        "sofa",
        "table",
        "chair",
        "bookcase",
        "floor lamp",
        "plant",
        "carpet",
        "poster",
        "landscape",
    } <= everything


def test_nothing_loose_cuts_into_anything(rooms):
    for room in rooms:
        loose = [thing for thing in room.objects if not (thing.fixed or thing.underfoot)]
        for one, other in itertools.combinations(loose, 2):
            assert not one.intersects(other), f"{one.name} and {other.name} of room {room.seed}"
        for thing in loose:
            assert room.remove(thing.name).blocker(thing) is None


def test_everything_stands_on_something(rooms):
    for room in rooms:
        tops = [0.0, *(float(thing.boxes.corners()[..., 2].max()) for thing in room.objects)]
        for thing in room.objects:
            bottom = float(thing.boxes.corners()[..., 2].min())
            hangs = thing.fixed or thing.name.startswith(("poster", "landscape"))
            assert hangs or min(abs(bottom - top) for top in tops) < 0.015, thing.name


def test_meshes_fill_the_boxes(rooms):
    room = rooms[1]
    vertices = np.concatenate([mesh.vertices for mesh in room_meshes(room).values()])
    corners = np.concatenate([thing.boxes.corners().reshape(-1, 3) for thing in room.objects])
    np.testing.assert_allclose(vertices.min(axis=0), corners.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(vertices.max(axis=0), corners.max(axis=0), atol=1e-6)


def test_a_chair_moved_is_one_line():
    room = Room((4.0, 4.0, 2.5)).add(Object("chair", chair(OAK, OAK), (1.0, 1.0, 0.0)))
    moved = room.move("chair", (1.5, 0.0, 0.0), turn_rad=0.5)
    assert moved["chair"].position == (2.5, 1.0, 0.0) and moved["chair"].yaw_rad == 0.5
    assert room["chair"].position == (1.0, 1.0, 0.0)
    assert moved.remove("chair").names == []
    beside = np.array([[1.0, 1.0, 0.44]])
    assert room.clearance_m(beside)[0] < 0.0 < moved.clearance_m(beside)[0]


def test_edits_that_cannot_be(tmp_path):
    room = Room((4.0, 4.0, 2.5)).add(Object("table", table(1.2, 0.8, 0.74, OAK, OAK), (2.0, 2.0, 0.0)))
    with pytest.raises(SettingError, match="there is no 'chair'; choose one of table"):
        room.move("chair")
    with pytest.raises(SettingError, match="'table' is there already"):
        room.add(Object("table", chair(OAK, OAK), (0.5, 0.5, 0.0)))
    with pytest.raises(SettingError, match="chair: cuts into table"):
        room.add(Object("chair", chair(OAK, OAK), (2.0, 2.0, 0.35)))
    with pytest.raises(SettingError, match="table: cuts into the walls"):
        room.move("table", (1.8, 0.0, 0.0))


def test_room_survives_its_file(tmp_path, rooms):
    write_room(tmp_path / "room.json", rooms[2])
    assert read_room(tmp_path / "room.json") == rooms[2]
    with pytest.raises(DataError, match=r"none.json: cannot be read .*monoloc synth room"):
        read_room(tmp_path / "none.json")
    (tmp_path / "other.json").write_text('{"size": [1, 2, 3], "objects": [{"name": 3}]}')
    with pytest.raises(DataError, match=r"other.json: is not a room"):
        read_room(tmp_path / "other.json")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_room_of_a_mesh(tmp_path, encoding):
    (tmp_path / "scan.ply").write_bytes(cube_ply(encoding))
    mesh = read_mesh(tmp_path / "scan.ply")
    assert len(mesh.faces) == 12 and np.ptp(mesh.vertices, axis=0) == pytest.approx([2.0, 2.0, 2.0])
    room = imported_room(tmp_path / "scan.ply")
    assert room.size == (2.0, 2.0, 2.0) and "scan" in room.names
    assert room.clearance_m(np.array([[1.0, 1.0, 0.5]]))[0] == pytest.approx(0.5, abs=0.1)
    assert Room.from_json(room.to_json()) == room


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_mesh_whose_faces_have_more_than_corners(tmp_path, encoding):
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
def test_mesh_that_is_none(tmp_path, content):
    (tmp_path / "scan.ply").write_bytes(content)
    with pytest.raises(DataError, match=r"scan.ply: .*export it as a ply of triangles"):
        read_mesh(tmp_path / "scan.ply")


# --- textures ---


@pytest.mark.parametrize("name", list(TEXTURES))
def test_textures_repeat_and_tile(name):
    material = Material(name, (0.6, 0.5, 0.4), (0.3, 0.2, 0.1), seed=5)
    image = texture(material)
    assert image.dtype == np.float32 and image.shape[2] == 3
    assert image.min() >= 0.0 and image.max() <= 1.0
    assert image.tobytes() == texture(material).tobytes()
    if name == "plain":
        return
    assert image.std() > 0.003
    assert texture(material.seeded(6)).tobytes() != image.tobytes()
    if name in ("plaster", "wood", "fabric", "leaves", "brick"):
        # A seam would differ by more than any neighbours within do, joints included.
        steps = np.abs(np.diff(image, axis=1)).mean(axis=(0, 2))
        assert np.abs(image[:, 0] - image[:, -1]).mean() < 1.3 * steps.max()
