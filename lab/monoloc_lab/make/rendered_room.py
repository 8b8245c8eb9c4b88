"""Render a room for ``monoloc reproduce``: a build flight in L2, and a test flight in L1, L2 and L3.

    python -m monoloc_lab.make.rendered_room --work runs/living --out lab/monoloc_lab/rooms/living
    python -m monoloc_lab.make.rendered_room --seed 4 --work runs/room-4 --out rooms/4

Without a seed, it is the living room of the package. A stopped rendering continues when the same command is given
again. It takes about ten minutes on two cores. The two flights have different seeds. The build flight takes 30 s at
5 Hz, with the depth of a structured-light sensor. The test flight takes 10 s at 15 Hz, with exact depth, which is
only used to evaluate depth.
"""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console

from monoloc.camera import Camera
from monoloc.progress import ConsoleProgress
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.flights import FlightConfig, plan_flight
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.light import LIGHTS
from monoloc_lab.synth.sequence import RenderConfig, render_sequence

ROOM_SEED = 3  # of the room of the package
CAMERA = Camera(160, 120, 136.6, 136.6, 79.5, 59.5)  # the field of view of NYU
DEPTH_SCALE = 200.0  # steps of 5 mm: files a third smaller than in millimetres


@dataclass(frozen=True)
class RenderedFlight:
    """A flight and its rendering: every ``every``-th of its 30 poses per second, with ``samples`` paths per pixel.

    Its seed is that of the room, and ``seed_offset``.
    """

    seed_offset: int
    flight: FlightConfig
    every: int
    samples: int
    lights: tuple[str, ...]
    depth: Literal["exact", "sensor"]


FLIGHTS = {
    "build": RenderedFlight(1, FlightConfig(seconds=30.0, look_spread_deg=60.0), 6, 32, ("L2",), "sensor"),
    "test": RenderedFlight(
        0, FlightConfig(seconds=10.0, look_spread_deg=40.0, yaw_rate_deg=40.0), 2, 16, ("L1", "L2", "L3"), "exact"
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=ROOM_SEED, help="of the room")
    parser.add_argument("--work", type=Path, required=True, help="folder of the rendered light")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    room = generate_room(arguments.seed)
    paths = {}
    for name, rendered in FLIGHTS.items():
        seed = arguments.seed + rendered.seed_offset
        flight = plan_flight(room, rendered.flight, seed)
        times, poses = flight.times_s[:: rendered.every], flight.camera_poses()[:: rendered.every]
        paths[name] = poses
        lights = [LIGHTS[light] for light in rendered.lights]
        config = RenderConfig(rendered.samples, rendered.depth, DEPTH_SCALE, jpeg_quality=90)
        folder, progress = arguments.work / name, ConsoleProgress(Console(stderr=True))
        # Velocities between the images, not of the flight: the shipped images were made this way.
        moving = velocities(poses, times)
        render_sequence(room, poses, times, moving, CAMERA, lights, config, seed, folder, progress)
        target = arguments.out / name
        if target.exists():
            shutil.rmtree(target)
        shutil.copytree(folder, target, ignore=shutil.ignore_patterns("linear", "settings.json", "room.json"))
    apart = np.linalg.norm(paths["test"][:, None, :3, 3] - paths["build"][None, :, :3, 3], axis=2).min(axis=1)
    size = sum(file.stat().st_size for file in arguments.out.rglob("*") if file.is_file())
    print(json.dumps({"bytes": size, "nearest_build_view_median_m": round(float(np.median(apart)), 3)}))


if __name__ == "__main__":
    main()
