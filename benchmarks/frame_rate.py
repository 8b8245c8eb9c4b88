"""One flight at four rates of images, and a camera that hovers at four.

    python benchmarks/frame_rate.py FOLDER SEED BUNDLE

Renders eight seconds beside the walk that made the bundle, through a room of ``benchmarks/many_rooms.py``, at 30
images a second, and flies them all, every second, every fourth and every eighth one, with and without landmarks, two
starts each. Then the camera hovers at the flight's first image for ten seconds, each image with new noise. Prints a
row of CSV for each. Errors are of the frames after the third second.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from hover import noisy
from rendered_flights import PHONE, RenderedRoom, print_table

from monoloc.bundle import Bundle, read_bundle
from monoloc.config import override
from monoloc.evaluation.consistency import consistency
from monoloc.io.recording import Recording
from monoloc.localizer import Localizer
from monoloc.start import Start

RATES_HZ, HOVER_HZ, HOVER_S, SETTLED_S = (30.0, 15.0, 7.5, 3.75), (60.0, 30.0, 15.0, 5.0), 10.0, 3.0
CAMERA = PHONE.resized(240, 180)


def flown(
    bundle: Bundle, recording: Recording, indices: list[int], rate_hz: float, without: str
) -> dict[str, object]:
    """Two starts over some frames, of which the same one may come again and again, with new noise."""
    assert recording.poses is not None
    hovers = len(set(indices)) == 1
    settings = override(bundle.settings, without=[without] if without else [])
    truth, estimates, states = [], [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        start = Start.disturbed(recording.poses[indices[0]], rng)
        localizer = Localizer(bundle, recording.camera, start, settings, seed=rng)
        for number, index in enumerate(indices):
            color = recording.color(index)
            step = localizer.step(noisy(color, rng) if hovers else color, 1.0 / rate_hz if number else 0.0)
            if number >= SETTLED_S * rate_hz:
                truth.append(recording.poses[index])
                estimates.append(step.estimate)
                states.append(step.state)
    covariances = [each.covariance for each in estimates]
    errors = consistency([each.pose for each in estimates], np.stack(truth), covariances)
    return {
        "flight": "hover" if hovers else "beside the walk",
        "rate_hz": rate_hz,
        "without": without,
        "frames": len(states),
        "median_cm": f"{100.0 * np.median(errors.position_m):.1f}",
        "largest_cm": f"{100.0 * errors.position_m.max():.1f}",
        "sd_cm": f"{100.0 * np.median([each.position_sd_m for each in estimates]):.1f}",
        "coverage_95": f"{errors.coverage_95:.2f}",
        "tracking": states.count("tracking"),
    }


def rows(folder: str, seed: str, bundle_path: str) -> Iterator[dict[str, object]]:
    bundle, recording = read_bundle(bundle_path), RenderedRoom(Path(folder), int(seed)).beside_at_30_hz(CAMERA)
    for without in ("", "landmarks"):
        for rate_hz in RATES_HZ:
            indices = list(range(0, len(recording), round(30.0 / rate_hz)))
            yield {"room": seed, **flown(bundle, recording, indices, rate_hz, without)}
        for rate_hz in HOVER_HZ:
            yield {"room": seed, **flown(bundle, recording, [0] * round(HOVER_S * rate_hz), rate_hz, without)}


if __name__ == "__main__":
    cv2.setNumThreads(1)
    print_table(rows(*sys.argv[1:]))
