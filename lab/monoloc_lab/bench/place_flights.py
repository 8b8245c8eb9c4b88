"""Flights in a place, in a process of their own, so that their memory and their times are theirs alone."""

from __future__ import annotations

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.place.place_files import read_place
from monoloc.place.place_localizer import PlaceLocalizer
from monoloc.supervision.state import State
from monoloc_lab.bench.place_building import CAMERA, RATE_HZ
from monoloc_lab.bench.steps import peak_memory_mb

_SHAPE = (CAMERA.height, CAMERA.width, 3)


@dataclass(frozen=True)
class PlaceFlight:
    """Results of F frames.

    Attributes:
        rooms, states: of each frame; None where the place was searched.
        poses: (F, 4, 4) in that room's world, or NaN.
        step_ms: (F,) processor time.
        loaded: rooms in memory at most.
        peak_memory_mb: of the process.
    """

    rooms: list[str | None]
    states: list[State]
    poses: FloatArray
    step_ms: FloatArray
    loaded: int
    peak_memory_mb: float


def write_frames(path: Path, frames: list[NDArray[np.uint8]]) -> None:
    """Write images one after another, so that one can be read at a time."""
    with path.open("wb") as file:
        for frame in frames:
            file.write(frame.tobytes())


def fly_apart(place: Path, frames: Path, count: int, seed: int) -> PlaceFlight:
    """Fly the first images of a file through a place, from an unknown start, in a new process."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(fly_frames, place, frames, count, seed).result()


def fly_frames(place: Path, frames: Path, count: int, seed: int) -> PlaceFlight:
    """Fly the first images of a file through a place, from an unknown start."""
    cv2.setNumThreads(1)
    localizer = PlaceLocalizer(read_place(place), CAMERA, seed=seed)
    steps, step_ms, loaded = [], [], 0
    with frames.open("rb") as file:
        for _ in range(count):
            color = np.frombuffer(file.read(int(np.prod(_SHAPE))), np.uint8).reshape(_SHAPE)
            began = time.process_time()
            step = localizer.step(color, 1.0 / RATE_HZ)
            step_ms.append(1e3 * (time.process_time() - began))
            steps.append((step.room, step.state, None if step.step is None else step.step.estimate.pose))
            loaded = max(loaded, len(localizer.loaded))
    return PlaceFlight(
        rooms=[room for room, _, _ in steps],
        states=[state for _, state, _ in steps],
        poses=np.stack([np.full((4, 4), np.nan) if pose is None else pose for _, _, pose in steps]),
        step_ms=np.array(step_ms),
        loaded=loaded,
        peak_memory_mb=peak_memory_mb(),
    )
