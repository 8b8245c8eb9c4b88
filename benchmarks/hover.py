"""States and errors of a camera that hovers: one image for ten seconds, each time with new noise.

    python benchmarks/hover.py BUNDLE SOURCE FRAME [FRAME ...]

Every frame of the recording is hovered at from a start 10 cm and 3 degrees off. Prints a row of CSV for each.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray
from rendered_flights import print_table

from monoloc.bundle import Bundle, read_bundle
from monoloc.evaluation.consistency import consistency
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording
from monoloc.localizer import Localizer
from monoloc.start import Start
from monoloc.step import Step
from monoloc.supervision.state import VOUCHED_FOR

IMAGES, RATE_HZ = 150, 15.0
_GREY_LEVELS = 3.0  # standard deviation of the noise


def noisy(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """The image (H, W, 3) as a camera that stands still sees it once more."""
    return np.clip(np.rint(image + rng.normal(0.0, _GREY_LEVELS, image.shape)), 0, 255).astype(np.uint8)


def hover(bundle: Bundle, recording: Recording, index: int) -> list[Step]:
    assert recording.poses is not None
    image, rng = recording.color(index), np.random.default_rng(0)
    localizer = Localizer(bundle, recording.camera, Start.disturbed(recording.poses[index], rng), seed=rng)
    return [localizer.step(noisy(image, rng), 1.0 / RATE_HZ if number else 0.0) for number in range(IMAGES)]


def rows(bundle_path: str, source: str, *frames: str) -> Iterator[dict[str, object]]:
    bundle, recording = read_bundle(bundle_path), open_recording(source)
    assert recording.poses is not None, f"{source} has no poses"
    for frame in map(int, frames):
        steps = hover(bundle, recording, frame)
        estimated, covariances = zip(*((each.estimate.pose, each.estimate.covariance) for each in steps), strict=True)
        errors = consistency(estimated, np.repeat(recording.poses[frame][None], len(steps), axis=0), covariances)
        states, vouched_for = Counter(each.state for each in steps), [each.state in VOUCHED_FOR for each in steps]
        reasons = Counter(reason.value for each in steps for reason in each.reasons)
        yield {
            "frame": frame,
            "images": len(steps),
            **{state: states[state] for state in ("tracking", "map-changed", "uncertain", "lost")},
            "reasons": "; ".join(f"{reason} {count}" for reason, count in sorted(reasons.items())),
            "median_cm": f"{100.0 * np.median(errors.position_m):.1f}",
            "largest_cm": f"{100.0 * errors.position_m.max():.1f}",
            "silent_30cm": int(np.sum(errors.is_far[vouched_for])),
            "silent_3_5_sigma": int(np.sum(errors.is_beyond_covariance[vouched_for])),
        }


if __name__ == "__main__":
    cv2.setNumThreads(1)
    print_table(rows(*sys.argv[1:]))
