"""How wide the errors are that last, measured by following frames that tuned nothing."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from monoloc.datasets.base import Recording
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors, axis_sd, pose_errors
from monoloc.filter.lasting import LastingErrors
from monoloc.geometry import FloatArray, viewpoints_apart
from monoloc.localizer import Localizer
from monoloc.progress import Progress

_STAY = 60  # frames: the start is forgotten, and what is left is what the depth there says
_GAP_S, _GAP_M = 1.5, 0.5  # between frames, the latter with a radian for a metre: no camera is followed over more
_LEAST_DISTANCE_M = 0.01
_USUAL_GROWTH = 0.1  # m and rad a metre away, of other networks and other parts of a room

# From a start, ``T_world_camera``, to a localizer.
StartsAt = Callable[[FloatArray], Localizer]


def measure_lasting(
    starts_at: StartsAt,
    rehearsed_at: StartsAt,
    recording: Recording,
    regions: list[NDArray[np.int64]],
    progress: Progress,
) -> LastingErrors:
    """What lasts, near the viewpoints that tuned and away from them.

    Near: the recording is followed from its first pose with the network that all its frames tuned, and where it was
    paused, or is of several walks, from the first pose afterwards. Away: with one that no frame of the regions tuned,
    the camera stays in each of them, to and fro over its frames, since a filter that only passes through brings the
    pose it has along. What exceeds that network's own error at the other frames is taken to grow with the distance
    from the nearest of them.

    Args:
        starts_at: makes the localizer that is to be used.
        rehearsed_at: makes one whose network tuned on no frame of the regions.
        recording: posed frames.
        regions: frames held out, by viewpoint, see :func:`monoloc.adapt.hold_out.hold_out_regions`; without any,
            nothing grows.
    """
    poses = recording.poses
    assert poses is not None
    is_near = np.ones(len(recording), dtype=np.bool_)
    for region in regions:
        is_near[region] = False
    walks = _unbroken(np.arange(len(recording)), recording.timestamps_s, poses)
    places = [part for region in regions for part in _unbroken(region, recording.timestamps_s, poses)]
    stays = [_to_and_fro(place) for place in places]
    done = 0
    with progress.task("covariances", len(recording) * (2 if stays else 1) + sum(map(len, stays))) as show:

        def follow(at: StartsAt, walk: NDArray[np.int64]) -> FloatArray:
            """Poses (N, 4, 4) of the frames of a walk, one after the other."""
            nonlocal done
            localizer, found = at(poses[walk[0]]), []
            times = recording.timestamps_s[walk]
            for index, elapsed_s in zip(walk.tolist(), np.abs(np.diff(times, prepend=times[:1])), strict=True):
                found.append(localizer.step(recording.color(index), float(elapsed_s)).located.pose)
                done += 1
                show(done)
            return np.stack(found)

        near = pose_errors(np.concatenate([follow(starts_at, walk) for walk in walks]), poses)
        if not stays:
            near_m, near_rad = axis_sd(near)
            return LastingErrors(near_sd_m=near_m, near_sd_rad=near_rad)
        followed = np.concatenate([follow(rehearsed_at, walk) for walk in walks])
        rehearsed = pose_errors(followed[is_near], poses[is_near])
        # The first time through a place still shows what was brought along.
        ways = [follow(rehearsed_at, stay)[len(place) :] for place, stay in zip(places, stays, strict=True)]
    frames = np.concatenate([stay[len(place) :] for place, stay in zip(places, stays, strict=True)])
    away = pose_errors(np.concatenate(ways), poses[frames])
    distances_m = np.array([viewpoints_apart(pose, poses[is_near]).min() for pose in poses[frames]])
    return lasting_errors(near, rehearsed, away, distances_m)


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


def _unbroken(walk: NDArray[np.int64], times_s: FloatArray, poses: FloatArray) -> list[NDArray[np.int64]]:
    """The parts of a walk over frames, in order of time, within which the camera can be followed."""
    apart_m = np.array([viewpoints_apart(poses[a], poses[b][None])[0] for a, b in itertools.pairwise(walk)])
    gaps = (np.diff(times_s[walk]) > _GAP_S) | (apart_m > _GAP_M)
    return np.split(walk, 1 + np.flatnonzero(gaps))


def _to_and_fro(region: NDArray[np.int64]) -> NDArray[np.int64]:
    """Frames of a region in order, back, and again, until the camera has stayed long enough after the first time."""
    cycle = np.concatenate([region, region[-2:0:-1]])
    return np.tile(cycle, 1 + math.ceil(_STAY / len(cycle)))
