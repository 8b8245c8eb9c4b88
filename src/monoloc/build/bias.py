"""How wide the errors are that last, and what they are at each viewpoint, by following a build's own frames."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from monoloc.build.trajectories import Way, is_long, once, stay, there_and_back, unbroken, walks_of
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors, axis_sd, twist_errors
from monoloc.fusion.bias_model import LastingErrors
from monoloc.fusion.reference_poses import Viewpoints, likeness
from monoloc.geometry import FloatArray, invert, se3_exp, se3_log, viewpoints_apart
from monoloc.io.recording import Recording
from monoloc.localizer import Localizer
from monoloc.progress import Progress

_LEAST_DISTANCE_M = 0.01
_USUAL_GROWTH = 0.1  # m and rad a metre away, of networks in other parts of a room

# From a start, ``T_world_camera``, to a localizer.
StartsAt = Callable[[FloatArray], Localizer]


def measure_lasting(
    starts_at: StartsAt,
    rehearsed_at: StartsAt,
    recording: Recording,
    regions: list[NDArray[np.int64]],
    is_tuned: bool,
    progress: Progress,
) -> tuple[LastingErrors, Viewpoints]:
    """How wide lasting errors are, near the viewpoints that tuned and away from them, and what they are at each.

    Near: see :func:`measure_near`. Away: with a network that no frame of the regions tuned, the camera stays in each
    of them, to and fro over its frames, since a filter that only passes through brings the pose it has along. What
    exceeds that network's own error at the other frames is taken to grow with the distance from the nearest of them.

    Args:
        starts_at: makes the localizer that is to be used.
        rehearsed_at: makes one whose network tuned on no frame of the regions.
        recording: posed frames, N of them.
        regions: frames held out, by viewpoint, see :func:`monoloc.evaluation.hold_out.hold_out_regions`; without any,
            nothing was adapted, and nothing grows.
        is_tuned: whether the network learned of the frames, see :func:`measure_near`.

    Returns:
        The widths, about what is known of the errors; and that, at the recording's N viewpoints.
    """
    poses = recording.poses
    assert poses is not None
    times_s = recording.timestamps_s
    walks = walks_of(times_s, poses)
    stays = [stay(place) for region in regions for place in unbroken(region, times_s, poses)]
    if not stays:
        return measure_near(starts_at, recording, is_tuned, progress)
    ways, single = _near_ways(walks, is_tuned), [once(walk) for walk in walks]
    with progress.task("covariances", _frames_of([*ways, *single, *stays])) as show:
        follow = _Follower(recording, poses, show)
        errors = follow(starts_at, ways)
        rehearsed, away = follow(rehearsed_at, single), follow(rehearsed_at, stays)
    near, viewpoints = _what_is_known(errors, walks, poses, is_tuned)
    is_near = np.ones(len(recording), dtype=np.bool_)
    is_near[np.concatenate(regions)] = False
    counts = is_near[_counted(single)]
    distances_m = [viewpoints_apart(pose, poses[is_near]).min() for pose in poses[_counted(stays)]]
    rehearsed_near = twist_errors(np.concatenate(rehearsed)[counts])
    return lasting_errors(_sizes(near), rehearsed_near, _sizes(away), np.array(distances_m)), viewpoints


def measure_near(
    starts_at: StartsAt, recording: Recording, is_tuned: bool, progress: Progress
) -> tuple[LastingErrors, Viewpoints]:
    """How wide lasting errors are at the viewpoints of a recording, and what they are at each.

    The recording is followed there and back, and where it was paused, or is of several walks, each of those; walks so
    short that their start is not forgotten are gone to and fro, and no viewpoint's error is known of them.

    Args:
        starts_at: makes the localizer that is to be used.
        recording: posed frames, N of them.
        is_tuned: whether the network learned of the frames: if not, errors there are another flight's only sometimes,
            so none is known of any viewpoint, and the recording is followed once.

    Returns:
        The widths, about what is known of the errors, without growth; and that, at the N viewpoints.
    """
    poses = recording.poses
    assert poses is not None
    walks = walks_of(recording.timestamps_s, poses)
    ways = _near_ways(walks, is_tuned)
    with progress.task("covariances", _frames_of(ways)) as show:
        errors = _Follower(recording, poses, show)(starts_at, ways)
    near, viewpoints = _what_is_known(errors, walks, poses, is_tuned)
    near_m, near_rad = axis_sd(_sizes(near))
    return LastingErrors(near_sd_m=near_m, near_sd_rad=near_rad), viewpoints


def _near_ways(walks: list[NDArray[np.int64]], is_tuned: bool) -> list[Way]:
    """One of each walk, in order."""
    if not is_tuned:
        return [once(walk) for walk in walks]
    return [there_and_back(walk) if is_long(walk) else stay(walk) for walk in walks]


def _what_is_known(
    errors: list[FloatArray], walks: list[NDArray[np.int64]], poses: FloatArray, is_tuned: bool
) -> tuple[list[FloatArray], Viewpoints]:
    """Of errors on :func:`_near_ways`, twists (M, 6) each, what is left about what is known; and the viewpoints."""
    long = [walk for walk in walks if is_long(walk)]
    if not is_tuned or not long:
        return errors, Viewpoints.of(poses)
    there, back = _passes([way for way, walk in zip(errors, walks, strict=True) if is_long(walk)])
    known = np.zeros((2, len(poses), 6))
    known[:, np.concatenate(long)] = there, back
    # Of a flight that is still to come, and takes another way, what one of these foretells is known.
    alike = likeness(there, back)
    short = [way for way, walk in zip(errors, walks, strict=True) if not is_long(walk)]
    return [_less(there, alike * back), _less(back, alike * there), *short], Viewpoints(poses, *known)


class _Follower:
    """Follows ways over a recording, and shows how many frames are done."""

    def __init__(self, recording: Recording, poses: FloatArray, show: Callable[[int], None]) -> None:
        self._recording, self._poses, self._show = recording, poses, show
        self._done = 0

    def __call__(self, at: StartsAt, ways: list[Way]) -> list[FloatArray]:
        """Of each way, errors at its frames that count, twists (M, 6)."""
        return [se3_log(invert(self._poses[way.counted]) @ self._found(at, way)[way.passed :]) for way in ways]

    def _found(self, at: StartsAt, way: Way) -> FloatArray:
        """What the particles say at each frame, (N, 4, 4)."""
        localizer = at(self._poses[way.frames[0]])
        times_s = self._recording.timestamps_s[way.frames]
        elapsed_s = np.abs(np.diff(times_s, prepend=times_s[:1]))
        found = []
        for index, since_s in zip(way.frames.tolist(), elapsed_s.tolist(), strict=True):
            found.append(localizer.step(self._recording.color(index), since_s).located.pose)
            self._done += 1
            self._show(self._done)
        return np.stack(found)


def lasting_errors(
    near: PoseErrors,
    rehearsed: PoseErrors,
    away: PoseErrors,
    distances_m: FloatArray,
    usual_growth: float = _USUAL_GROWTH,
) -> LastingErrors:
    """Near errors' deviation, and its growth, from what the median of those away asks for and from what is usual.

    Args:
        near: with the network that all frames tuned, one at least.
        rehearsed, away: with the other one, at frames that tuned it, one at least, and at those that did not.
        distances_m: of those away from the nearest that tuned it, (N,).
        usual_growth: of both, m and rad a metre.
    """
    near_m, near_rad = axis_sd(near)
    rehearsed_m, rehearsed_rad = axis_sd(rehearsed)
    return LastingErrors(
        near_sd_m=near_m,
        near_sd_rad=near_rad,
        growth_m=_growth(away.position_m, rehearsed_m, distances_m, usual_growth),
        growth_rad=_growth(away.rotation_rad, rehearsed_rad, distances_m, usual_growth),
    )


def _growth(errors: FloatArray, near_sd: float, distances_m: FloatArray, usual: float) -> float:
    """Of an error's deviation with distance, so that half of (N,) errors are under the median that it gives them.

    A few regions can be lucky, so its square is averaged with that of the usual growth, which is all there is without
    errors.
    """
    if len(errors) == 0:
        return usual
    beyond = errors**2 / CHI2_MEDIAN_3 - near_sd**2
    measured = max(0.0, float(np.median(beyond / np.maximum(distances_m, _LEAST_DISTANCE_M) ** 2)))
    return math.sqrt(0.5 * (measured + usual**2))


def _passes(ways: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Errors there and errors back, (N, 6) each, frame by frame, of :func:`there_and_back` ways."""
    both = [np.split(way, 2) for way in ways]
    return np.concatenate([there for there, _ in both]), np.concatenate([back[::-1] for _, back in both])


def _frames_of(ways: list[Way]) -> int:
    return sum(len(way.frames) for way in ways)


def _counted(ways: list[Way]) -> NDArray[np.int64]:
    return np.concatenate([way.counted for way in ways])


def _less(errors: FloatArray, foretold: FloatArray) -> FloatArray:
    """What is left of errors when others are taken off, twists (N, 6)."""
    return se3_log(se3_exp(errors) @ se3_exp(-foretold))


def _sizes(errors: list[FloatArray]) -> PoseErrors:
    """Of twists (N, 6) of several ways, all together."""
    return twist_errors(np.concatenate(errors))
