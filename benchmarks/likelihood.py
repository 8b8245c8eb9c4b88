"""The ray likelihood beside the volume likelihood, with the same tuned network, map and landmarks.

    python benchmarks/likelihood.py ROOM SOURCE BUILT BETWEEN BEYOND BUNDLE [BUNDLE ...]

Each bundle is calibrated twice on the frames BUILT, once for each likelihood, and flies over the frames BETWEEN them
and BEYOND them, by depth alone and with landmarks, from two starts 10 cm and 3 degrees off. Calibrating drops the
bias known at the reference poses, for both alike. Prints a row of CSV for every flight.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from rendered_flights import print_table

from monoloc.builder.calibrate import calibrate
from monoloc.bundle import Bundle, read_bundle
from monoloc.components import default_components
from monoloc.config import override
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording, select_frames
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start

_STARTS = 2


def calibrated(bundle: Bundle, recording: Recording, kind: str) -> Bundle:
    """The bundle with the settings and thresholds of a likelihood, ``ray`` or ``volume``."""
    settings = override(bundle.settings, likelihood={"kind": kind})
    return calibrate(replace(bundle, settings=settings), recording, default_components)


def fly(bundle: Bundle, recording: Recording, without: tuple[str, ...], seed: int) -> Run:
    assert recording.poses is not None
    rng = np.random.default_rng(seed)
    start = Start.disturbed(recording.poses[0], rng)
    flown = replace(bundle, settings=override(bundle.settings, without=without))
    return localize(flown, recording, start, rng, NoProgress())


def figures(run: Run) -> dict[str, object]:
    metrics = run.metrics()
    return {
        "frames": len(run.states),
        "median_cm": f"{100.0 * float(str(metrics['ate_median_m'])):.2f}",
        "rmse_cm": f"{100.0 * float(str(metrics['ate_rmse_m'])):.2f}",
        "coverage_95": f"{float(str(metrics['coverage_95'])):.3f}",
        "tracking": f"{run.states.count('tracking') / len(run.states):.3f}",
        "silent_30cm": metrics["silent_frames_30cm"],
        "silent_3_5_sigma": metrics["silent_frames_3_5_sigma"],
    }


def rows(room: str, source: str, built: str, between: str, beyond: str, *bundles: str) -> Iterator[dict[str, object]]:
    recording = open_recording(source)
    splits = {"interpolation": between, "extrapolation": beyond}
    for path, kind in itertools.product(bundles, ("ray", "volume")):
        bundle = calibrated(read_bundle(path), select_frames(recording, built), kind)
        likelihood = bundle.settings.likelihood
        width = likelihood.log_depth_sd if kind == "ray" else likelihood.noise_sd_m
        for landmarks, split, start in itertools.product(("without", "with"), splits, range(_STARTS)):
            without = ("landmarks",) if landmarks == "without" else ()
            yield {
                "room": room,
                "split": split,
                "build": bundle.provenance.seed,
                "start": start,
                "likelihood": kind,
                "landmarks": landmarks,
                "width": width,
                **figures(fly(bundle, select_frames(recording, splits[split]), without, start)),
            }


if __name__ == "__main__":
    cv2.setNumThreads(1)
    print_table(rows(*sys.argv[1:]))
