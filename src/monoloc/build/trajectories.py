"""Ways over a build's frames, on which a localizer is followed to see what it errs by."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.fusion.reference_poses import STEP_M
from monoloc.geometry import FloatArray, viewpoints_apart

_FORGOTTEN = 60  # frames: after so many the start is, and what is left is what the depth there says
_LONG = 30  # frames: on fewer, what is of the place and what is of the way cannot be told apart
_GAP_S = 1.5  # between frames: no camera is followed over more
_MOST_WALKS = 20  # that are followed


@dataclass(frozen=True)
class Way:
    """Frames (N,) to be followed one after another, of which the first ``passed`` do not count."""

    frames: NDArray[np.int64]
    passed: int = 0

    @property
    def counted(self) -> NDArray[np.int64]:
        return self.frames[self.passed :]


def walks_of(times_s: FloatArray, poses: FloatArray) -> list[NDArray[np.int64]]:
    """The walks that a recording of N frames is of, as frames in order; where there are many, evenly chosen ones.

    Long ones are chosen first. Frames that each stand alone would be followed for minutes, were all of them chosen.
    """
    walks = unbroken(np.arange(len(poses)), times_s, poses)
    long = _some([walk for walk in walks if is_long(walk)], _MOST_WALKS)
    short = _some([walk for walk in walks if not is_long(walk)], _MOST_WALKS - len(long))
    return sorted([*long, *short], key=lambda walk: int(walk[0]))


def _some(walks: list[NDArray[np.int64]], most: int) -> list[NDArray[np.int64]]:
    return walks[:: max(1, math.ceil(len(walks) / most))] if most else []


def unbroken(frames: NDArray[np.int64], times_s: FloatArray, poses: FloatArray) -> list[NDArray[np.int64]]:
    """The parts of frames, in order of time, within which the camera can be followed."""
    steps_m = [viewpoints_apart(a, b[None])[0] for a, b in itertools.pairwise(poses[frames])]
    gaps = (np.diff(times_s[frames]) > _GAP_S) | (np.array(steps_m) > STEP_M)
    return np.split(frames, 1 + np.flatnonzero(gaps))


def is_long(walk: NDArray[np.int64]) -> bool:
    """Whether to go there and back tells what is of the place."""
    return len(walk) >= _LONG


def there_and_back(walk: NDArray[np.int64]) -> Way:
    """A walk in order and then in reverse, after as much of that as it takes to forget the start."""
    both = np.concatenate([walk, walk[::-1]])
    lead = np.tile(both, math.ceil(_FORGOTTEN / len(both)))[-_FORGOTTEN:]
    return Way(np.concatenate([lead, both]), _FORGOTTEN)


def once(walk: NDArray[np.int64]) -> Way:
    """A walk in order, or, where the start would not be forgotten, as :func:`stay`."""
    return Way(walk) if len(walk) >= _FORGOTTEN else stay(walk)


def stay(place: NDArray[np.int64]) -> Way:
    """Frames in order, back, and again, until the camera has stayed long enough after the first time.

    The first time through a place still shows what was brought along.
    """
    cycle = np.concatenate([place, place[-2:0:-1]])
    return Way(np.tile(cycle, 1 + math.ceil(_FORGOTTEN / len(cycle))), len(place))
