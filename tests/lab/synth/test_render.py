"""Rendering: colour, depth and pose agree to a tenth of a pixel; sequences go on where they stopped."""

from __future__ import annotations

import importlib.util
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.cli.main import invoke
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray, invert, make_pose, so3_exp, transform
from monoloc.io.registry import open_recording
from monoloc.io.tum_trajectory import write_tum
from monoloc.progress import NoProgress, Step
from monoloc_lab.synth import random_views as training
from monoloc_lab.synth import sequence as sequences
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.building import empty_room, make_walls
from monoloc_lab.synth.fittings import Opening, pendant
from monoloc_lab.synth.furniture import box
from monoloc_lab.synth.light import LIGHTS, relit
from monoloc_lab.synth.materials import Material, paint
from monoloc_lab.synth.random_views import render_views
from monoloc_lab.synth.render import Picture, Renderer, illuminance, mixed
from monoloc_lab.synth.rooms import Object, Room, read_room, write_room
from monoloc_lab.synth.sensor import SensorConfig, photograph
from monoloc_lab.synth.sequence import RenderConfig, render_sequence

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mitsuba") is None, reason='rendering needs Mitsuba: pip install ".[synth]"'
    ),
]

# Off centre, and not square: mistakes of half a pixel or of a sign show.
CAMERA = Camera(96, 72, 82.0, 82.0, 45.3, 38.1)


def pose_at(eye: tuple[float, float, float], yaw_deg: float, down_deg: float, roll_deg: float = 0.0) -> FloatArray:
    yaw, down = np.deg2rad(yaw_deg), np.deg2rad(down_deg)
    forward = np.array([np.cos(yaw) * np.cos(down), np.sin(yaw) * np.cos(down), -np.sin(down)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    level = np.stack([right, np.cross(forward, right), forward], axis=1)
    return make_pose(level @ so3_exp(np.array([0.0, 0.0, np.deg2rad(roll_deg)])), np.array(eye))


def cube(name: str, size: tuple[float, float, float], place: tuple[float, float], yaw_rad: float = 0.0) -> Object:
    part = box(size, (0.0, 0.0, size[2] / 2.0), paint((0.7, 0.5, 0.3)), 0.0)
    return Object(name, (part,), (*place, 0.0), yaw_rad)


@pytest.fixture(scope="module")
def room() -> Room:
    """A small room with a window behind and two boxes in front of the camera, so that truth is easily told."""
    size = (3.0, 3.2, 2.4)
    rng = np.random.default_rng(5)
    walls = tuple(
        replace(wall, openings=(Opening(0.0, 1.4, 0.9, 2.2),) if wall.name == "south" else ())
        for wall in make_walls(size, rng)
    )
    bare = empty_room(size, walls, 5, rng)
    return bare.add(cube("cube", (0.5, 0.5, 0.5), (1.5, 1.9), 0.4)).add(cube("post", (0.1, 0.1, 1.9), (0.8, 2.2)))


@pytest.fixture(scope="module")
def renderer(room) -> Renderer:
    return Renderer(room, 8)


POSE = pose_at((1.2, 0.5, 1.3), 80.0, 15.0, 6.0)


def test_depth_is_that_of_the_boxes_at_the_pixels_centres(room, renderer):
    picture = renderer.picture(CAMERA, POSE, 0)
    assert picture.depth_m.shape == (72, 96) and picture.depth_m.dtype == np.float32
    assert np.all(picture.depth_m > 0.0)
    points = transform(POSE, CAMERA.back_project(picture.depth_m).reshape(-1, 3))
    # Every point lies on a surface: rounded edges are a few millimetres within their boxes.
    assert np.abs(room.clearance_m(points)).max() < 0.006
    # And just before it there is nothing yet.
    before = transform(POSE, CAMERA.back_project(picture.depth_m - 0.02).reshape(-1, 3))
    assert np.mean(room.clearance_m(before) > -1e-4) > 0.99


def marked_room(marks: FloatArray) -> Room:
    """Dark walls with small bright panels at known places on the north wall, lit by a lamp."""
    size = (3.0, 3.0, 2.4)
    dark, bright = paint((0.1, 0.1, 0.1)), Material("plain", (0.95, 0.95, 0.95), roughness=1.0)
    room = Room(size)
    wall = box((3.4, 0.1, 2.6), (1.5, 3.05, 1.2), dark, 0.0)
    room = room.add(Object("wall north", (wall,), fixed=True))
    for index, (x, z) in enumerate(marks):
        mark = box((0.09, 0.001, 0.09), (float(x), 3.0, float(z)), bright, 0.0)  # sides too thin to be seen
        room = room.add(Object(f"mark {index}", (mark,), fixed=True))
    return room.add(Object("lamp", pendant(0.1, 2000.0), (1.5, 0.3, 2.4), fixed=True))


def test_colour_depth_and_pose_agree_within_a_tenth_of_a_pixel():
    marks = np.array([(x, z) for x in (0.7, 1.3, 1.9, 2.4) for z in (0.6, 1.1, 1.7)])
    camera = Camera(160, 120, 136.6, 136.6, 77.2, 62.4)
    pose = pose_at((1.4, 0.9, 1.2), 86.0, 4.0, 3.0)
    picture = Renderer(marked_room(marks), 128).picture(camera, pose, 1)
    grey = mixed(picture.light, {"daylight": 0.0, "lamps": 1.0}).mean(axis=2)
    centres = np.column_stack([marks[:, 0], np.full(len(marks), 2.9995), marks[:, 1]])
    expected = camera.project(transform(invert(pose), centres))
    errors = []
    for u, v in expected:
        left, top = round(u) - 7, round(v) - 7
        if not (0 <= left < 160 - 15 and 0 <= top < 120 - 15):
            continue
        window = grey[top : top + 15, left : left + 15]
        dark = np.median(window)
        bright = np.median(window[window > 4.0 * dark])
        weight = np.clip((window - dark) / (bright - dark), 0.0, 1.0) * (window > 1.5 * dark)
        y, x = np.mgrid[0:15, 0:15]
        found = np.array([np.sum(weight * x), np.sum(weight * y)]) / weight.sum() + [left, top]
        errors.append(found - [u, v])
        # The depth there takes the pixel back to the mark.
        row, column = round(v), round(u)
        point = picture.depth_m[row, column] * camera.rays(np.array([float(column), float(row)]))
        y_ = transform(pose, point[None])[0, 1]
        assert y_ == pytest.approx(2.9995, abs=1e-4)
    assert len(errors) >= 8
    assert np.linalg.norm(np.mean(errors, axis=0)) < 0.05  # no offset
    assert np.linalg.norm(errors, axis=1).max() < 0.1


def test_normals_face_the_camera_and_windows_are_known(room, renderer):
    window = next(thing for thing in room.objects if thing.name.endswith("window"))
    centre = window.boxes.corners().reshape(-1, 3).mean(axis=0)
    eye = np.array([1.5, 1.6, 1.4])
    yaw = np.rad2deg(np.arctan2(centre[1] - eye[1], centre[0] - eye[0]))
    pose = pose_at(tuple(eye), yaw, 0.0)
    picture = renderer.picture(CAMERA, pose, 0)
    assert 0.02 < picture.glass.mean() < 0.6
    rays = CAMERA.pixel_rays() @ pose[:3, :3].T
    assert np.mean(np.sum(rays * picture.normals, axis=2) < 1e-3) > 0.99
    np.testing.assert_allclose(np.linalg.norm(picture.normals, axis=2), 1.0, atol=1e-3)
    daylight = picture.light["daylight"]
    assert np.median(daylight[picture.glass]) > 10.0 * np.median(daylight[~picture.glass])


def test_same_seed_same_picture_other_seed_same_within_noise(renderer):
    pictures = [renderer.picture(CAMERA, POSE, seed) for seed in (0, 0, 1)]
    for group in ("daylight", "lamps"):
        one, again, other = (picture.light[group] for picture in pictures)
        np.testing.assert_allclose(one, again, rtol=1e-5, atol=1e-5)
        assert not np.array_equal(one, other)
        assert other.mean() == pytest.approx(one.mean(), rel=0.05)
    np.testing.assert_array_equal(pictures[0].depth_m, pictures[2].depth_m)


def test_illuminance_is_linear_in_the_lamps(room):
    """Twice the lumens give twice the lux, and daylight knows nothing of it."""
    dim = illuminance(Renderer(room, 8), room)
    lamp = room["ceiling lamp"]
    parts = tuple(
        replace(part, material=replace(part.material, luminance=2.0 * part.material.luminance)) for part in lamp.parts
    )
    bright_room = room.remove("ceiling lamp").add(replace(lamp, parts=parts))
    bright = illuminance(Renderer(bright_room, 8), bright_room)
    assert bright["lamps"] == pytest.approx(2.0 * dim["lamps"], rel=0.1)
    assert bright["daylight"] == pytest.approx(dim["daylight"], rel=0.1)


def test_real_model_of_light_agrees_with_the_rendered_one_in_histogram(room, renderer):
    """The photometric model on the picture in L2 against the picture rendered in L1 and L3."""
    lux, sensor = illuminance(renderer, room), SensorConfig()
    quantiles = np.arange(0.1, 0.91, 0.1)
    rng = np.random.default_rng(0)
    for name in ("L1", "L3"):
        modelled, rendered = [], []
        for yaw in (60.0, 150.0, 240.0, 330.0):
            picture = renderer.picture(CAMERA, pose_at((1.4, 1.0, 1.3), yaw, 10.0), 3)
            shots = {
                light: photograph(
                    mixed(picture.light, LIGHTS[light].factors(lux)), LIGHTS[light].exposed(sensor), rng
                )
                for light in ("L2", name)
            }
            modelled.append(relit(shots["L2"], LIGHTS[name], rng))
            rendered.append(shots[name])
        model, render = (np.quantile(np.stack(images), quantiles) for images in (modelled, rendered))
        # Lamps and windows light other places; on the whole the two are within a tenth of the grey levels.
        assert np.abs(model - render).max() < 26.0, (name, model, render)


def test_cameras_that_cannot_be_rendered(renderer):
    for camera in (replace(CAMERA, fy=90.0), replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))):
        with pytest.raises(SettingError, match="render with a plain camera"):
            renderer.picture(camera, POSE, 0)


# --- sequences ---


@pytest.fixture(scope="module")
def poses() -> FloatArray:
    return np.stack([pose_at((1.2 + 0.05 * i, 0.5, 1.3), 80.0, 15.0) for i in range(3)])


def render(
    room: Room,
    poses: FloatArray,
    out: Path,
    lights: tuple[str, ...] = ("L2", "L3"),
    moving: FloatArray | None = None,
    **settings: object,
):
    config = RenderConfig(**{"samples": 4, **settings})
    chosen, times_s = [LIGHTS[name] for name in lights], np.arange(len(poses)) / 15.0
    moving = velocities(poses, times_s) if moving is None else moving
    return render_sequence(room, poses, times_s, moving, CAMERA, chosen, config, 7, out, NoProgress())


@pytest.fixture(scope="module")
def rendered(room, poses, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("rendered") / "flight"
    assert [folder.name for folder in render(room, poses, out)] == ["L2", "L3"]
    return out


@pytest.fixture
def flight(rendered, tmp_path) -> Path:
    """A copy to work on."""
    return Path(shutil.copytree(rendered, tmp_path / "flight"))


def test_sequence_is_read_by_the_folder_reader(room, poses, rendered):
    recordings = [open_recording(f"folder:{rendered / light}") for light in ("L2", "L3")]
    for recording in recordings:
        assert len(recording) == 3 and recording.camera == CAMERA and recording.has_depth
        assert recording.poses is not None
        np.testing.assert_allclose(recording.poses, poses, atol=1e-6)
        np.testing.assert_allclose(recording.timestamps_s, np.arange(3) / 15.0, atol=1e-6)
    bright, dark = (recording.color(1).mean() for recording in recordings)
    assert bright > 1.5 * dark
    points = transform(poses[1], CAMERA.back_project(recordings[0].depth(1)).reshape(-1, 3))
    assert np.abs(room.clearance_m(points)).max() < 0.01


def test_images_are_blurred_by_the_velocities_given(room, poses, flight):
    turning = np.zeros((3, 6))
    turning[1, 4] = 6.0  # rad/s
    sharp = cv2.imread(str(flight / "L3" / "color" / "000001.jpg")), cv2.imread(str(flight / "L3/color/000000.jpg"))
    render(room, poses, flight, ("L3",), moving=turning)
    turned = cv2.imread(str(flight / "L3" / "color" / "000001.jpg")), cv2.imread(str(flight / "L3/color/000000.jpg"))
    steps = [[np.abs(np.diff(image.astype(float), axis=1)).mean() for image in pair] for pair in (sharp, turned)]
    assert steps[1][0] < 0.95 * steps[0][0] and steps[1][1] > 0.95 * steps[0][1]


def test_sequence_goes_on_where_it_stopped(room, poses, flight, monkeypatch):
    whole = {
        path: path.read_bytes() for path in flight.rglob("*.*") if path.suffix in (".jpg", ".png", ".txt", ".toml")
    }
    seeds: list[int] = []
    original = Renderer.picture

    def noted(self: Renderer, camera: Camera, pose: FloatArray, seed: int) -> Picture:
        seeds.append(seed)
        return original(self, camera, pose, seed)

    monkeypatch.setattr(Renderer, "picture", noted)
    (flight / "linear" / "000001.npz").unlink()
    (flight / "L3" / "color" / "000002.jpg").unlink()
    render(room, poses, flight)
    assert seeds == [7 + 1]
    assert len(whole) == 2 * 3 + 3 + 1 + 2
    for path, content in whole.items():
        if path.suffix != ".jpg":
            assert path.read_bytes() == content, path
            continue
        before, after = (cv2.imdecode(np.frombuffer(data, np.uint8), 1) for data in (content, path.read_bytes()))
        assert np.abs(before.astype(int) - after.astype(int)).max() <= 2


def test_another_light_needs_no_rendering(room, poses, flight, monkeypatch):
    monkeypatch.setattr(sequences, "Renderer", None)
    assert [folder.name for folder in render(room, poses, flight, ("L1",))] == ["L1"]
    assert len(open_recording(f"folder:{flight / 'L1'}")) == 3
    assert (flight / "L2" / "dataset.toml").is_file()


def test_sensor_depth_has_holes_and_steps(room, poses, flight, monkeypatch):
    exact = open_recording(f"folder:{flight / 'L2'}").depth(0)
    render(room, poses, flight, ("L2",), depth="sensor")
    measured = open_recording(f"folder:{flight / 'L2'}").depth(0)
    seen = measured > 0.0
    assert 0.5 < np.mean(seen) < 0.98
    assert 0.0 < np.median(np.abs(measured[seen] - exact[seen])) < 0.03


def test_two_renderings_are_not_mixed(room, poses, flight):
    with pytest.raises(DataError, match="holds a rendering of other settings; name another folder"):
        render(room.move("cube", (0.1, 0.0, 0.0)), poses, flight)
    assert read_room(flight / "room.json") == room


class _Told(NoProgress):
    """Keeps which steps it is told of."""

    def __init__(self) -> None:
        self.steps: list[int] = []

    @contextmanager
    def task(self, name: str, total: int | None) -> Iterator[Step]:
        yield lambda done, remark="": self.steps.append(done)


def test_training_views_are_pairs(room, tmp_path, monkeypatch):
    monkeypatch.setattr(training, "generate_room", lambda seed: room)
    told = _Told()
    render_views(rooms=2, views=1, samples=2, seed=0, out=tmp_path, progress=told)
    assert told.steps == [1, 2]
    pairs = open_recording(f"folder:{tmp_path}")
    assert len(pairs) == 2 and pairs.poses is None
    for index in range(2):
        assert 40.0 < pairs.color(index).mean() < 220.0
        assert np.median(pairs.depth(index)) > 1.0
    before = (tmp_path / "color" / "000000.jpg").stat().st_mtime_ns
    (tmp_path / "depth" / "000001.png").unlink()
    told = _Told()
    render_views(rooms=2, views=1, samples=2, seed=0, out=tmp_path, progress=told)
    assert told.steps == [2]
    assert (tmp_path / "color" / "000000.jpg").stat().st_mtime_ns == before
    assert (tmp_path / "depth" / "000001.png").is_file()
    for other in ({"seed": 1}, {"samples": 3}, {"views": 2}):
        with pytest.raises(DataError, match="holds a rendering of other settings; name another folder"):
            render_views(
                **{"rooms": 2, "views": 1, "samples": 2, "seed": 0, **other}, out=tmp_path, progress=NoProgress()
            )
    render_views(rooms=1, views=1, samples=2, seed=0, out=tmp_path, progress=NoProgress())


def test_progress_of_training_views_is_by_the_view(room, tmp_path, monkeypatch):
    monkeypatch.setattr(training, "generate_room", lambda seed: room)
    told = _Told()
    render_views(rooms=1, views=2, samples=1, seed=0, out=tmp_path, progress=told)
    assert told.steps == [1, 2]


def test_render_command_writes_recordings(room, poses, tmp_path, capfd):
    write_room(tmp_path / "room.json", room)
    write_tum(tmp_path / "way.txt", np.arange(3) / 30.0, poses)
    given = ["--room", str(tmp_path / "room.json"), "--poses", str(tmp_path / "way.txt"), "--samples", "1"]
    options = ["--width", "64", "--every", "2", "--light", "L1", "--light", "L3"]
    assert invoke(["synth", "render", *given, *options, "--out", str(tmp_path / "out"), "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told == {"recordings": [str(tmp_path / "out" / light) for light in ("L1", "L3")], "frames": 2}
    for folder in told["recordings"]:
        recording = open_recording(f"folder:{folder}")
        assert (recording.camera.width, recording.camera.height) == (64, 48)
        np.testing.assert_allclose(recording.timestamps_s, [0.0, 2.0 / 30.0], atol=1e-6)
    assert read_room(tmp_path / "out" / "room.json") == room
    write_room(tmp_path / "room.json", room.move("cube", (0.1, 0.0, 0.0)))
    assert invoke(["synth", "render", *given, *options, "--out", str(tmp_path / "out")]) == 2
    assert "room.json is another room; name another folder" in capfd.readouterr().err
    write_room(tmp_path / "room.json", room)
    again = [*options[:-4], "--light", "L1", "--seed", "5"]
    assert invoke(["synth", "render", *given, *again, "--out", str(tmp_path / "out")]) == 2
    assert "holds a rendering of other settings" in capfd.readouterr().err
    assert read_room(tmp_path / "out" / "room.json") == room
