"""Trajectories over a build's frames, along which localizers run so that their errors can be measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.fusion.reference_poses import MOST_STEP_M
from monoloc.geometry import FloatArray, steps_m

_WARM_UP_FRAMES = 60  # after so many the start is forgotten, and the pose is what the depth there gives
LONG_FRAMES = 30  # on a shorter segment, the biases of place and direction cannot be separated
_MOST_GAP_S = 1.5  # between frames; no camera is followed over a longer one
_MOST_SEGMENTS, _MOST_SHORT = 20, 8  # of all, and of short ones, each of which takes 60 to 120 steps


@dataclass(frozen=True)
class Trajectory:
    """Frames (N,) to follow one after another, of which the first ``warm_up`` are not scored."""

    frames: NDArray[np.int64]
    warm_up: int = 0

    @property
    def scored(self) -> NDArray[np.int64]:
        return self.frames[self.warm_up :]


def recording_segments(times_s: FloatArray, poses: FloatArray) -> list[NDArray[np.int64]]:
    """Continuous segments of a recording of N frames, as frames in order; an even selection if there are many.

    Long ones are selected first. Following all of many single frames would take minutes.
    """
    segments = continuous_segments(np.arange(len(poses)), times_s, poses)
    long = selection([segment for segment in segments if is_long(segment)], _MOST_SEGMENTS)
    most_short = min(_MOST_SHORT, _MOST_SEGMENTS - len(long))
    short = selection([segment for segment in segments if not is_long(segment)], most_short)
    return sorted([*long, *short], key=lambda segment: int(segment[0]))


def selection(segments: list[NDArray[np.int64]], most: int) -> list[NDArray[np.int64]]:
    """At most so many of the segments, spread evenly over them."""
    return segments[:: max(1, math.ceil(len(segments) / most))] if most else []


def continuous_segments(frames: NDArray[np.int64], times_s: FloatArray, poses: FloatArray) -> list[NDArray[np.int64]]:
    """Frames in order of time, split where a camera could not be followed."""
    gaps = (np.diff(times_s[frames]) > _MOST_GAP_S) | (steps_m(poses[frames]) > MOST_STEP_M)
    return np.split(frames, 1 + np.flatnonzero(gaps))


def can_be_followed(times_s: FloatArray, poses: FloatArray) -> bool:
    """Whether a camera can be followed from one frame to the next, times (2,) and poses (2, 4, 4)."""
    return len(continuous_segments(np.arange(2), times_s, poses)) == 1


def is_long(segment: NDArray[np.int64]) -> bool:
    """Whether following it forward and backward tells the bias of the place from that of the direction."""
    return len(segment) >= LONG_FRAMES


def forward_and_backward(segment: NDArray[np.int64]) -> Trajectory:
    """A segment in order and then in reverse, after a warm-up over the end of the same."""
    both = np.concatenate([segment, segment[::-1]])
    lead = np.tile(both, math.ceil(_WARM_UP_FRAMES / len(both)))[-_WARM_UP_FRAMES:]
    return Trajectory(np.concatenate([lead, both]), _WARM_UP_FRAMES)


def single_pass(segment: NDArray[np.int64]) -> Trajectory:
    """A segment in order, or :func:`hover` if it is too short to forget the start."""
    return Trajectory(segment) if len(segment) >= _WARM_UP_FRAMES else hover(segment)


def hover(segment: NDArray[np.int64]) -> Trajectory:
    """Frames in order, in reverse, and again, until the start is forgotten; the first pass is not scored."""
    cycle = np.concatenate([segment, segment[-2:0:-1]])
    return Trajectory(np.tile(cycle, 1 + math.ceil(_WARM_UP_FRAMES / len(cycle))), len(segment))
