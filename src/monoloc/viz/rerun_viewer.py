"""What Rerun's viewer shows: a run as it goes, and a map before and after adaptation."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.geometry import FloatArray, rotation_to_quaternion, transform
from monoloc.io.recording import Recording
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer import Step
from monoloc.particle_filter.particles import Particles
from monoloc.supervision.state import State

# Okabe and Ito's colours (2008) that can be seen on Rerun's dark ground, RGBA.
_TRUTH, _ESTIMATE, _ODOMETRY, _SCAN = 0xE6E6E6FF, 0x56B4E9FF, 0xE69F00FF, 0x00C78FFF
_LANDMARKS, _SEEN = 0xCC79A760, 0xCC79A7FF
_ORIGINAL, _ADAPTED = 0x56B4E9FF, 0xE69F00FF
_MAP, _COVARIANCE = 0xA0A0A01C, 0x56B4E9A0
_STATES: dict[State, int] = {"tracking": 0x009E73FF, "uncertain": 0xF0E442FF, "lost": 0xD55E00FF}
_PLOTS = {
    "error_cm/estimate": _ESTIMATE,
    "error_cm/odometry": _ODOMETRY,
    "error_cm/stated_sd": 0x56B4E980,
    "likelihood/scan": _ESTIMATE,
    "likelihood/low": 0xF0E442FF,
    "likelihood/lost": 0xD55E00FF,
    "step_ms": _ESTIMATE,
}
_TIMELINES = ("frame", "seconds")

_SURFACE_SIGMAS = np.sqrt(3.0)  # how far a surface reaches from its component's mean, if it is covered evenly
_SIGMAS_95 = 2.795  # ellipsoid of 95 % in three dimensions: the root of chi-squared's quantile
_IMAGE_DISTANCE_M = 0.5
_DEPTH_SHOWN_M = (0.0, 6.0)
_JPEG_QUALITY = 85


class RerunViewer:
    """Draws one run into a stream; see :class:`monoloc.viz.viewer.Viewer`."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._recording: Recording | None = None
        self._thresholds: LikelihoodThresholds | None = None
        self._ends: dict[str, FloatArray] = {}  # where each way has come to, (3,)

    def begin(self, room: Bundle, recording: Recording) -> None:
        self._recording, self._thresholds = recording, room.thresholds
        self._static("world", _upright(room.provenance.down_world))
        map_ = room.adapted
        self._static("world/map", _ellipsoids(map_.means, map_.covariances, _SURFACE_SIGMAS, _MAP, "solid"))
        landmarks = rr.Points3D(room.landmarks.points, colors=_LANDMARKS, radii=rr.Radius.ui_points(1.0))
        self._static("world/landmarks", landmarks)
        if recording.poses is not None:
            truth = rr.LineStrips3D([recording.poses[:, :3, 3]], colors=_TRUTH, radii=rr.Radius.ui_points(1.0))
            self._static("world/truth", truth)
        self._static("world/camera/image", _pinhole(recording.camera))
        for path, color in _PLOTS.items():
            self._static(path, rr.SeriesLines(colors=color, names=path.rpartition("/")[2]))
        colors = np.array(list(_STATES.values()), dtype=np.uint32)
        self._static("state", rr.StateConfiguration(values=list(_STATES), colors=colors))

    def show(
        self,
        index: int,
        color: NDArray[np.uint8],
        step: Step,
        particles: Particles,
        odometry: FloatArray,
        step_ms: float,
    ) -> None:
        assert self._recording is not None
        times_s = self._recording.timestamps_s
        self._stream.set_time("frame", sequence=index)
        self._stream.set_time("seconds", duration=float(times_s[index] - times_s[0]))
        truth = None if self._recording.poses is None else self._recording.poses[index]
        self._show_images(color, step)
        self._show_belief(step, particles)
        self._show_way("estimate", step.estimate.pose, truth, _ESTIMATE)
        # Without a motion the odometry stands still, and a random walk has none at all.
        if step.motion is not None:
            self._show_way("odometry", odometry, truth, _ODOMETRY)
        self._ends["odometry"] = odometry[:3, 3]
        self._plot("error_cm/stated_sd", 100.0 * np.sqrt(np.trace(step.estimate.covariance[:3, :3])))
        self._show_likelihood(step.mean_log_likelihood)
        self._plot("step_ms", step_ms)
        self._stream.log("state", rr.StateChange(state=step.state))

    def _show_images(self, color: NDArray[np.uint8], step: Step) -> None:
        self._stream.log("world/camera/image", rr.Image(color).compress(jpeg_quality=_JPEG_QUALITY))
        # Outside of the camera's frame, where the viewer would lift it into the room, unscaled.
        depth = rr.DepthImage(step.depth.depth_m, meter=1.0, colormap="viridis", depth_range=_DEPTH_SHOWN_M)
        self._stream.log("depth", depth)

    def _show_belief(self, step: Step, particles: Particles) -> None:
        pose, covariance = step.estimate.pose, step.estimate.covariance[:3, :3]
        self._stream.log("world/camera", rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        spread = _ellipsoids(np.zeros((1, 3)), covariance[None], _SIGMAS_95, _COVARIANCE, "majorwireframe")
        self._stream.log("world/camera/covariance", spread)
        shares = particles.weights / particles.weights.max()
        cloud = rr.Points3D(particles.poses[:, :3, 3], colors=_viridis(shares), radii=rr.Radius.ui_points(1.5))
        self._stream.log("world/particles", cloud)
        scan = transform(pose, np.exp(step.estimate.log_scale) * step.scan.points)
        self._stream.log("world/scan", rr.Points3D(scan, colors=_SCAN, radii=rr.Radius.ui_points(2.0)))
        seen = np.zeros((0, 3)) if step.landmark_pose is None else step.landmark_pose.points
        self._stream.log("world/seen", rr.Points3D(seen, colors=_SEEN, radii=rr.Radius.ui_points(3.0)))

    def _show_way(self, name: str, pose: FloatArray, truth: FloatArray | None, color: int) -> None:
        """The last piece of a way, of which the layout shows all up to the cursor, and its error."""
        position = pose[:3, 3]
        piece = np.stack([self._ends.get(name, position), position])
        strip = rr.LineStrips3D([piece], colors=color, radii=rr.Radius.ui_points(1.5))
        self._stream.log(f"world/{name}", strip)
        self._ends[name] = position
        if truth is not None:
            self._plot(f"error_cm/{name}", 100.0 * float(np.linalg.norm(position - truth[:3, 3])))

    def _show_likelihood(self, mean_log_likelihood: float) -> None:
        assert self._thresholds is not None
        self._plot("likelihood/scan", mean_log_likelihood)
        self._plot("likelihood/low", self._thresholds.low)
        self._plot("likelihood/lost", self._thresholds.lost)

    def _plot(self, path: str, value: float) -> None:
        if np.isfinite(value):
            self._stream.log(path, rr.Scalars(value))

    def _static(self, path: str, entity: rr.AsComponents) -> None:
        self._stream.log(path, entity, static=True)


def run_blueprint() -> rrb.Blueprint:
    """The room at the left; images, errors, likelihood, state and time a step at the right."""
    up_to_now = rrb.VisibleTimeRanges(
        [rrb.VisibleTimeRange(name, start=rrb.TimeRangeBoundary.infinite(), end=_NOW) for name in _TIMELINES]
    )
    room = rrb.Spatial3DView(
        origin="world",
        name="room",
        overrides={f"world/{way}": up_to_now for way in ("estimate", "odometry")},
    )
    images = rrb.Horizontal(
        rrb.Spatial2DView(origin="world/camera/image", name="image"),
        rrb.Spatial2DView(origin="depth", name="depth, to 6 m"),
    )
    plots = [
        rrb.TimeSeriesView(origin="error_cm", name="position error (cm)"),
        rrb.TimeSeriesView(origin="likelihood", name="mean log-likelihood (nats)"),
        rrb.TimeSeriesView(origin="step_ms", name="time a step (ms)"),
    ]
    right = rrb.Vertical(
        images, plots[0], plots[1], rrb.StateTimelineView(origin="state", name="state"), plots[2],
        row_shares=[3.0, 3.0, 2.0, 1.3, 1.7],
    )  # fmt: skip
    return rrb.Blueprint(
        rrb.Horizontal(room, right, column_shares=[3.0, 2.0]),
        rrb.TimePanel(timeline="seconds", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def draw_map_change(
    stream: rr.RecordingStream, original: FloatArray, adapted: FloatArray, distances_m: FloatArray, down: ArrayLike
) -> None:
    """Both clouds with their boxes, the original coloured by distance, and the distances' histogram.

    After Shukla et al. 2023, figure 3, as :func:`monoloc.viz.map_drawing.plot_map_change` but to turn about.

    Args:
        original, adapted: (N, 3) and (M, 3), world frame, metres.
        distances_m: (N,) distance of every point of the original to the adapted cloud.
        down: (3,) roughly where down is in the world.
    """
    stream.log("world", _upright(down), static=True)
    for name, cloud, color in (("original", original, _ORIGINAL), ("adapted", adapted, _ADAPTED)):
        stream.log(f"world/{name}", rr.Points3D(cloud, colors=color, radii=rr.Radius.ui_points(1.0)), static=True)
        low, high = cloud.min(axis=0), cloud.max(axis=0)
        box = rr.Boxes3D(mins=[low], sizes=[high - low], colors=color, fill_mode="majorwireframe")
        stream.log(f"world/boxes/{name}", box, static=True)
        # At opposite corners, for the boxes' centres are nearly one point.
        corner, text = (low if name == "original" else high), " × ".join(f"{side:.2f}" for side in high - low)
        label = rr.Points3D([corner], labels=f"{name}: {text} m", colors=color, show_labels=True)
        stream.log(f"world/boxes/{name}/size", label, static=True)
    limit_cm = max(0.1, 100.0 * float(np.percentile(distances_m, 99.0)))
    coloured = rr.Points3D(original, colors=_viridis(100.0 * distances_m / limit_cm), radii=rr.Radius.ui_points(1.5))
    stream.log("world/distance", coloured, static=True)
    counts, edges = np.histogram(100.0 * distances_m, bins=50, range=(0.0, limit_cm))
    bars = rr.BarChart(
        100.0 * counts / len(distances_m),
        abscissa=0.5 * (edges[:-1] + edges[1:]),
        widths=np.diff(edges),
        color=_ORIGINAL,
    )
    stream.log("distances", bars, static=True)


def map_blueprint() -> rrb.Blueprint:
    """Clouds and boxes at the left; distances in the room and as bars at the right."""
    clouds = ["world/original", "world/adapted", "world/boxes/**"]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="world", contents=clouds, name="original (blue) and adapted (orange)"),
            rrb.Vertical(
                rrb.Spatial3DView(origin="world", contents=["world/distance"], name="distance to the adapted cloud"),
                rrb.BarChartView(origin="distances", name="share of points (%) by distance (cm)"),
                row_shares=[2.0, 1.0],
            ),
        ),
        rrb.TimePanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


_NOW = rrb.TimeRangeBoundary.cursor_relative(seq=0)


def _upright(down: ArrayLike) -> rr.AsComponents:
    """The world's axes as Rerun has them: right-handed, and which one is up."""
    down = np.asarray(down, dtype=np.float64)
    axis = int(np.argmax(np.abs(down)))
    name = f"RIGHT_HAND_{'XYZ'[axis]}_{'DOWN' if down[axis] > 0.0 else 'UP'}"
    axes: rr.AsComponents = getattr(rr.ViewCoordinates, name)
    return axes


def _pinhole(camera: Camera) -> rr.Pinhole:
    """Rerun's pixel centres are at halves, and it has no distortion."""
    return rr.Pinhole(
        focal_length=(camera.fx, camera.fy),
        principal_point=(camera.cx + 0.5, camera.cy + 0.5),
        resolution=(camera.width, camera.height),
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=_IMAGE_DISTANCE_M,
        color=_ESTIMATE,
    )


def _ellipsoids(
    means: FloatArray, covariances: FloatArray, sigmas: float, color: int, fill: Literal["solid", "majorwireframe"]
) -> rr.Ellipsoids3D:
    """So many standard deviations of Gaussians, (K, 3) and (K, 3, 3)."""
    variances, axes = np.linalg.eigh(covariances)
    axes[..., 0] *= np.linalg.det(axes)[..., None]  # eigenvectors may be a mirrored frame, which no rotation gives
    return rr.Ellipsoids3D(
        centers=means,
        half_sizes=sigmas * np.sqrt(np.maximum(variances, 0.0)),
        quaternions=rotation_to_quaternion(axes),
        colors=color,
        fill_mode=fill,
    )


def _viridis(shares: FloatArray) -> NDArray[np.uint8]:
    """RGB (N, 3) of values from 0 to 1, (N,)."""
    levels = np.round(255.0 * np.clip(shares, 0.0, 1.0)).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1], dtype=np.uint8)
