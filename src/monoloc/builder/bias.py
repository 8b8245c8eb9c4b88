"""Measurement of the particles' bias, by running localizers over a build's own frames."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.trajectories import (
    Trajectory,
    continuous_segments,
    forward_and_backward,
    hover,
    is_long,
    recording_segments,
    selection,
    single_pass,
)
from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.components import Components, ComponentsFactory, default_components
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors, axis_sd, twist_errors
from monoloc.fusion.bias_filter import decayed
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses, bias_correlation
from monoloc.geometry import FloatArray, invert, pose_distance_m, se3_exp, se3_log
from monoloc.io.recording import Recording
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.landmarks.pnp import NoLandmarks
from monoloc.localizer import Localizer
from monoloc.localizer_config import LocalizerConfig
from monoloc.progress import Progress
from monoloc.start import Start

_LEAST_DISTANCE_M = 0.01
_MOST_PASSES, _MOST_HOVERS = 8, 8  # segments that the hold-out network follows, and parts of regions it hovers in
_PRIOR_GROWTH = 0.1  # metres and radians a metre, of adapted networks in other rooms
_STILL_S = 1.0 / 15.0  # between the images of a camera that stays at one frame

LocalizerFactory = Callable[[FloatArray], Localizer]
"""Makes a localizer that starts at a pose, ``T_world_camera`` (4, 4)."""


def localizer_factory(
    bundle: Bundle, seed: int, components: ComponentsFactory = default_components
) -> LocalizerFactory:
    """Makes localizers to measure a bundle's bias with, for the camera of its build recording.

    They neither relocalise, so that errors grow as far as they do, nor use landmarks, which do not measure the
    particles' bias, nor keep a budget, so that the result does not depend on the computer's speed.
    """
    settings = bundle.settings.model_copy(update={"budget_ms": None})
    room = replace(bundle, settings=settings, reference_poses=ReferencePoses.none(), landmarks=Landmarks.none())

    def without_landmarks(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
        return replace(components(bundle, camera, config), landmarks=NoLandmarks())

    def make(pose: FloatArray) -> Localizer:
        return Localizer(room, room.camera, Start(pose), components=without_landmarks, seed=seed)

    return make


def measure_bias(
    final: LocalizerFactory,
    hold_out: LocalizerFactory,
    recording: Recording,
    regions: list[NDArray[np.int64]],
    progress: Progress,
) -> tuple[BiasModel, ReferencePoses, KnownBiasCheck | None]:
    """Bias at the reference poses, and its growth away from them.

    At the reference poses: :func:`measure_bias_at_reference`. Away from them: a localizer whose network was tuned on
    no frame of the held-out regions hovers in each of them, since a filter that only passes through still carries the
    pose it had before. What exceeds that network's own error at the other frames is taken to grow with the distance
    to the nearest of them.

    The bias at the reference poses is known to later flights only where knowing it helps on frames that nothing was
    tuned on: the hold-out localizer's bias is measured at its own reference poses in the same way, and subtracted in
    its other flights through the held-out regions (:class:`KnownBiasCheck`).

    Args:
        final: makes the localizer whose bias is measured.
        hold_out: makes one whose network was tuned on no frame of the regions.
        recording: posed frames, N of them.
        regions: held-out frames, one array a region, see :func:`monoloc.evaluation.hold_out.hold_out_regions`; with
            none, nothing was adapted, the bias does not grow, and none is known.

    Returns:
        Standard deviation of the unknown part of the bias, the N reference poses with the known part, and what
        decided whether there is one; None where nothing could: no frame is held out, or no segment is long enough.
    """
    poses = recording.poses
    assert poses is not None
    times_s = recording.timestamps_s
    parts = [part for region in regions for part in continuous_segments(region, times_s, poses)]
    hovers = [hover(part) for part in selection(parts, _MOST_HOVERS)]
    if not hovers:
        return *measure_bias_at_reference(final, recording, False, progress), None
    segments = recording_segments(times_s, poses)
    at_reference = _reference_trajectories(segments, True)
    is_reference = np.ones(len(recording), dtype=np.bool_)
    is_reference[np.concatenate(regions)] = False
    with_reference = [segment for segment in segments if is_reference[segment].any()]
    passes = [single_pass(part) for part in selection(with_reference, _MOST_PASSES)]
    with progress.task("covariances", _frame_count([*at_reference, *at_reference, *passes, *hovers])) as show:
        follow = _Follower(recording, poses, show)
        errors, of_hold_out = follow(final, at_reference), follow(hold_out, at_reference)
        hold_out_errors, away_errors = follow(hold_out, passes), follow(hold_out, hovers)
    tuned_on = is_reference[_scored(passes)]
    distances_m = [pose_distance_m(pose, poses[is_reference]).min() for pose in poses[_scored(hovers)]]
    hold_out_at_reference = twist_errors(np.concatenate(hold_out_errors)[tuned_on])

    def model_of(remaining: list[FloatArray]) -> BiasModel:
        return fit_bias_model(_sizes(remaining), hold_out_at_reference, _sizes(away_errors), np.array(distances_m))

    if not any(map(is_long, segments)):  # rounding would decide between errors that are the same
        return model_of(errors), ReferencePoses.without_bias(poses), None
    remaining, reference_poses = _known_bias(errors, segments, poses, True)
    hold_out_remaining, known = _known_bias(of_hold_out, segments, poses, True)
    flown = list(zip([*passes, *hovers], [*hold_out_errors, *away_errors], strict=True))
    check = _check_known_bias(
        known.selection(is_reference), model_of(hold_out_remaining), flown, ~is_reference, recording
    )
    if not check.helps:
        remaining, reference_poses = errors, ReferencePoses.without_bias(poses)
    return model_of(remaining), reference_poses, check


def measure_bias_at_reference(
    final: LocalizerFactory, recording: Recording, is_tuned: bool, progress: Progress
) -> tuple[BiasModel, ReferencePoses]:
    """Bias at the poses of a recording, without growth.

    Long segments of the recording are followed forward and backward, so that the bias of the place is separated from
    that of the direction. Short ones are hovered in; of their poses no bias is known.

    Args:
        final: makes the localizer whose bias is measured.
        recording: posed frames, N of them.
        is_tuned: whether the network was tuned on the frames. If not, another flight has other errors there, so none
            is known, and one pass is enough.

    Returns:
        As :func:`measure_bias`.
    """
    poses = recording.poses
    assert poses is not None
    segments = recording_segments(recording.timestamps_s, poses)
    trajectories = _reference_trajectories(segments, is_tuned)
    with progress.task("covariances", _frame_count(trajectories)) as show:
        errors = _Follower(recording, poses, show)(final, trajectories)
    remaining, reference_poses = _known_bias(errors, segments, poses, is_tuned)
    sd_m, sd_rad = axis_sd(_sizes(remaining))
    return BiasModel.bounded(sd_at_reference_m=sd_m, sd_at_reference_rad=sd_rad), reference_poses


@dataclass(frozen=True)
class KnownBiasCheck:
    """Errors of the hold-out localizer on held-out frames, before and after its known bias is subtracted.

    The trajectories are other ones than that which measured the bias, and the frames are not among those that the
    bias is known of. Root mean squares of position and rotation error, metres and radians.
    """

    before_m: float
    before_rad: float
    after_m: float
    after_rad: float

    @property
    def helps(self) -> bool:
        """Whether position or rotation is better and neither is worse."""
        changes = self.after_m - self.before_m, self.after_rad - self.before_rad
        return max(changes) <= 0.0 and min(changes) < 0.0


def _check_known_bias(
    known: ReferencePoses,
    model: BiasModel,
    flown: list[tuple[Trajectory, FloatArray]],
    held_out: NDArray[np.bool_],
    recording: Recording,
) -> KnownBiasCheck:
    """Subtract the known bias from errors as a flight would.

    Args:
        known: of the hold-out localizer, at the poses that it was tuned on.
        model: of its bias there.
        flown: its trajectories, and its errors at their scored frames, twists (M, 6).
        held_out: (N,) which frames of the recording count.
    """
    poses = recording.poses
    assert poses is not None
    before, after = [], []
    for trajectory, errors in flown:
        counted = held_out[trajectory.scored]
        recent = _recent_motions(trajectory, poses, recording.timestamps_s)[trajectory.warm_up :]
        for error, frame, motion in zip(errors[counted], trajectory.scored[counted], recent[counted], strict=True):
            share = model.reference_variance_share(known.distance_m(poses[frame]))
            corrected = poses[frame] @ se3_exp(error) @ se3_exp(-share * known.bias_at(poses[frame], motion))
            before.append(error)
            after.append(se3_log(invert(poses[frame]) @ corrected))
    sizes = [twist_errors(np.stack(errors)) for errors in (before, after)]
    rms = [float(np.sqrt(np.mean(size**2))) for each in sizes for size in (each.position_m, each.rotation_rad)]
    return KnownBiasCheck(*rms)


def _recent_motions(trajectory: Trajectory, poses: FloatArray, times_s: FloatArray) -> FloatArray:
    """Recent motion at each frame of a trajectory, twists (M, 6); as the belief's filter has it."""
    frames, motions = trajectory.frames, [np.zeros(6)]
    for previous, frame in itertools.pairwise(frames.tolist()):
        moved = se3_log(invert(poses[previous]) @ poses[frame])
        motions.append(decayed(motions[-1], abs(float(times_s[frame] - times_s[previous]))) + moved)
    return np.stack(motions)


def _reference_trajectories(segments: list[NDArray[np.int64]], is_tuned: bool) -> list[Trajectory]:
    """One of each segment, in order."""
    if not is_tuned:
        return [single_pass(segment) for segment in segments]
    return [forward_and_backward(segment) if is_long(segment) else hover(segment) for segment in segments]


def _known_bias(
    errors: list[FloatArray], segments: list[NDArray[np.int64]], poses: FloatArray, is_tuned: bool
) -> tuple[list[FloatArray], ReferencePoses]:
    """Errors less the known bias, twists (M, 6) a segment, and the reference poses with that bias.

    Args:
        errors: on the :func:`_reference_trajectories`, twists (M, 6) each.
    """
    long = [segment for segment in segments if is_long(segment)]
    if not is_tuned or not long:
        return errors, ReferencePoses.without_bias(poses)
    forward, backward = _directions(
        [each for each, segment in zip(errors, segments, strict=True) if is_long(segment)]
    )
    known = np.zeros((2, len(poses), 6))
    known[:, np.concatenate(long)] = forward, backward
    # Of a flight in another direction, one direction's bias predicts the other's by their correlation.
    correlation = bias_correlation(forward, backward)
    short = [each for each, segment in zip(errors, segments, strict=True) if not is_long(segment)]
    remaining = [_difference(forward, correlation * backward), _difference(backward, correlation * forward), *short]
    return remaining, ReferencePoses(poses, *known)


class _Follower:
    """Runs localizers along trajectories over a recording, and shows how many frames are done."""

    def __init__(self, recording: Recording, poses: FloatArray, show: Callable[[int], None]) -> None:
        self._recording, self._poses, self._show = recording, poses, show
        self._done = 0

    def __call__(self, make: LocalizerFactory, trajectories: list[Trajectory]) -> list[FloatArray]:
        """Errors of the particles' pose at the scored frames, twists (M, 6) a trajectory."""
        return [
            se3_log(invert(self._poses[each.scored]) @ self._particle_poses(make, each)[each.warm_up :])
            for each in trajectories
        ]

    def _particle_poses(self, make: LocalizerFactory, trajectory: Trajectory) -> FloatArray:
        """``T_world_camera`` of the particles at each frame, (N, 4, 4)."""
        localizer = make(self._poses[trajectory.frames[0]])
        times_s = self._recording.timestamps_s[trajectory.frames]
        is_still = len(times_s) > 1 and bool(np.all(trajectory.frames == trajectory.frames[0]))
        elapsed_s = np.full(len(times_s), _STILL_S) if is_still else np.abs(np.diff(times_s, prepend=times_s[:1]))
        poses: list[FloatArray] = []
        for index, since_s in zip(trajectory.frames.tolist(), elapsed_s.tolist(), strict=True):
            color = self._recording.color(index)
            if is_still and len(poses) % 2:
                color = _seen_again(color)
            poses.append(localizer.step(color, since_s).particle_estimate.pose)
            self._done += 1
            self._show(self._done)
        return np.stack(poses)


def _seen_again(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Another image of the same view: a localizer learns nothing from one that is the same, bit for bit."""
    other = color.copy()
    other[-1, -1, -1] ^= 1
    return other


def fit_bias_model(
    at_reference: PoseErrors,
    hold_out_at_reference: PoseErrors,
    away_from_reference: PoseErrors,
    distances_m: FloatArray,
    prior_growth: float = _PRIOR_GROWTH,
) -> BiasModel:
    """Standard deviation at the reference poses, and growth from the median of the errors away from them.

    Args:
        at_reference: of the final network, at least one.
        hold_out_at_reference, away_from_reference: of the hold-out network, at frames that it was tuned on, at least
            one, and at frames that it was not.
        distances_m: from the latter to the nearest of the former, (N,).
        prior_growth: of both position and rotation, metres and radians a metre.
    """
    sd_m, sd_rad = axis_sd(at_reference)
    hold_out_m, hold_out_rad = axis_sd(hold_out_at_reference)
    return BiasModel.bounded(
        sd_at_reference_m=sd_m,
        sd_at_reference_rad=sd_rad,
        sd_growth_m=_growth(away_from_reference.position_m, hold_out_m, distances_m, prior_growth),
        sd_growth_rad=_growth(away_from_reference.rotation_rad, hold_out_rad, distances_m, prior_growth),
    )


def _growth(errors: FloatArray, sd_at_reference: float, distances_m: FloatArray, prior: float) -> float:
    """Growth of the standard deviation with distance, under which half of (N,) errors are below their median.

    A few regions can be lucky, so its square is averaged with that of the prior, which stands alone without errors.
    """
    if len(errors) == 0:
        return prior
    beyond = errors**2 / CHI2_MEDIAN_3 - sd_at_reference**2
    measured = max(0.0, float(np.median(beyond / np.maximum(distances_m, _LEAST_DISTANCE_M) ** 2)))
    return math.sqrt(0.5 * (measured + prior**2))


def _directions(errors: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Errors forward and errors backward, (N, 6) each, frame by frame, of forward-and-backward trajectories."""
    both = [np.split(each, 2) for each in errors]
    return np.concatenate([forward for forward, _ in both]), np.concatenate([backward[::-1] for _, backward in both])


def _frame_count(trajectories: list[Trajectory]) -> int:
    return sum(len(trajectory.frames) for trajectory in trajectories)


def _scored(trajectories: list[Trajectory]) -> NDArray[np.int64]:
    return np.concatenate([trajectory.scored for trajectory in trajectories])


def _difference(errors: FloatArray, known: FloatArray) -> FloatArray:
    """Errors less their known part, twists (N, 6)."""
    return se3_log(se3_exp(errors) @ se3_exp(-known))


def _sizes(errors: list[FloatArray]) -> PoseErrors:
    """Sizes of twists (N, 6) of several trajectories, all together."""
    return twist_errors(np.concatenate(errors))
