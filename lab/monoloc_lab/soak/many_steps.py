"""Very many steps of one localizer: whether its memory or its time grow.

The recording is flown forward and backward again and again, from memory. After every tenth lap the camera is
somewhere else at once, so that the searches run too.
"""

from __future__ import annotations

import gc
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from monoloc.bundle import Bundle
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray
from monoloc.io.recording import Selection
from monoloc.localizer import Localizer
from monoloc.machine import machine_facts

_WINDOWS = 100  # that the figures' slopes are of
_WARM_UP = 0.1  # share of the steps before them, in which caches fill and the heap settles
_MOST_FRAMES = 300  # of the recording: decoded, they stay in memory
_LAPS = 10  # between two jumps
_PER = 100_000  # steps that growth is given for


@dataclass(frozen=True)
class SoakFigures:
    """JSON keys of ``monoloc bench soak``.

    Attributes:
        machine: processor, cores, system, Python.
        steps: that were run, each with another image than the one before.
        image: width and height.
        jumps: how often the camera was somewhere else at once.
        states: number of steps in each.
        resident_mb: after the warm-up and at the end.
        resident_mb_growth: in 100,000 steps, the median slope between any two windows after the warm-up.
        step_ms: processor time, median of the first window after the warm-up and of the last one.
        step_growth: relative, in 100,000 steps, as ``resident_mb_growth``.
        threads, files: that the process has open, after the warm-up and at the end.
        objects: that Python's garbage collector knows, after the warm-up and at the end.
    """

    machine: dict[str, str]
    steps: int
    image: tuple[int, int]
    jumps: int
    states: dict[str, int]
    resident_mb: tuple[float, float]
    resident_mb_growth: float
    step_ms: tuple[float, float]
    step_growth: float
    threads: tuple[int, int]
    files: tuple[int, int]
    objects: tuple[int, int]


@dataclass(frozen=True)
class _Window:
    steps: int  # so far
    step_ms: float
    resident_mb: float
    threads: int
    files: int
    objects: int


def bench_soak(
    bundle: Bundle, recording: Selection, steps: int, seed: int, show: Callable[[int], None]
) -> SoakFigures:
    """Run the steps.

    Args:
        bundle: of the recording's room.
        recording: at most 300 frames of it are flown.
        steps: how many.
        seed: of the localizer and the jumps.
        show: takes the number of steps that are done, at the start and a hundred times.

    Raises:
        SettingError: the recording has fewer than ten frames, or this system does not tell a process's memory.
    """
    if not Path("/proc/self/statm").exists():
        raise SettingError("bench soak", "needs Linux, which tells a process's memory", "run it there")
    if len(recording) < 10:
        raise SettingError("SOURCE", f"has {len(recording)} frames", "give ten or more")
    colors = [recording.color(index) for index in range(min(len(recording), _MOST_FRAMES))]
    elapsed_s = float(np.median(np.diff(recording.timestamps_s)))
    localizer = Localizer(bundle, recording.camera, seed=seed)
    route = _Route(len(colors), np.random.default_rng(seed))
    states: Counter[str] = Counter()
    windows: list[_Window] = []
    show(0)
    ends = np.linspace(0, steps, _WINDOWS + 1).round().astype(int)
    for begin, end in pairwise(ends):
        times_ms = []
        for index in route.next(end - begin):
            began = time.thread_time()
            step = localizer.step(colors[index], elapsed_s)
            times_ms.append(1e3 * (time.thread_time() - began))
            states[step.state] += 1
        windows.append(_window(int(end), times_ms))
        show(int(end))
    settled = windows[int(_WARM_UP * _WINDOWS) :]
    first, last = settled[0], settled[-1]
    done = np.array([window.steps for window in settled], dtype=float)
    times_ms = [window.step_ms for window in settled]
    return SoakFigures(
        machine=machine_facts(),
        steps=steps,
        image=(recording.camera.width, recording.camera.height),
        jumps=route.jumps,
        states=dict(states),
        resident_mb=(first.resident_mb, last.resident_mb),
        resident_mb_growth=_PER * median_slope(done, np.array([window.resident_mb for window in settled])),
        step_ms=(first.step_ms, last.step_ms),
        step_growth=_PER * median_slope(done, np.array(times_ms)) / float(np.median(times_ms)),
        threads=(first.threads, last.threads),
        files=(first.files, last.files),
        objects=(first.objects, last.objects),
    )


class _Route:
    """Numbers of frames, forward and backward in turn, each another than the one before."""

    def __init__(self, frames: int, rng: np.random.Generator) -> None:
        self._lap = [*range(frames), *range(frames - 2, 0, -1)]
        self._rng = rng
        self._at, self._left = 0, _LAPS * len(self._lap)
        self.jumps = 0

    def next(self, count: int) -> Iterator[int]:
        for _ in range(count):
            yield self._lap[self._at]
            self._left -= 1
            ahead = 1
            if self._left == 0:
                self.jumps += 1
                self._left = _LAPS * len(self._lap)
                quarter = len(self._lap) // 4
                ahead = int(self._rng.integers(quarter, 3 * quarter))
            self._at = (self._at + ahead) % len(self._lap)


def _window(steps: int, times_ms: list[float]) -> _Window:
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return _Window(
        steps=steps,
        step_ms=float(np.median(times_ms)),
        resident_mb=pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        threads=threading.active_count(),
        files=len(list(Path("/proc/self/fd").iterdir())),
        objects=len(gc.get_objects()),
    )


def median_slope(x: FloatArray, y: FloatArray) -> float:
    """Median of the slopes between any two points (Theil, Sen), which a few outliers do not move; ``x`` increases."""
    later, earlier = np.tril_indices(len(x), -1)
    return float(np.median((y[later] - y[earlier]) / (x[later] - x[earlier])))
