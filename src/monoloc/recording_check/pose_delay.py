"""By how much time the poses of a recording are late, which need not be a whole number of frames.

A delay shows where the motion changes: poses of a camera that moves evenly fit at any time. The misfit of the
corners alone does not determine it well: interpolated poses have less noise than those of frames, and fit better at
half a frame for that reason. So the delay is the one that explains where the corners are, and in which direction: a
regression of their errors on what a delay would move, to which noise of the poses adds nothing on average.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.reprojection import LEAST_WITH_DEPTH, Reprojection

_MOST_FRAMES = 10  # that a delay is looked for
_STEPS, _STEP_FRAMES = 4, 0.5  # of the regression, and by how much poses are moved to see what a delay does
_NOISE_PX = 1.0  # of a pair that fits perfectly
_OUTLIER = 1.5  # times the median error of a pair, from which corners count less
_RESAMPLES = 200
# Of right poses of 25 parts of RedKitchen and the desk, 24 came out up to 0.02 s off, and one of blurred images
# 0.036 s by a standard deviation of 0.012. In all others, delays of 0.05 to 0.2 s came out to 0.02 s.
_LEAST_S, _SDS = 0.03, 4.0
_RIGHT = 0.12  # median error of right poses, share of the corners' motion; that of noisy ones hides a part of a delay


@dataclass(frozen=True)
class Delay:
    """A time by which poses are late.

    Attributes:
        seconds: negative if they are early.
        sd_s: standard deviation, by resampling of the pairs.
        fit: errors of the corners with poses of so much later.
        is_certain: whether it is clearly not zero, and neither no delay nor the opposite one fits as well.
    """

    seconds: float
    sd_s: float
    fit: Reprojection
    is_certain: bool

    @property
    def what(self) -> str:
        """For messages: "poses late by 0.05 s"."""
        return f"poses {self._word} by {abs(self.seconds):.2f} s"

    @property
    def option(self) -> str:
        """The option that undoes it."""
        return f"--fix-poses {self._word}:{abs(self.seconds):.2f}s"

    @property
    def _word(self) -> str:
        return "late" if self.seconds > 0.0 else "early"

    def is_whole(self, interval_s: float) -> bool:
        """Whether it may be a whole number of frames, at least one, which are so far apart."""
        frames = round(abs(self.seconds) / interval_s)
        return frames > 0 and abs(abs(self.seconds) - frames * interval_s) <= max(0.01, 2.0 * self.sd_s)


def find_small_delay(evidence: Evidence) -> Delay | None:
    """A delay of poses that agree even so; None where there is no certain one, or poses are noisy besides."""
    delay = fit_delay(evidence, is_small=True)
    return delay if delay is not None and delay.is_certain and delay.fit.median <= _RIGHT else None


def fit_delay(evidence: Evidence, is_small: bool) -> Delay | None:
    """The delay under which the corners fit; None where they do not determine it.

    Args:
        evidence: with sensor depth.
        is_small: whether it is less than a frame; others are first looked for among whole frames.
    """
    interval_s = evidence.frame_interval_s
    if not (evidence.recording.has_depth and interval_s > 0.0 and len(evidence.matches)):
        return None
    seconds = 0.0 if is_small else interval_s * _nearest_frames(evidence)
    for _ in range(_STEPS):
        normal, right = _equations(evidence, seconds, _STEP_FRAMES * interval_s)
        if normal.sum() <= 0.0:
            return None
        most_s = (_MOST_FRAMES + 1) * interval_s
        seconds = float(np.clip(seconds + right.sum() / normal.sum(), -most_s, most_s))
    chosen = np.random.default_rng(0).integers(len(normal), size=(_RESAMPLES, len(normal)))
    sd_s = float(np.std(right[chosen].sum(axis=1) / np.maximum(normal[chosen].sum(axis=1), 1e-9 * normal.sum())))
    fit, opposite = (_errors(evidence, sign * seconds) for sign in (1.0, -1.0))
    is_better = fit.median < _errors(evidence, 0.0).median < opposite.median
    return Delay(seconds, sd_s, fit, is_better and abs(seconds) >= max(_LEAST_S, _SDS * sd_s))


def _errors(evidence: Evidence, seconds: float) -> Reprojection:
    return evidence.reproject(evidence.relative_after(seconds), evidence.depth_m(evidence.poses))


def _nearest_frames(evidence: Evidence) -> int:
    """Whole frames by which the poses fit best; only those count with which most pairs have poses."""
    depth_m = evidence.depth_m(evidence.poses)
    frames = range(-_MOST_FRAMES, _MOST_FRAMES + 1)
    fits = [evidence.reproject(evidence.relative_late(late), depth_m) for late in frames]
    medians = [fit.median if 2 * fit.pairs >= len(evidence.matches) else np.inf for fit in fits]
    return frames[int(np.argmin(medians))]


def _equations(evidence: Evidence, seconds: float, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Normal equations of each pair for a correction of the delay: weight (N,), and weight times correction (N,)."""
    matches, depth_m = evidence.matches, evidence.depth_m(evidence.poses)
    before, at, after = (_pixels(evidence, seconds + move, depth_m) for move in (-step_s, 0.0, step_s))
    errors, rates = at - matches.pixels[:, 1], (after - before) / (2.0 * step_s)
    distances = np.linalg.norm(errors, axis=1)
    # A corner behind the camera is predicted far outside the image.
    usable = (depth_m > 0.0) & np.isfinite(rates).all(axis=1) & (distances < matches.camera.width)
    normal, right = np.zeros((2, len(matches)))
    for pair in range(len(matches)):
        within = matches.of_pair(pair)
        of = within.start + np.flatnonzero(usable[within])
        if len(of) < LEAST_WITH_DEPTH:
            continue
        usual = float(np.median(distances[of]))
        weights = 1.0 / np.maximum(1.0, distances[of] / max(_OUTLIER * usual, 1e-6))
        weights /= weights.sum() * (usual**2 + _NOISE_PX**2)
        normal[pair] = np.sum(weights * (rates[of] ** 2).sum(axis=1))
        right[pair] = -np.sum(weights * (rates[of] * errors[of]).sum(axis=1))
    return normal, right


def _pixels(evidence: Evidence, seconds: float, depth_m: FloatArray) -> FloatArray:
    """Where the corners are predicted with poses of so much later, (P, 2); NaN where there are none."""
    relative = evidence.relative_after(seconds)
    known = np.asarray(np.isfinite(relative).all(axis=(1, 2)))
    relative[~known] = np.eye(4)
    pixels = evidence.reproject.predicted_px(relative, depth_m)
    pixels[~known[evidence.matches.pair]] = np.nan
    return pixels
