"""A recording, localised frame by frame, and its figures."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle, fingerprint, require_bundle
from monoloc.components import ComponentsFactory, default_components
from monoloc.depth.predictor import DepthPrediction
from monoloc.errors import DataError
from monoloc.evaluation.consistency import consistency
from monoloc.evaluation.depth_metrics import DepthAccumulator
from monoloc.evaluation.trajectory import summarise
from monoloc.geometry import FloatArray, invert
from monoloc.io.recording import Recording, Relight, check_arrays, require_recording
from monoloc.localizer import Localizer
from monoloc.localizer_config import LocalizerConfig
from monoloc.odometry.motion import Motion, tracks_translation
from monoloc.particle_filter.estimate import Estimate
from monoloc.parts import leave_out
from monoloc.progress import Progress
from monoloc.sensor_depth import sensor_bundle, sparse_depth
from monoloc.settled_objects import settled
from monoloc.start import Start
from monoloc.step import LocalizedFrame, Step
from monoloc.step_budget import Level, level_counts
from monoloc.supervision.map_change import ChangedRegion, merged
from monoloc.supervision.state import VOUCHED_FOR, Reason, State
from monoloc.viz.viewer import NoViewer, Viewer

_COMPARE_WIDTH = 160  # width at which predicted and sensor depth are compared


@dataclass(frozen=True)
class Run:
    """Results of N frames.

    Attributes:
        recording, config: what was localised, and with which settings.
        start: ``T_world_camera``, (4, 4), that the localizer was given; None without one.
        poses, covariances: (N, 4, 4) ``T_world_camera`` and (N, 6, 6), see :class:`Estimate`.
        odometry: (N, 4, 4) dead reckoning from the first true pose, else from the start, else from the first
            estimate; None if no motion was measured.
        unseen: (N,) frames that the bundle was not built from.
        states, reasons: of the frames; a frame that is *tracking* has no reasons.
        levels: what each step left out to keep its budget.
        mean_log_likelihoods, log_scales, step_ms: (N,).
        landmark_used: (N,) frames in which landmarks measured the pose.
        truth: (N, 4, 4) or None.
        standing_shares: (N,) of the image, see :class:`Step`.
        motion_contradicted: (N,) frames in which another sensor's motion contradicts that of the images.
        depth: accuracy of the depth used, over all and over unseen frames; None without sensor depth.
        changed_regions: that *map-changed* frames named, with their numbers of frames, the most first.
    """

    recording: Recording
    config: LocalizerConfig
    start: FloatArray | None
    poses: FloatArray
    covariances: FloatArray
    odometry: FloatArray | None
    unseen: NDArray[np.bool_]
    states: list[State]
    reasons: list[frozenset[Reason]]
    levels: list[Level]
    mean_log_likelihoods: FloatArray
    log_scales: FloatArray
    step_ms: FloatArray
    landmark_used: NDArray[np.bool_]
    standing_shares: FloatArray
    motion_contradicted: NDArray[np.bool_]
    depth: tuple[DepthAccumulator, DepthAccumulator] | None
    changed_regions: Sequence[tuple[ChangedRegion, int]] = ()

    @property
    def truth(self) -> FloatArray | None:
        return self.recording.poses

    def metrics(self) -> dict[str, object]:
        """The figures, ready for JSON; those prefixed ``unseen_`` are over unseen frames."""
        everything = np.ones(len(self.poses), dtype=np.bool_)
        figures: dict[str, object] = {
            "frames": len(self.poses),
            **self._accuracy(everything),
            "lost_frames": self.states.count("lost"),
            "states": dict(Counter(self.states)),
            "reasons": self._reason_counts(),
            "changed_regions": [
                {"lower_m": region.lower.tolist(), "upper_m": region.upper.tolist(), "frames": frames}
                for region, frames in self.changed_regions
            ],
            "landmark_used_frames": int(self.landmark_used.sum()),
            "standing_share_median": float(np.median(self.standing_shares)),
            "motion_contradicted_frames": int(self.motion_contradicted.sum()),
            "step_ms_median": float(np.median(self.step_ms)),
            "step_ms_p95": float(np.percentile(self.step_ms, 95.0)),
            "step_ms_p99": float(np.percentile(self.step_ms, 99.0)),
            "budget_ms": self.config.budget_ms,
            "levels": level_counts(Counter(self.levels)),
            "particles": self.config.particles,
            "scan_points": self.config.scan_points,
            "motion": self.config.motion,
            "without": list(self.config.without),
            **self._depth_accuracy(0),
            "unseen_frames": int(self.unseen.sum()),
        }
        if self.unseen.any():
            unseen = {**self._accuracy(self.unseen), **self._depth_accuracy(1)}
            figures |= {f"unseen_{name}": value for name, value in unseen.items()}
        return figures

    def _reason_counts(self) -> dict[str, int]:
        """Number of frames with each reason that occurs; a frame may have several."""
        counts = Counter(reason for reasons in self.reasons for reason in reasons)
        return {reason.value: counts[reason] for reason in Reason if reason in counts}

    def _accuracy(self, chosen: NDArray[np.bool_]) -> dict[str, object]:
        if self.truth is None:
            return {}
        poses, truth = self.poses[chosen], self.truth[chosen]
        figures: dict[str, object] = asdict(summarise(poses, truth))
        figures |= self._consistency(chosen, poses, truth)
        if self.odometry is not None:
            drift = summarise(self.odometry[chosen], truth)
            figures |= {"odometry_ate_rmse_m": drift.ate_rmse_m, "odometry_ate_median_m": drift.ate_median_m}
            if self.start is not None:
                # From where the filter started: what it would have done without a map.
                from_start = summarise((self.start @ invert(self.odometry[0]) @ self.odometry)[chosen], truth)
                figures["odometry_from_start_ate_rmse_m"] = from_start.ate_rmse_m
        return figures

    def _consistency(self, chosen: NDArray[np.bool_], poses: FloatArray, truth: FloatArray) -> dict[str, object]:
        errors = consistency(poses, truth, self.covariances[chosen])
        vouched_for = np.isin(np.array(self.states)[chosen], list(VOUCHED_FOR))
        return {
            "coverage_95": errors.coverage_95,
            "coverage_99": errors.coverage_99,
            "silent_frames_30cm": int(np.sum(vouched_for & errors.is_far)),
            "silent_frames_3_5_sigma": int(np.sum(vouched_for & errors.is_beyond_covariance)),
        }

    def _depth_accuracy(self, which: int) -> dict[str, object]:
        if self.depth is None or not len(self.depth[which]):
            return {}
        mean = self.depth[which].mean()
        return {"depth_absrel": mean.absrel, "depth_delta1": mean.delta1, "depth_ssim": mean.ssim}


def localize(
    bundle: Bundle,
    recording: Recording,
    start: Start | None,
    rng: np.random.Generator,
    progress: Progress,
    use_sensor_depth: bool = False,
    relight: Relight | None = None,
    viewer: Viewer = NoViewer(),
    components: ComponentsFactory = default_components,
    down: FloatArray | None = None,
    motions: Sequence[Motion | None] | None = None,
) -> Run:
    """Localise every frame of a recording, with the bundle's settings.

    Args:
        start, components: as for :class:`monoloc.localizer.Localizer`.
        rng: of all random numbers.
        use_sensor_depth: use the recording's depth in place of the network's, as an upper bound, with the likelihood
            and bias of a sensor in place of the bundle's.
        relight: changes the light of the images; None leaves them.
        viewer: is shown every frame; its time does not count.
        down: (N, 3) as :meth:`monoloc.localizer.Localizer.step` takes it, one a frame.
        motions: by another sensor, likewise; see :func:`monoloc.odometry.motion.motions_between`.

    Raises:
        DataError: sensor depth is asked for and there is none, there are no frames, or one cannot be read.
        ValueError: as :class:`monoloc.localizer.Localizer` and :func:`monoloc.io.recording.check_arrays`, or ``down``
            or ``motions`` are not one a frame.
        TypeError: the bundle or the recording is a path, or none.
    """
    require_bundle(bundle)
    require_recording(recording)
    if len(recording) == 0:
        raise DataError(recording.name, "gives no frames", "give a recording with at least one")
    check_arrays(recording)
    if down is not None and len(down) != len(recording):
        raise ValueError(f"down must have shape ({len(recording)}, 3), got {np.shape(down)}")
    if motions is not None and len(motions) != len(recording):
        raise ValueError(f"motions must be {len(recording)}, one a frame, got {len(motions)}")
    if use_sensor_depth:
        if not recording.has_depth:
            raise DataError(recording.name, "has no depth", "leave out --depth sensor")
        bundle = sensor_bundle(bundle)
    bundle = leave_out(bundle)
    localizer = Localizer(bundle, recording.camera, start, components=components, seed=rng)
    build_frames = set(bundle.provenance.frames.values())
    log = _Log(recording, None if start is None else start.pose)
    elapsed = np.diff(recording.timestamps_s, prepend=recording.timestamps_s[:1])
    viewer.begin(bundle, recording)
    with settled(), progress.task("localize", len(recording)) as show:
        for index in range(len(recording)):
            color = recording.color(index)
            unseen = fingerprint(color) not in build_frames
            sensor = recording.depth(index) if recording.has_depth else None
            measured = sparse_depth(sensor, recording.camera) if use_sensor_depth and sensor is not None else None
            color = color if relight is None else relight(color)
            began = time.perf_counter()
            gravity = None if down is None else down[index]
            motion = None if motions is None else motions[index]
            step = localizer.step(color, float(elapsed[index]), measured, gravity, motion)
            step_ms = (time.perf_counter() - began) * 1e3
            log.add(step, unseen, step_ms, sensor)
            viewer.show(LocalizedFrame(index, color, step, localizer.particles, log.dead_reckoning[-1], step_ms))
            show(index + 1)
    return log.run(bundle.settings)


class _Log:
    """Collects the results of a run's frames; depth and scans of all would not fit in memory."""

    def __init__(self, recording: Recording, start: FloatArray | None) -> None:
        self._recording, self._start = recording, start
        self._estimates: list[Estimate] = []
        self._states: list[State] = []
        self._reasons: list[frozenset[Reason]] = []
        self._levels: list[Level] = []
        self._changed: list[ChangedRegion] = []
        self._figures: list[tuple[float, bool, float, bool, bool, float]] = []
        self._depth = (DepthAccumulator(), DepthAccumulator()) if recording.has_depth else None
        self.dead_reckoning: list[FloatArray] = []
        self._has_odometry = False

    def add(self, step: Step, unseen: bool, step_ms: float, sensor_m: NDArray[np.float32] | None) -> None:
        """Add a frame, with its sensor depth (H, W) where there is one."""
        self.dead_reckoning.append(self._dead_reckoned(step))
        self._has_odometry |= tracks_translation(step.motion)
        self._estimates.append(step.estimate)
        self._states.append(step.state)
        self._reasons.append(step.reasons)
        self._levels.append(step.level)
        if step.changed_region is not None:
            self._changed.append(step.changed_region)
        has_landmarks = step.landmark_pose is not None
        contradicted = step.motion is not None and step.motion.is_contradicted
        self._figures.append(
            (step.mean_log_likelihood, has_landmarks, step.standing_share, contradicted, unseen, step_ms)
        )
        if self._depth is not None and sensor_m is not None and step.depth is not None:
            for accumulator in self._depth if unseen else self._depth[:1]:
                accumulator.add(*depth_pair(step.depth, sensor_m))

    def _dead_reckoned(self, step: Step) -> FloatArray:
        if self.dead_reckoning:
            previous = self.dead_reckoning[-1]
        elif self._recording.poses is not None:
            previous = self._recording.poses[0]
        else:
            previous = step.estimate.pose if self._start is None else self._start
        return previous if step.motion is None else previous @ step.motion.T_previous_current

    def run(self, config: LocalizerConfig) -> Run:
        columns = zip(*self._figures, strict=True)
        mean_log_likelihoods, landmark_used, standing, contradicted, unseen, step_ms = columns
        return Run(
            recording=self._recording,
            config=config,
            start=self._start,
            poses=np.stack([estimate.pose for estimate in self._estimates]),
            covariances=np.stack([estimate.covariance for estimate in self._estimates]),
            odometry=np.stack(self.dead_reckoning) if self._has_odometry else None,
            unseen=np.array(unseen, dtype=np.bool_),
            states=self._states,
            reasons=self._reasons,
            levels=self._levels,
            changed_regions=merged(self._changed),
            mean_log_likelihoods=np.array(mean_log_likelihoods),
            log_scales=np.array([estimate.log_scale for estimate in self._estimates]),
            step_ms=np.array(step_ms),
            landmark_used=np.array(landmark_used, dtype=np.bool_),
            standing_shares=np.array(standing),
            motion_contradicted=np.array(contradicted, dtype=np.bool_),
            depth=self._depth,
        )


def depth_pair(
    depth: DepthPrediction, sensor_m: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth used and sensor depth, at one size; the latter is 0 where either has none."""
    height, width = sensor_m.shape
    size = (_COMPARE_WIDTH, round(height * _COMPARE_WIDTH / width))
    predicted = depth.resized(*size)
    truth = np.asarray(cv2.resize(sensor_m, size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
    return predicted, np.where(predicted > 0.0, truth, np.float32(0.0))
