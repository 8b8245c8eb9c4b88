"""Accuracy of a flight with another camera than the map's, in a rendered room.

    python benchmarks/other_cameras.py FOLDER SEED [BUNDLE]

Renders a walk with a phone's field of view, builds a bundle from it without tuning unless one is given, and renders a
flight 15 cm and 7 degrees off that walk (standard deviations) with a wide lens. Images of every other camera are
resampled from those, so all see the same flight. Prints a row of CSV for every camera, two starts together. The
rendering takes some minutes, and is kept in the folder.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rendered_flights import PHONE, RenderedRoom, bundle_of, figures, flights, print_table, silent_frames

from monoloc.camera import Camera
from monoloc.io.image_resampling import Resampler
from monoloc.io.recording import Recording, Selection

WIDE = Camera(1120, 840, 320.0, 320.0, 559.5, 419.5)

Altered = Callable[[NDArray[np.uint8]], NDArray[np.uint8]]


def pinhole(width: int, height: int, degrees: float) -> Camera:
    """A camera without distortion, by its horizontal field of view."""
    focal_px = width / 2.0 / np.tan(np.deg2rad(degrees) / 2.0)
    return Camera(width, height, focal_px, focal_px, (width - 1) / 2.0, (height - 1) / 2.0)


def toned(exponent: float) -> Altered:
    table = (255.0 * (np.arange(256) / 255.0) ** exponent).round().astype(np.uint8)
    return lambda color: table[color]


def noisy(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    noise = np.random.default_rng(int(color.sum())).normal(0.0, 12.0, color.shape)
    return np.clip(color + noise, 0.0, 255.0).astype(np.uint8)


def gray(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB), dtype=np.uint8)


def warm(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(np.clip(color * np.array([1.25, 1.0, 0.65]), 0.0, 255.0), dtype=np.uint8)


def unchanged(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return color


_BARREL = Camera(560, 420, 300.0, 300.0, 279.5, 209.5, (-0.28, 0.07, 0.0005, -0.0003))
_FISHEYE = Camera(480, 340, 300.0, 300.0, 239.5, 169.5, (-0.02, 0.004, 0.0, 0.0), "fisheye")
CAMERAS: dict[str, tuple[Camera, Altered]] = {
    "60 degrees, as the map's": (pinhole(360, 270, 60.0), unchanged),
    "60 degrees, 160 x 120": (pinhole(160, 120, 60.0), unchanged),
    "45 degrees": (pinhole(264, 198, 45.0), unchanged),
    "75 degrees": (pinhole(480, 360, 75.0), unchanged),
    "75 degrees, 16:9": (pinhole(640, 360, 75.0), unchanged),
    "90 degrees": (pinhole(600, 450, 90.0), unchanged),
    "110 degrees": (pinhole(800, 600, 110.0), unchanged),
    "barrel distortion, 94 degrees": (_BARREL, unchanged),
    "fisheye, 92 degrees": (_FISHEYE, unchanged),
    "75 degrees, grey": (pinhole(480, 360, 75.0), gray),
    "75 degrees, dark tones": (pinhole(480, 360, 75.0), toned(1.8)),
    "75 degrees, warm": (pinhole(480, 360, 75.0), warm),
    "75 degrees, noisy": (pinhole(480, 360, 75.0), noisy),
}


class Resampled(Selection):
    """A recording as another camera at the same place would have seen it."""

    def __init__(self, source: Recording, camera: Camera, altered: Altered) -> None:
        super().__init__(source, np.arange(len(source)))
        self._resampler, self._altered = Resampler(camera, [source.camera]), altered
        self.camera = camera
        shrink = source.camera.fx / camera.fx
        self._blur_px = 0.5 * np.sqrt(max(0.0, shrink**2 - 1.0))  # as larger pixels would see it

    def color(self, index: int) -> NDArray[np.uint8]:
        seen = super().color(index)
        if self._blur_px > 0.1:
            seen = cv2.GaussianBlur(seen, (0, 0), self._blur_px).astype(np.uint8)
        return self._altered(self._resampler.color(0, seen))

    def depth(self, index: int) -> NDArray[np.float32]:
        return self._resampler.depth(0, super().depth(index))


def rows(folder: str, seed: str, bundle_path: str | None = None) -> Iterator[dict[str, object]]:
    room = RenderedRoom(Path(folder), int(seed))
    walk, flight = room.walk("build", PHONE, samples=16), room.beside_the_walk("wide", WIDE, samples=8)
    bundle = bundle_of(walk, bundle_path)
    for without in ((), ("landmarks",)):
        for name, (camera, altered) in CAMERAS.items():
            runs = flights(bundle, Resampled(flight, camera, altered), without)
            silent = silent_frames(runs, "30cm") + silent_frames(runs, "3_5_sigma")
            yield {"room": seed, "camera": name, "without": " ".join(without), **figures(runs), "silent": silent}


if __name__ == "__main__":
    cv2.setNumThreads(1)
    print_table(rows(*sys.argv[1:]))
