"""A recording localised in a bundle's map, and what the run is worth."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle, fingerprint
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.errors import DataError
from monoloc.evaluation.depth_metrics import DepthAccumulator
from monoloc.evaluation.trajectory import coverage_95, summarise
from monoloc.fusion.bias_model import LastingErrors
from monoloc.fusion.reference_poses import Viewpoints
from monoloc.geometry import FloatArray, invert, se3_exp
from monoloc.io.recording import Recording, Relight
from monoloc.likelihood.scan_likelihood import MeasurementConfig
from monoloc.localizer import Localizer, LocalizerConfig, Parts
from monoloc.particle_filter.particles import Particles, scatter
from monoloc.progress import Progress
from monoloc.supervision.state import HealthyRange, State
from monoloc.viz.viewer import NoViewer, Viewer

START_M, START_DEG = 0.10, 3.0
"""How far off a run begins that is to be judged; the direction is drawn from its seed."""

# A depth sensor's errors are centimetres and independent, whatever the bundle's network does.
_SENSOR = {
    "log_scale_sd": 0.01,
    "level": None,
    "lasting": LastingErrors(near_sd_m=0.015, near_sd_rad=0.01),
    "measurement": MeasurementConfig(
        likelihood="volume", outlier_share=0.2, noise_sd_m=0.02, effective_points=60.0, effective_corners=0.0
    ),
}
_SENSOR_STRIDE = 4  # every so many pixels of sensor depth are used: as dense as the scan needs
_COMPARE_WIDTH = 160  # width at which predicted and sensor depth are compared


@dataclass(frozen=True)
class Start:
    """Where a run begins.

    Attributes:
        pose: ``T_world_camera`` of the first frame, (4, 4), as far as it is known.
        off_m, off_rad: how far it may be off: distance and angle, root mean square.
    """

    pose: FloatArray
    off_m: float = START_M
    off_rad: float = np.deg2rad(START_DEG)

    @classmethod
    def beside(
        cls,
        pose: FloatArray,
        rng: np.random.Generator,
        off_m: float = START_M,
        off_rad: float = np.deg2rad(START_DEG),
    ) -> Start:
        """One that is so far off a true pose, in directions that are drawn."""
        twist = rng.standard_normal(6)
        twist[:3] *= off_m / np.linalg.norm(twist[:3])
        twist[3:] *= off_rad / np.linalg.norm(twist[3:])
        return cls(np.asarray(pose @ se3_exp(twist)), off_m, off_rad)

    def particles(self, config: LocalizerConfig, rng: np.random.Generator) -> Particles:
        """The belief of one who knows no more."""
        sd_m, sd_rad = self.off_m / np.sqrt(3.0), self.off_rad / np.sqrt(3.0)  # an axis
        return scatter(self.pose, config.particles, sd_m, sd_rad, config.log_scale_sd, rng)


@dataclass(frozen=True)
class Run:
    """Every frame's result; N frames.

    Attributes:
        start: ``T_world_camera`` where it was said to begin, (4, 4); None where nothing was said.
        poses, covariances: (N, 4, 4) ``T_world_camera`` and (N, 6, 6), see :class:`Estimate`.
        odometry: (N, 4, 4) dead reckoning from the first true pose (else from the start, or the first estimate), None
            for the random walk.
        unseen: (N,) frames that did not build the bundle.
        states, fits, log_scales, step_ms: per frame.
        sighted: (N,) frames in which landmarks told where the camera is.
        truth: (N, 4, 4) or None.
        depth: per-frame accuracy of the depth used, over all and over unseen frames; None without sensor depth.
    """

    recording: Recording
    config: LocalizerConfig
    start: FloatArray | None
    poses: FloatArray
    covariances: FloatArray
    odometry: FloatArray | None
    unseen: NDArray[np.bool_]
    states: list[State]
    fits: FloatArray
    log_scales: FloatArray
    step_ms: FloatArray
    sighted: NDArray[np.bool_]
    depth: tuple[DepthAccumulator, DepthAccumulator] | None

    @property
    def truth(self) -> FloatArray | None:
        return self.recording.poses

    def metrics(self) -> dict[str, object]:
        """The run's figures, ready for JSON, as docs/research.md lists them; with ``unseen_`` on unseen frames."""
        everything = np.ones(len(self.poses), dtype=np.bool_)
        figures: dict[str, object] = {
            "frames": len(self.poses),
            **self._accuracy(everything),
            "lost_frames": self.states.count("lost"),
            "states": dict(Counter(self.states)),
            "sighted_frames": int(self.sighted.sum()),
            "step_ms_median": float(np.median(self.step_ms)),
            "step_ms_p95": float(np.percentile(self.step_ms, 95.0)),
            "particles": self.config.particles,
            "scan_points": self.config.scan_points,
            "motion": self.config.motion,
            **self._depth_accuracy(0),
            "unseen_frames": int(self.unseen.sum()),
        }
        if self.unseen.any():
            unseen = {**self._accuracy(self.unseen), **self._depth_accuracy(1)}
            figures |= {f"unseen_{name}": value for name, value in unseen.items()}
        return figures

    def _accuracy(self, chosen: NDArray[np.bool_]) -> dict[str, object]:
        if self.truth is None:
            return {}
        poses, truth = self.poses[chosen], self.truth[chosen]
        figures: dict[str, object] = asdict(summarise(poses, truth))
        figures["coverage_95"] = coverage_95(poses, truth, self.covariances[chosen])
        if self.odometry is not None:
            drift = summarise(self.odometry[chosen], truth)
            figures |= {"odometry_ate_rmse_m": drift.ate_rmse_m, "odometry_ate_median_m": drift.ate_median_m}
            if self.start is not None:
                # From where the filter began, which is what it would have done without a map.
                alone = summarise((self.start @ invert(self.odometry[0]) @ self.odometry)[chosen], truth)
                figures["odometry_from_start_ate_rmse_m"] = alone.ate_rmse_m
        return figures

    def _depth_accuracy(self, which: int) -> dict[str, object]:
        if self.depth is None or not len(self.depth[which]):
            return {}
        mean = self.depth[which].mean()
        return {"depth_absrel": mean.absrel, "depth_delta1": mean.delta1, "depth_ssim": mean.ssim}


# From a bundle, a camera and settings to what a localizer is put together of.
MakesParts = Callable[[Bundle, Camera, LocalizerConfig], Parts]


def parts_of(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Parts:
    """A bundle's network, map and landmarks, and monoloc's odometry, for one run of a camera.

    Raises:
        DataError: the bundle's network does not take the camera's images.
    """
    depth = DepthPredictor(bundle.depth_model, camera)
    return Parts.usual(bundle.adapted, depth, camera, config, bundle.landmarks)


def start_localizer(
    bundle: Bundle,
    camera: Camera,
    start: Start | None,
    rng: np.random.Generator,
    config: LocalizerConfig | None = None,
    parts: MakesParts = parts_of,
) -> Localizer:
    """A localizer for one camera in a bundle's room.

    Args:
        camera: of the frames that it will be given.
        start: None where nothing is known of it; the room is searched then, and the state is *lost* until the camera
            is found.
        config: settings in place of the bundle's.
        parts: makes what it is put together of, for this run.

    Raises:
        DataError: the bundle's network does not take the camera's images.
        ValueError: no start, and ``config.can_find`` is not true.
    """
    config = config or bundle.settings
    made = parts(bundle, camera, config)
    particles = None if start is None else start.particles(config, rng)
    return Localizer(made, camera, particles, config, bundle.healthy, bundle.viewpoints, rng, bundle.down)


def localize(
    bundle: Bundle,
    recording: Recording,
    start: Start | None,
    config: LocalizerConfig,
    rng: np.random.Generator,
    progress: Progress,
    use_sensor_depth: bool = False,
    relight: Relight | None = None,
    viewer: Viewer = NoViewer(),
    parts: MakesParts = parts_of,
    down: FloatArray | None = None,
) -> Run:
    """Localise every frame of a recording.

    Args:
        start: as for :func:`start_localizer`.
        use_sensor_depth: use the recording's depth in place of the network's: the upper bound. The measurement's
            settings are then a sensor's, not the bundle's.
        relight: brings the images to another light; None leaves them.
        viewer: sees every frame; its time counts for no step.
        parts: makes what the localizer is put together of.
        down: (N, 3) as :meth:`Localizer.step` takes it, frame by frame.

    Raises:
        DataError: sensor depth is asked for and there is none, or a frame cannot be read.
    """
    if use_sensor_depth and not recording.has_depth:
        raise DataError(recording.name, "has no depth", "leave out --depth sensor")
    if use_sensor_depth:
        config = config.model_copy(update=_SENSOR)
        # What fits of a sensor's depth are healthy was not measured: the belief's spread alone tells its state. And
        # what poses err by at the viewpoints was measured with the network.
        anything, viewpoints = HealthyRange(low=-np.inf, lost=-np.inf), Viewpoints.of(bundle.viewpoints.poses)
        bundle = replace(bundle, healthy=anything, viewpoints=viewpoints)
    localizer = start_localizer(bundle, recording.camera, start, rng, config, parts)
    built_from = set(bundle.provenance.frames.values())
    unseen = np.zeros(len(recording), dtype=np.bool_)
    accuracy = (DepthAccumulator(), DepthAccumulator()) if recording.has_depth else None
    said = None if start is None else start.pose
    dead_reckoning = said if recording.poses is None else recording.poses[0]
    estimates, states, fits, odometry, step_ms, sighted = [], [], [], [], [], []
    elapsed = np.diff(recording.timestamps_s, prepend=recording.timestamps_s[:1])
    viewer.begin(bundle, recording)
    with progress.task("localize", len(recording)) as show:
        for index in range(len(recording)):
            color = recording.color(index)
            unseen[index] = fingerprint(color) not in built_from
            sensor = recording.depth(index) if recording.has_depth else None
            measured = _sparse(sensor, recording.camera) if use_sensor_depth and sensor is not None else None
            if relight is not None:
                color = relight(color)
            began = time.perf_counter()
            step = localizer.step(color, float(elapsed[index]), measured, None if down is None else down[index])
            step_ms.append((time.perf_counter() - began) * 1e3)
            estimates.append(step.estimate)
            states.append(step.state)
            fits.append(step.fit)
            sighted.append(step.sighting is not None)
            if dead_reckoning is None:
                dead_reckoning = step.estimate.pose
            elif step.motion is not None:
                dead_reckoning = dead_reckoning @ step.motion.T_previous_current
            odometry.append(dead_reckoning)
            viewer.show(index, color, step, localizer.particles, dead_reckoning, step_ms[-1])
            if accuracy is not None and sensor is not None:
                for accumulator in accuracy if unseen[index] else accuracy[:1]:
                    accumulator.add(*comparable(step.depth, sensor))
            show(index + 1)
    return Run(
        recording=recording,
        config=config,
        start=said,
        poses=np.stack([estimate.pose for estimate in estimates]),
        covariances=np.stack([estimate.covariance for estimate in estimates]),
        odometry=np.stack(odometry) if config.motion == "visual" else None,
        unseen=unseen,
        states=states,
        fits=np.array(fits),
        log_scales=np.array([estimate.log_scale for estimate in estimates]),
        step_ms=np.array(step_ms),
        sighted=np.array(sighted),
        depth=accuracy,
    )


def _sparse(depth_m: NDArray[np.float32], camera: Camera) -> DepthPrediction:
    """Every fourth pixel of a sensor's image, as measured: averaging would mix surfaces."""
    offset = _SENSOR_STRIDE // 2
    sparse = np.ascontiguousarray(depth_m[offset::_SENSOR_STRIDE, offset::_SENSOR_STRIDE])
    height, width = sparse.shape
    # The exact camera of the sampled pixels: their centres are at offset + stride * (column, row).
    sampled = Camera(
        width,
        height,
        camera.fx / _SENSOR_STRIDE,
        camera.fy / _SENSOR_STRIDE,
        (camera.cx - offset) / _SENSOR_STRIDE,
        (camera.cy - offset) / _SENSOR_STRIDE,
        camera.distortion,
    )
    return DepthPrediction(sparse, sampled)


def comparable(
    depth: DepthPrediction, sensor_m: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth used and depth measured, both at one small size; measured is 0 where there is none to compare."""
    height, width = sensor_m.shape
    size = (_COMPARE_WIDTH, round(height * _COMPARE_WIDTH / width))
    predicted = depth.resized(*size)
    truth = np.asarray(cv2.resize(sensor_m, size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
    return predicted, np.where(predicted > 0.0, truth, np.float32(0.0))
