"""Accuracy and states of flights through one of many rendered rooms.

    python benchmarks/many_rooms.py FOLDER SEED [BUNDLE]

Renders a walk with a phone's field of view, builds a bundle from it without tuning unless one is given, and flies
with the same camera: 15 cm and 7 degrees off the walk (standard deviations), and on another way through the room,
there also with images of near darkness. Prints a row of CSV for every flight with and without landmarks, two starts
together. The rendering takes some minutes, and is kept in the folder.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rendered_flights import PHONE, RenderedRoom, bundle_of, figures, flights, print_table, silent_frames

from monoloc.geometry import pose_distance_m
from monoloc_lab.synth.light import LIGHTS, relit

_SAMPLES = 4


def dark(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return relit(color, LIGHTS["L3"], np.random.default_rng(int(color.sum())))


def rows(folder: str, seed: str, bundle_path: str | None = None) -> Iterator[dict[str, object]]:
    room = RenderedRoom(Path(folder), int(seed))
    walk = room.walk("build", PHONE, _SAMPLES)
    beside, elsewhere = room.beside_the_walk("beside", PHONE, _SAMPLES), room.elsewhere("elsewhere", PHONE, _SAMPLES)
    bundle = bundle_of(walk, bundle_path)
    for name, recording, relight in (
        ("beside the walk", beside, None),
        ("elsewhere", elsewhere, None),
        ("elsewhere, near darkness", elsewhere, dark),
    ):
        assert recording.poses is not None and walk.poses is not None
        away = [float(pose_distance_m(pose, walk.poses).min()) for pose in recording.poses]
        for without in ((), ("landmarks",)):
            runs = flights(bundle, recording, without, relight)
            yield {
                "room": seed,
                "bundle": "untuned" if bundle_path is None else "tuned",
                "flight": name,
                "without": " ".join(without),
                "distance": f"{np.median(away):.2f}",
                **figures(runs),
                **{f"silent_{kind}": silent_frames(runs, kind) for kind in ("30cm", "3_5_sigma")},
                "coverage_95": f"{np.mean([float(str(each.metrics()['coverage_95'])) for each in runs]):.2f}",
            }


if __name__ == "__main__":
    cv2.setNumThreads(1)
    print_table(rows(*sys.argv[1:]))
