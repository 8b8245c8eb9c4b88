"""Walks and flights through rendered rooms, for the benchmarks beside this file."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from monoloc.adapt.settings import AdaptConfig
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import Bundle, read_bundle
from monoloc.camera import Camera
from monoloc.config import override
from monoloc.geometry import FloatArray, se3_exp
from monoloc.io.recording import Recording, Relight
from monoloc.io.registry import open_recording
from monoloc.progress import ConsoleProgress, NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.flights import Flight, FlightConfig, plan_flight
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.light import LIGHTS
from monoloc_lab.synth.rooms import Room
from monoloc_lab.synth.sequence import RenderConfig, render_sequence

PHONE = Camera(480, 360, 415.0, 415.0, 239.5, 179.5)
PROGRESS = ConsoleProgress(Console(stderr=True))
_STARTS = 2
_FLIGHT = FlightConfig(seconds=30.0, speed=0.5, acceleration=0.8, yaw_rate_deg=40.0)
_OFF, _PERIODS_S = np.repeat([0.15, 0.12], 3), np.array([7.0, 9.0, 11.0, 8.0, 10.0, 12.0])  # of a flight, a twist


@dataclass(frozen=True)
class RenderedRoom:
    """A room of some seed, whose renderings are kept in a folder; ``samples`` are of the light of a pixel."""

    folder: Path
    seed: int

    @property
    def room(self) -> Room:
        return generate_room(self.seed)

    def planned(self, number: int = 1) -> Flight:
        """One of the flights through the room; the first is the walk."""
        return plan_flight(self.room, _FLIGHT, 10 * self.seed + number)

    def walk(self, name: str, camera: Camera, samples: int) -> Recording:
        """The walk at 3.3 images a second."""
        walk = self.planned()
        poses, times_s = walk.camera_poses()[::9], walk.times_s[::9]
        return self.render(name, poses, times_s, camera, samples, 10 * self.seed + 1)

    def beside_the_walk(self, name: str, camera: Camera, samples: int) -> Recording:
        """A flight 15 cm and 7 degrees off the walk (standard deviations)."""
        return self._beside(slice(90, 700, 8), name, camera, samples)

    def beside_at_30_hz(self, camera: Camera) -> Recording:
        """The first eight seconds of it at 30 images a second."""
        return self._beside(slice(90, 330), "beside-at-30-hz", camera, 1)

    def _beside(self, chosen: slice, name: str, camera: Camera, samples: int) -> Recording:
        walk = self.planned()
        phase = np.random.default_rng(self.seed).uniform(0.0, 2.0 * np.pi, 6)
        off = _OFF * np.sin(2.0 * np.pi * walk.times_s[chosen, None] / _PERIODS_S + phase)
        poses = walk.camera_poses()[chosen] @ se3_exp(off)
        return self.render(name, poses, walk.times_s[chosen] - walk.times_s[90], camera, samples, 5)

    def elsewhere(self, name: str, camera: Camera, samples: int) -> Recording:
        """Another flight through the room."""
        flight = self.planned(2)
        poses, times_s = flight.camera_poses()[0:800:8], flight.times_s[0:800:8]
        return self.render(name, poses, times_s, camera, samples, 6)

    def render(
        self, name: str, poses: FloatArray, times_s: FloatArray, camera: Camera, samples: int, noise: int
    ) -> Recording:
        self.folder.mkdir(parents=True, exist_ok=True)
        config, blur = RenderConfig(samples=samples, is_even=True), velocities(poses, times_s)
        given = (blur, camera, [LIGHTS["L1"]], config, noise, self.folder / name, PROGRESS)
        return open_recording(f"folder:{render_sequence(self.room, poses, times_s, *given)[0]}")


def bundle_of(walk: Recording, path: str | None) -> Bundle:
    """The bundle at a path, or one that is built without tuning."""
    if path is not None:
        return read_bundle(path)
    config = BuildConfig(adapt=AdaptConfig(tune="none", map_transform=False))
    return build_bundle(walk, config, 0, progress=PROGRESS)[0]


def flights(
    bundle: Bundle, recording: Recording, without: tuple[str, ...], relight: Relight | None = None
) -> list[Run]:
    """From starts 10 cm and 3 degrees off."""
    assert recording.poses is not None
    flown, runs = replace(bundle, settings=override(bundle.settings, without=without)), []
    for number in range(_STARTS):
        rng = np.random.default_rng(number)
        start = Start.disturbed(recording.poses[0], rng)
        runs.append(localize(flown, recording, start, rng, NoProgress(), relight=relight))
    return runs


def figures(runs: list[Run]) -> dict[str, object]:
    """Errors and states of all frames of some flights."""
    errors_m = np.concatenate([np.linalg.norm(each.poses[:, :3, 3] - truth_of(each), axis=1) for each in runs])
    states = [state for each in runs for state in each.states]
    return {
        "frames": len(states),
        "median_cm": f"{100.0 * np.median(errors_m):.1f}",
        "rmse_cm": f"{100.0 * np.sqrt(np.mean(errors_m**2)):.1f}",
        "tracking": states.count("tracking"),
        "lost": states.count("lost"),
    }


def silent_frames(runs: list[Run], kind: str) -> int:
    """Number of frames that are silently wrong, of the kind ``30cm`` or ``3_5_sigma``."""
    return sum(int(str(each.metrics()[f"silent_frames_{kind}"])) for each in runs)


def truth_of(run: Run) -> FloatArray:
    """True positions (N, 3), metres."""
    assert run.truth is not None
    return run.truth[:, :3, 3]


def print_table(rows: Iterable[dict[str, object]]) -> None:
    """Print rows of CSV, each as soon as it is known."""
    table: csv.DictWriter[str] | None = None
    for row in rows:
        if table is None:
            table = csv.DictWriter(sys.stdout, list(row))
            table.writeheader()
        table.writerow(row)
        sys.stdout.flush()
