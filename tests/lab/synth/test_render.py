"""Rendering: colour, depth and pose agree to a tenth of a pixel."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, invert, transform
from monoloc_lab.synth.fittings import pendant
from monoloc_lab.synth.furniture import box
from monoloc_lab.synth.light import LIGHTS, relit
from monoloc_lab.synth.materials import Material, paint
from monoloc_lab.synth.render import Renderer, illuminance, mixed
from monoloc_lab.synth.rooms import Object, Room
from monoloc_lab.synth.sensor import SensorConfig, photograph
from rendered_room import CAMERA, POSE, pose_at, windowed_room

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mitsuba") is None, reason='rendering needs Mitsuba: pip install "./lab[synth]"'
    ),
]


@pytest.fixture(scope="module")
def room() -> Room:
    return windowed_room()


@pytest.fixture(scope="module")
def renderer(room: Room) -> Renderer:
    return Renderer(room, 8)


def test_depth_is_that_of_the_boxes_at_pixel_centres(room: Room, renderer: Renderer) -> None:
    picture = renderer.picture(CAMERA, POSE, 0)
    assert picture.depth_m.shape == (72, 96) and picture.depth_m.dtype == np.float32
    assert np.all(picture.depth_m > 0.0)
    points = transform(POSE, CAMERA.back_project(picture.depth_m).reshape(-1, 3))
    # Points lie on surfaces; rounded edges are a few millimetres inside their boxes.
    assert np.abs(room.clearance_m(points)).max() < 0.006
    # Points before them are free.
    before = transform(POSE, CAMERA.back_project(picture.depth_m - 0.02).reshape(-1, 3))
    assert np.mean(room.clearance_m(before) > -1e-4) > 0.99


def test_even_light_shows_the_same_surfaces_without_lamps(room: Room, renderer: Renderer) -> None:
    traced, even = renderer.picture(CAMERA, POSE, 0), Renderer(room, 8, is_even=True).picture(CAMERA, POSE, 0)
    np.testing.assert_array_equal(even.depth_m, traced.depth_m)
    assert not even.light["lamps"].any()
    # Luminance is that of the albedo in one light, but for the direction of the surface.
    lux = np.pi * even.light["daylight"] / np.maximum(even.albedo, 1e-3)
    assert np.percentile(lux, 5.0) > 150.0 and np.percentile(lux, 95.0) < 450.0


def marked_room(marks: FloatArray) -> Room:
    """Dark walls with small bright panels at known places on the north wall, lit by a lamp."""
    size = (3.0, 3.0, 2.4)
    dark, bright = paint((0.1, 0.1, 0.1)), Material("plain", (0.95, 0.95, 0.95), roughness=1.0)
    room = Room(size)
    wall = box((3.4, 0.1, 2.6), (1.5, 3.05, 1.2), dark, 0.0)
    room = room.add(Object("wall north", (wall,), fixed=True))
    for index, (x, z) in enumerate(marks):
        mark = box(
            (0.09, 0.001, 0.09), (float(x), 3.0, float(z)), bright, 0.0
        )  # too thin for its sides to be visible
        room = room.add(Object(f"mark {index}", (mark,), fixed=True))
    return room.add(Object("lamp", pendant(0.1, 2000.0), (1.5, 0.3, 2.4), fixed=True))


def test_colour_depth_and_pose_agree_within_a_tenth_of_a_pixel() -> None:
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
        # The depth of the pixel leads back to the mark.
        row, column = round(v), round(u)
        point = picture.depth_m[row, column] * camera.rays(np.array([float(column), float(row)]))
        y_ = transform(pose, point[None])[0, 1]
        assert y_ == pytest.approx(2.9995, abs=1e-4)
    assert len(errors) >= 8
    assert np.linalg.norm(np.mean(errors, axis=0)) < 0.05  # no offset
    assert np.linalg.norm(errors, axis=1).max() < 0.1


def test_normals_face_the_camera_and_windows_are_known(room: Room, renderer: Renderer) -> None:
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


def test_seed_determines_the_noise(renderer: Renderer) -> None:
    pictures = [renderer.picture(CAMERA, POSE, seed) for seed in (0, 0, 1)]
    for group in ("daylight", "lamps"):
        one, again, other = (picture.light[group] for picture in pictures)
        np.testing.assert_allclose(one, again, rtol=1e-5, atol=1e-5)
        assert not np.array_equal(one, other)
        assert other.mean() == pytest.approx(one.mean(), rel=0.05)
    np.testing.assert_array_equal(pictures[0].depth_m, pictures[2].depth_m)


def test_illuminance_is_linear_in_the_lamps(room: Room) -> None:
    """Twice the lumens give twice the lux, and do not change daylight."""
    dim = illuminance(Renderer(room, 8), room)
    lamp = room["ceiling lamp"]
    parts = tuple(
        replace(part, material=replace(part.material, luminance=2.0 * part.material.luminance)) for part in lamp.parts
    )
    bright_room = room.remove("ceiling lamp").add(replace(lamp, parts=parts))
    bright = illuminance(Renderer(bright_room, 8), bright_room)
    assert bright["lamps"] == pytest.approx(2.0 * dim["lamps"], rel=0.1)
    assert bright["daylight"] == pytest.approx(dim["daylight"], rel=0.1)


def test_simulated_light_has_the_histogram_of_the_rendered_one(room: Room, renderer: Renderer) -> None:
    """L1 and L3 simulated on the picture in L2, against rendered L1 and L3."""
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
        # Lamps and windows illuminate different places, but the histograms agree to a tenth of grey levels.
        assert np.abs(model - render).max() < 26.0, (name, model, render)


def test_unsuitable_cameras_are_refused(renderer: Renderer) -> None:
    for camera in (replace(CAMERA, fy=90.0), replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0, 0.0))):
        with pytest.raises(SettingError, match="render with a plain camera"):
            renderer.picture(camera, POSE, 0)


def test_ctrl_c_in_a_rendering_is_no_other_error(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise RuntimeError("error while performing a custom differentiable operation") from KeyboardInterrupt()

    monkeypatch.setattr("mitsuba.render", interrupted)
    with pytest.raises(KeyboardInterrupt):
        renderer.picture(CAMERA, POSE, 0)
