"""A training set for depth networks: random views of many rooms, each in a random light.

The layout is that of the ``folder`` reader's pairs: ``color/000000.jpg``, ``depth/000000.png``, ``dataset.toml``.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.files import write_whole
from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc.io.dataset_description import FILE_NAME
from monoloc.progress import Progress, Step
from monoloc_lab.synth.flights import FlightConfig, free_places
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.light import Light
from monoloc_lab.synth.render import Picture, Renderer, illuminance, mixed
from monoloc_lab.synth.rooms import Room
from monoloc_lab.synth.sensor import SensorConfig, photograph
from monoloc_lab.synth.sequence import camera_lines, claim, depth_png

# The field of view of NYU Depth v2, at a small size.
CAMERA = Camera(208, 156, 177.6, 177.6, 103.5, 77.5)
DEPTH_SCALE = 1000.0
_PLACES = FlightConfig(clearance_m=0.25, low_m=0.6, high_m=2.0)
_LEAST_DEPTH_M, _MOST_GLASS = 1.0, 0.3  # median; share of the view


def random_light(rng: np.random.Generator) -> Light:
    """A random light, well exposed; training darkens views itself."""
    return Light("any", float(np.exp(rng.uniform(np.log(60.0), np.log(2000.0)))), float(rng.uniform(0.05, 0.95)))


def random_view(room: Room, rng: np.random.Generator) -> FloatArray:
    """A random pose ``T_world_camera`` at a free position, mostly level, (4, 4)."""
    (place,) = free_places(room, _PLACES, rng, 1)
    across = np.array(room.size) / 2.0 - place
    yaw = np.arctan2(across[1], across[0]) + np.deg2rad(60.0) * rng.standard_normal()
    pitch, roll = np.deg2rad(rng.normal(10.0, 12.0)), np.deg2rad(rng.normal(0.0, 3.0))
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    level = np.stack([right, np.cross(forward, right), forward], axis=1)
    return make_pose(level @ so3_exp(np.array([0.0, 0.0, roll])), place)


def shows_a_room(picture: Picture) -> bool:
    """Whether a view shows more than a close surface or a window."""
    return bool(np.median(picture.depth_m) >= _LEAST_DEPTH_M and picture.glass.mean() <= _MOST_GLASS)


def render_views(rooms: int, views: int, samples: int, seed: int, out: Path, progress: Progress) -> None:
    """Render a training set; views that an earlier call rendered are reused.

    Args:
        rooms: number of rooms, with seeds from ``seed`` on.
        views: per room.

    Raises:
        MissingExtraError: Mitsuba is not installed.
        DataError: the folder has a rendering with other settings (the number of rooms may differ), or a file cannot
            be written.
    """
    claim(out, {"views": views, "samples": samples, "seed": seed})
    for name in ("color", "depth"):
        (out / name).mkdir(exist_ok=True)
    with progress.task("views", rooms * views) as step:
        for number in range(rooms):
            first = number * views
            if not (out / "depth" / f"{first + views - 1:06d}.png").is_file():
                _render_room(seed + number, views, samples, out, first, step)
    description = f"""\
kind = "pairs"
color = "color/{{index:06d}}.jpg"
depth = "depth/{{index:06d}}.png"
count = {rooms * views}
{camera_lines(CAMERA)}
depth_scale = {DEPTH_SCALE}
"""
    write_whole(out / FILE_NAME, description.encode())


def _render_room(seed: int, views: int, samples: int, out: Path, first: int, step: Step) -> None:
    rng = np.random.default_rng([seed, 0x71E5])
    room = generate_room(seed)
    renderer = Renderer(room, samples)
    lux = illuminance(renderer, room)
    index = first
    while index < first + views:
        pose = random_view(room, rng)
        light = random_light(rng)
        picture = renderer.picture(CAMERA, pose, int(rng.integers(1 << 30)))
        if not shows_a_room(picture):
            continue
        color = photograph(mixed(picture.light, light.factors(lux)), SensorConfig(), rng)
        write_whole(out / "color" / f"{index:06d}.jpg", _jpeg(color))
        write_whole(out / "depth" / f"{index:06d}.png", depth_png(picture.depth_m, DEPTH_SCALE))
        index += 1
        step(index)


def _jpeg(color: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".jpg", color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])[1])
