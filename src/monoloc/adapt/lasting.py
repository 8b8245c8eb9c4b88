"""What the errors are that last, in the mean and how wide, measured by following a build's own frames."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.datasets.base import Recording
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors, axis_sd, pose_errors
from monoloc.filter.lasting import LastingErrors
from monoloc.geometry import FloatArray, invert, se3_exp, se3_log, viewpoints_apart
from monoloc.localizer import Localizer
from monoloc.progress import Progress

_STAY = 60  # frames: the start is forgotten, and what is left is what the depth there says
_GAP_S, _GAP_M = 1.5, 0.5  # between frames, the latter with a radian for a metre: no camera is followed over more
_LEAST_DISTANCE_M = 0.01
_MOST_WALKS = 20  # that are followed
_USUAL_GROWTH = 0.1  # m and rad a metre away, of other networks and other parts of a room
_PIECE_M = 1.0  # of a way, a radian for a metre: errors so far apart are nearly others
_FEWEST_PIECES = 4  # fewer do not tell an error in the mean from one of a place

# From a start, ``T_world_camera``, to a localizer.
StartsAt = Callable[[FloatArray], Localizer]


def measure_lasting(
    starts_at: StartsAt,
    rehearsed_at: StartsAt,
    recording: Recording,
    regions: list[NDArray[np.int64]],
    progress: Progress,
) -> LastingErrors:
    """What lasts: in the mean, near the viewpoints that tuned, and away from them.

    Near, and in the mean: the recording is followed from its first pose with the network that all its frames tuned,
    and where it was paused, or is of several walks, from the first pose afterwards; walks so short that their start
    is not forgotten are gone to and fro. Away: with one that no frame of the regions tuned, the camera stays in each
    of them, to and fro over its frames, since a filter that only passes through brings the pose it has along. What
    exceeds that network's own error at the other frames is taken to grow with the distance from the nearest of them.

    Args:
        starts_at: makes the localizer that is to be used.
        rehearsed_at: makes one whose network tuned on no frame of the regions.
        recording: posed frames.
        regions: frames held out, by viewpoint, see :func:`monoloc.adapt.hold_out.hold_out_regions`; without any,
            nothing was tuned: nothing grows, and there is no mean, for such a network's is of the place.
    """
    poses = recording.poses
    assert poses is not None
    is_near = np.ones(len(recording), dtype=np.bool_)
    for region in regions:
        is_near[region] = False
    times_s = recording.timestamps_s
    walks = _some([_way(walk) for walk in _unbroken(np.arange(len(recording)), times_s, poses)])
    stays = [_stay(place) for region in regions for place in _unbroken(region, times_s, poses)]
    done, total = 0, sum(len(way.frames) for way in [*walks, *(walks if stays else []), *stays])
    with progress.task("covariances", total) as show:

        def follow(at: StartsAt, ways: list[_Way]) -> tuple[FloatArray, NDArray[np.int64]]:
            """Poses (N, 4, 4) at the frames (N,) of ways that count."""
            nonlocal done
            found, frames = [], []
            for way in ways:
                localizer = at(poses[way.frames[0]])
                elapsed_s = np.abs(np.diff(times_s[way.frames], prepend=times_s[way.frames[:1]]))
                for place, index in enumerate(way.frames.tolist()):
                    pose = localizer.step(recording.color(index), float(elapsed_s[place])).located.pose
                    if place >= way.passed:
                        found.append(pose)
                        frames.append(index)
                    done += 1
                    show(done)
            return np.stack(found), np.array(frames)

        followed, frames = follow(starts_at, walks)
        if not stays:
            near_m, near_rad = axis_sd(pose_errors(followed, poses[frames]))
            return LastingErrors(near_sd_m=near_m, near_sd_rad=near_rad)
        once = np.bincount(frames, minlength=len(poses))[frames] == 1  # to and fro is no way
        mean = mean_error(followed[once], poses[frames[once]])
        near = pose_errors(followed @ se3_exp(-mean), poses[frames])
        followed, frames = follow(rehearsed_at, walks)
        counts = is_near[frames]
        rehearsed = pose_errors(followed[counts], poses[frames[counts]])
        followed, frames = follow(rehearsed_at, stays)
    away = pose_errors(followed, poses[frames])
    distances_m = np.array([viewpoints_apart(pose, poses[is_near]).min() for pose in poses[frames]])
    return lasting_errors(near, rehearsed, away, distances_m).model_copy(update={"mean": tuple(mean.tolist())})


def mean_error(found: FloatArray, truth: FloatArray) -> FloatArray:
    """What poses along a way err by in the mean, a twist (6,) in the camera's frame, as far as that is sure.

    The way is cut into pieces, whose means are held to be independent (batch means); each axis counts by the share
    ``1 - se^2 / mean^2`` that is no chance (James and Stein 1961), and a short way has none.

    Args:
        found, truth: ``T_world_camera``, (N, 4, 4), in order along the way.
    """
    # Where another walk begins the camera is elsewhere, however far that is.
    way_m = np.cumsum([0.0, *np.minimum(_GAP_M, _steps_m(truth))])
    pieces = int(way_m[-1] / _PIECE_M)
    if pieces < _FEWEST_PIECES:
        return np.zeros(6)
    twists = se3_log(invert(truth) @ found)
    cuts = np.searchsorted(way_m, np.linspace(0.0, way_m[-1], pieces + 1)[1:-1])
    means = np.stack([piece.mean(axis=0) for piece in np.split(twists, cuts)])
    mean, variance = means.mean(axis=0), means.var(axis=0, ddof=1) / len(means)
    return np.asarray(mean * np.maximum(0.0, 1.0 - variance / np.maximum(mean**2, 1e-12)))


def lasting_errors(
    near: PoseErrors, rehearsed: PoseErrors, away: PoseErrors, distances_m: FloatArray
) -> LastingErrors:
    """Near errors' deviation, and its growth, from what the median of those away asks for and from what is usual.

    Args:
        near: with the network that all frames tuned, one at least.
        rehearsed, away: with the other one, at frames that tuned it and at those that did not; one at least.
        distances_m: of those away from the nearest that tuned it, (N,).
    """
    near_m, near_rad = axis_sd(near)
    rehearsed_m, rehearsed_rad = axis_sd(rehearsed)
    return LastingErrors(
        near_sd_m=near_m,
        near_sd_rad=near_rad,
        growth_m=_growth(away.position_m, rehearsed_m, distances_m),
        growth_rad=_growth(away.rotation_rad, rehearsed_rad, distances_m),
    )


def _growth(errors: FloatArray, near_sd: float, distances_m: FloatArray) -> float:
    """Of an error's deviation with distance, so that half of (N,) errors are under the median that it gives them.

    A few regions can be lucky, so its square is averaged with that of the usual growth.
    """
    beyond = errors**2 / CHI2_MEDIAN_3 - near_sd**2
    measured = max(0.0, float(np.median(beyond / np.maximum(distances_m, _LEAST_DISTANCE_M) ** 2)))
    return math.sqrt(0.5 * (measured + _USUAL_GROWTH**2))


def _steps_m(poses: FloatArray) -> FloatArray:
    """From each of (N, 4, 4) poses to the next, (N - 1,), metres, with a radian of rotation for one more."""
    return np.array([viewpoints_apart(a, b[None])[0] for a, b in itertools.pairwise(poses)], np.float64)


def _unbroken(walk: NDArray[np.int64], times_s: FloatArray, poses: FloatArray) -> list[NDArray[np.int64]]:
    """The parts of a walk over frames, in order of time, within which the camera can be followed."""
    gaps = (np.diff(times_s[walk]) > _GAP_S) | (_steps_m(poses[walk]) > _GAP_M)
    return np.split(walk, 1 + np.flatnonzero(gaps))


@dataclass(frozen=True)
class _Way:
    """Frames (N,) to be followed one after another, of which the first ``passed`` do not count."""

    frames: NDArray[np.int64]
    passed: int


def _way(walk: NDArray[np.int64]) -> _Way:
    """A walk once, or, where the start would not be forgotten, as :func:`_stay`."""
    return _Way(walk, 0) if len(walk) >= _STAY else _stay(walk)


def _stay(place: NDArray[np.int64]) -> _Way:
    """Frames in order, back, and again, until the camera has stayed long enough after the first time.

    The first time through a place still shows what was brought along.
    """
    cycle = np.concatenate([place, place[-2:0:-1]])
    return _Way(np.tile(cycle, 1 + math.ceil(_STAY / len(cycle))), len(place))


def _some(ways: list[_Way]) -> list[_Way]:
    """Evenly chosen, so many at most: frames that each stand alone would be followed for minutes."""
    return ways[:: math.ceil(len(ways) / _MOST_WALKS)]
