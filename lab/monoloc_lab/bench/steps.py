"""Localises a recording and times the stages of every step, in a separate process, to measure its memory.

    python -m monoloc_lab.bench.steps BUNDLE SOURCE FRAMES SEED

prints the figures as JSON. With exit code 2 it prints what is wrong with the input.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from monoloc import front_end
from monoloc.bundle import read_bundle
from monoloc.depth.predictor import DepthPredictor
from monoloc.errors import MonolocError
from monoloc.io.registry import open_recording, select_frames
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.likelihood.ray import RayLikelihood
from monoloc.likelihood.volume import VolumeLikelihood
from monoloc.localizer import Localizer
from monoloc.odometry.visual import VisualOdometry
from monoloc.particle_filter import filter as particle_filter
from monoloc.progress import NoProgress
from monoloc.run import localize
from monoloc.start import Start

# The step and its stages: name, and the object and attribute where the function is looked up.
STAGES: list[tuple[str, Any, str]] = [
    ("step", Localizer, "step"),
    ("depth", DepthPredictor, "__call__"),
    ("scan", front_end, "scan_from_depth"),
    ("odometry", VisualOdometry, "follow"),  # of corners, before the step
    ("odometry", VisualOdometry, "step"),
    ("scale and tilt", front_end, "correct_scale_and_tilt"),
    ("scan", front_end, "scan_from_corners"),
    ("landmarks", OrbLandmarkLocalizer, "detect"),
    ("landmarks", OrbLandmarkLocalizer, "measure"),
    ("predict", particle_filter, "predict"),
    ("likelihood", RayLikelihood, "mean_log_likelihood"),
    ("likelihood", VolumeLikelihood, "mean_log_likelihood"),
    ("estimate", particle_filter, "estimate"),
    ("resample", particle_filter, "resample"),
]
_WARM_UP = 5  # first steps, in which libraries initialise


@contextmanager
def timed_stages() -> Iterator[dict[str, list[float]]]:
    """Processor milliseconds of every call of each stage within the context.

    Everything runs on one thread, so this is the wall time on an idle core.
    """
    times: dict[str, list[float]] = {name: [] for name, _, _ in STAGES}
    originals = [(place, attribute, getattr(place, attribute)) for _, place, attribute in STAGES]
    for (name, place, attribute), (_, _, function) in zip(STAGES, originals, strict=True):
        setattr(place, attribute, _timed(function, times[name]))
    try:
        yield times
    finally:
        for place, attribute, function in originals:
            setattr(place, attribute, function)


def _timed(function: Callable[..., Any], times: list[float]) -> Callable[..., Any]:
    def run(*arguments: Any, **named: Any) -> Any:
        started = time.process_time()
        result = function(*arguments, **named)
        times.append(1e3 * (time.process_time() - started))
        return result

    return run


def measure(bundle: Path, source: str, frames: str, seed: int) -> dict[str, object]:
    """Figures of one run over a recording with poses."""
    cv2.setNumThreads(1)
    room = read_bundle(bundle)
    recording = select_frames(open_recording(source), frames)
    assert recording.poses is not None
    rng = np.random.default_rng(seed)
    start = Start.disturbed(recording.poses[0], rng)
    with timed_stages() as times:
        localize(room, recording, start, rng, NoProgress())
    steps = times.pop("step")
    stages = {name: sum(calls) / len(steps) for name, calls in times.items()}
    stages["other"] = sum(steps) / len(steps) - sum(stages.values())
    settled = steps[_WARM_UP:] or steps
    return {
        "step_ms_median": float(np.median(settled)),
        "step_ms_p95": float(np.percentile(settled, 95.0)),
        "stage_ms": stages,
        "peak_memory_mb": peak_memory_mb(),
    }


def peak_memory_mb() -> float:
    """Peak memory of this process, MB."""
    status = Path("/proc/self/status")
    if status.exists():  # getrusage includes the memory of the parent when it started this process
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1024 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # bytes, on macOS


if __name__ == "__main__":
    try:
        print(json.dumps(measure(Path(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4]))))
    except MonolocError as error:
        print(error)
        sys.exit(2)
