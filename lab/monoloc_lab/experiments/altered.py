"""Recordings under harder conditions: noisy poses, and a camera with a narrower lens."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import se3_exp
from monoloc.io.recording import Selection

POSE_NOISE_M, POSE_NOISE_DEG = 0.02, 1.0
"""Standard deviation of the noise of build poses, per axis."""
_LENS_SHARE = 0.6  # of the image's width and height that the narrower lens shows


class NarrowLens(Selection):
    """A recording through a narrower lens: the centre of every image."""

    def __init__(self, source: Selection) -> None:
        super().__init__(source, np.arange(len(source)))
        camera = source.camera
        left, top = (round(0.5 * (1.0 - _LENS_SHARE) * size) for size in (camera.width, camera.height))
        width, height = camera.width - 2 * left, camera.height - 2 * top
        self._window = np.s_[top : top + height, left : left + width]
        self.camera = camera.cropped(left, top, width, height)

    def color(self, index: int) -> NDArray[np.uint8]:
        return np.ascontiguousarray(super().color(index)[self._window])

    def depth(self, index: int) -> NDArray[np.float32]:
        return np.ascontiguousarray(super().depth(index)[self._window])


def with_pose_noise(recording: Selection) -> Selection:
    """A recording with Gaussian noise on every pose, in the camera's frame."""
    assert recording.poses is not None  # a study's recordings have poses
    sd = np.repeat([POSE_NOISE_M, np.deg2rad(POSE_NOISE_DEG)], 3)
    twists = np.random.default_rng(0).normal(scale=sd, size=(len(recording), 6))
    noisy = Selection(recording, np.arange(len(recording)))
    noisy.poses = recording.poses @ se3_exp(twists)
    return noisy


ALTERATIONS: dict[str, Callable[[Selection], Selection]] = {
    "pose noise": with_pose_noise,
    "narrow lens": NarrowLens,
}
