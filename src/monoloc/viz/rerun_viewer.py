"""Content of Rerun's viewer: a live run, and a map before and after adaptation."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.editing.edit_history import DrawnEdit, drawn_edits
from monoloc.evaluation.cloud_metrics import MapClouds
from monoloc.geometry import FloatArray, invert, rotation_to_quaternion, transform
from monoloc.io.recording import Recording
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.odometry.motion import tracks_translation
from monoloc.particle_filter.particles import Particles
from monoloc.step import LocalizedFrame, Step
from monoloc.step_budget import Level
from monoloc.supervision.state import State, in_words
from monoloc.viz.pinhole_view import PinholeView
from monoloc.viz.rerun_edits import Logged, clear_edits, log_edits

# Colours of Okabe and Ito (2008) that are visible on Rerun's dark background, RGBA.
_TRUTH, _ESTIMATE, _ODOMETRY, _SCAN = 0xE6E6E6FF, 0x56B4E9FF, 0xE69F00FF, 0x00C78FFF
_LANDMARKS, _SEEN = 0xCC79A760, 0xCC79A7FF
_ORIGINAL, _ADAPTED = 0x56B4E9FF, 0xE69F00FF
_MAP, _COVARIANCE = 0xA0A0A01C, 0x56B4E9A0
_STATES: dict[State, int] = {
    "tracking": 0x009E73FF,
    "uncertain": 0xF0E442FF,
    "lost": 0xD55E00FF,
    "map-changed": 0xCC79A7FF,
}
_PLOTS = {
    "error_cm/estimate": _ESTIMATE,
    "error_cm/odometry": _ODOMETRY,
    "error_cm/stated_sd": 0x56B4E980,
    "probability_far": _ESTIMATE,
    "likelihood/scan": _ESTIMATE,
    "likelihood/low": 0xF0E442FF,
    "likelihood/lost": 0xD55E00FF,
    "step_ms": _ESTIMATE,
}
_TIMELINES = ("frame", "seconds")

_SURFACE_SIGMAS = np.sqrt(3.0)  # extent of an evenly covered surface about its component's mean
_SIGMAS_95 = 2.795  # radius of the 95 % ellipsoid in three dimensions: root of the chi-squared quantile
_IMAGE_DISTANCE_M = 0.5
_DEPTH_SHOWN_M = (0.0, 6.0)
_JPEG_QUALITY = 85


class RerunViewer:
    """Logs one run to a stream; see :class:`monoloc.viz.viewer.Viewer`.

    Args:
        stream: to the viewer.
        as_jpeg: whether images are compressed.
    """

    def __init__(self, stream: rr.RecordingStream, as_jpeg: bool = True) -> None:
        self._stream, self._as_jpeg = stream, as_jpeg
        self._recording: Recording | None = None
        self._thresholds: LikelihoodThresholds | None = None
        self._view: PinholeView
        self._ends: dict[str, FloatArray] = {}  # last position of each trajectory, (3,)
        self._edits: Logged = []

    def begin(self, room: Bundle, recording: Recording) -> None:
        self._recording = recording
        self.begin_room(room, recording.camera)
        if recording.poses is not None:
            truth = rr.LineStrips3D([recording.poses[:, :3, 3]], colors=_TRUTH, radii=rr.Radius.ui_points(1.0))
            self._static("world/truth", truth)

    def begin_room(self, room: Bundle, camera: Camera) -> None:
        """Log what does not change, in place of another room's; trajectories begin anew."""
        self._ends.clear()
        self._thresholds = room.thresholds
        self._static("world", _view_coordinates(room.provenance.down_world))
        map_ = room.adapted
        self._static("world/map", _ellipsoids(map_.means, map_.covariances, _SURFACE_SIGMAS, _MAP, "solid"))
        landmarks = rr.Points3D(room.landmarks.points, colors=_LANDMARKS, radii=rr.Radius.ui_points(1.0))
        self._static("world/landmarks", landmarks)
        clear_edits(self._stream, self._edits)
        edits = drawn_edits(room, np.random.default_rng(0))
        self._edits = log_edits(self._stream, edits, room.provenance.down_world)
        self._view = PinholeView(camera)
        self._static("world/camera/image", _pinhole(self._view.camera))
        for path, color in _PLOTS.items():
            self._static(path, rr.SeriesLines(colors=color, names=path.rpartition("/")[2]))
        colors = np.array(list(_STATES.values()), dtype=np.uint32)
        self._static("state", rr.StateConfiguration(values=list(_STATES), colors=colors))

    def show(self, frame: LocalizedFrame) -> None:
        assert self._recording is not None
        times_s = self._recording.timestamps_s
        self._stream.set_time("frame", sequence=frame.index)
        self._stream.set_time("seconds", duration=float(times_s[frame.index] - times_s[0]))
        truth = None if self._recording.poses is None else self._recording.poses[frame.index]
        self.show_step(frame.color, frame.step, frame.particles, truth)
        # Odometry does not change without a motion, and a random walk never has one.
        if tracks_translation(frame.step.motion):
            self._show_trajectory("odometry", frame.odometry, truth, _ODOMETRY)
        self._ends["odometry"] = frame.odometry[:3, 3]
        self._plot("step_ms", frame.step_ms)

    def show_step(
        self,
        color: NDArray[np.uint8],
        step: Step,
        particles: Particles,
        truth: FloatArray | None,
        room: str | None = None,
    ) -> None:
        """Log a frame at the stream's time: images, belief, likelihood, state, and the room of a place."""
        self._show_images(color, step)
        self._show_belief(step, particles)
        self._show_trajectory("estimate", step.estimate.pose, truth, _ESTIMATE)
        self._plot("error_cm/stated_sd", 100.0 * np.sqrt(np.trace(step.estimate.covariance[:3, :3])))
        self._show_likelihood(step.mean_log_likelihood)
        self._show_state(step, room)

    def _show_images(self, color: NDArray[np.uint8], step: Step) -> None:
        image = rr.Image(self._view(color))
        shown = image.compress(jpeg_quality=_JPEG_QUALITY) if self._as_jpeg else image
        self._stream.log("world/camera/image", shown)
        # Not below the camera's entity, where the viewer would back-project the uncorrected depth into the room.
        if step.depth is not None:
            depth = rr.DepthImage(step.depth.depth_m, meter=1.0, colormap="viridis", depth_range=_DEPTH_SHOWN_M)
            self._stream.log("depth", depth)
        self._stream.log("world/camera/image/landmarks", self._landmarks_in_image(step))

    def _landmarks_in_image(self, step: Step) -> rr.Points2D:
        seen = np.zeros((0, 3)) if step.landmark_pose is None else step.landmark_pose.points
        points = transform(invert(step.estimate.pose), seen)
        pixels = self._view.camera.project(points[points[:, 2] > 0.0]) + 0.5  # Rerun's pixel centres
        return rr.Points2D(pixels, colors=_SEEN, radii=rr.Radius.ui_points(3.0))

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

    def _show_trajectory(self, name: str, pose: FloatArray, truth: FloatArray | None, color: int) -> None:
        """Log the last segment of a trajectory and its error; the layout shows all segments up to the cursor."""
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

    def _show_state(self, step: Step, room: str | None) -> None:
        self._plot("probability_far", step.probability_far)
        self._stream.log("state", rr.StateChange(state=step.state))
        reasons = in_words(step.reasons)
        said = step.state if room is None else f"{step.state} in {room}"
        said += f": {reasons}" if reasons else ""
        if step.level is not Level.FULL:
            said += f"\n\nto keep the budget: {step.level.words}"
        self._stream.log("reasons", rr.TextDocument(said))

    def _plot(self, path: str, value: float) -> None:
        if np.isfinite(value):
            self._stream.log(path, rr.Scalars(value))

    def _static(self, path: str, entity: rr.AsComponents) -> None:
        self._stream.log(path, entity, static=True)


def state_views() -> rrb.Horizontal:
    """Timeline of the state, and its reasons in words."""
    return rrb.Horizontal(
        rrb.StateTimelineView(origin="state", name="state"),
        rrb.TextDocumentView(origin="reasons", name="state and its reasons"),
        column_shares=[2.0, 1.0],
    )


def run_blueprint() -> rrb.Blueprint:
    """Layout with the room on the left; on the right images, errors, likelihood, state with reasons, step time."""
    up_to_now = rrb.VisibleTimeRanges(
        [rrb.VisibleTimeRange(name, start=rrb.TimeRangeBoundary.infinite(), end=_NOW) for name in _TIMELINES]
    )
    room = rrb.Spatial3DView(
        origin="world",
        name="room",
        overrides={f"world/{name}": up_to_now for name in ("estimate", "odometry")},
    )
    images = rrb.Horizontal(
        rrb.Spatial2DView(origin="world/camera/image", name="image"),
        rrb.Spatial2DView(origin="depth", name="depth, to 6 m"),
    )
    far = rrb.ScalarAxis(range=(0.0, 1.0), zoom_lock=True)
    right = rrb.Vertical(
        images,
        rrb.TimeSeriesView(origin="error_cm", name="position error (cm)"),
        rrb.TimeSeriesView(origin="likelihood", name="mean log-likelihood (nats)"),
        state_views(),
        rrb.TimeSeriesView(origin="probability_far", name="probability of more than 30 cm off", axis_y=far),
        rrb.TimeSeriesView(origin="step_ms", name="time a step (ms)"),
        row_shares=[3.0, 2.6, 1.7, 1.3, 1.7, 1.5],
    )
    return rrb.Blueprint(
        rrb.Horizontal(room, right, column_shares=[3.0, 2.0]),
        rrb.TimePanel(timeline="seconds", state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def draw_map_change(
    stream: rr.RecordingStream, clouds: MapClouds, down: ArrayLike, edits: tuple[DrawnEdit, ...]
) -> None:
    """Log both clouds with boxes and edits, the original cloud coloured by distance, and a histogram of distances.

    This is the interactive form of :func:`monoloc.viz.map_drawing.plot_map_change` (Shukla et al. 2023, figure 3).

    Args:
        stream: stream to the viewer.
        clouds: of the map before and after adaptation.
        down: (3,) approximate down direction in the world.
        edits: of the map.
    """
    original, adapted, distances_m = clouds.original, clouds.adapted, clouds.distances_m
    log_edits(stream, edits, down)
    stream.log("world", _view_coordinates(down), static=True)
    for name, cloud, color in (("original", original, _ORIGINAL), ("adapted", adapted, _ADAPTED)):
        stream.log(f"world/{name}", rr.Points3D(cloud, colors=color, radii=rr.Radius.ui_points(1.0)), static=True)
        low, high = cloud.min(axis=0), cloud.max(axis=0)
        box = rr.Boxes3D(mins=[low], sizes=[high - low], colors=color, fill_mode="majorwireframe")
        stream.log(f"world/boxes/{name}", box, static=True)
        # At opposite corners, because the centres of the boxes nearly coincide.
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
    """Layout with clouds and boxes on the left, and distances in the room and as a histogram on the right."""
    clouds = ["world/original", "world/adapted", "world/boxes/**", "world/edits/**"]
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


def _view_coordinates(down: ArrayLike) -> rr.AsComponents:
    """Rerun's view coordinates of the world: right-handed, with the axis that points up or down."""
    down = np.asarray(down, dtype=np.float64)
    axis = int(np.argmax(np.abs(down)))
    name = f"RIGHT_HAND_{'XYZ'[axis]}_{'DOWN' if down[axis] > 0.0 else 'UP'}"
    axes: rr.AsComponents = getattr(rr.ViewCoordinates, name)
    return axes


def _pinhole(camera: Camera) -> rr.Pinhole:
    """Convert a pinhole to Rerun's, which has pixel centres at half integers."""
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
    """Ellipsoids of Gaussians with means (K, 3) and covariances (K, 3, 3) at ``sigmas`` standard deviations."""
    variances, axes = np.linalg.eigh(covariances)
    axes[..., 0] *= np.linalg.det(axes)[..., None]  # makes a left-handed frame of eigenvectors a rotation
    return rr.Ellipsoids3D(
        centers=means,
        half_sizes=sigmas * np.sqrt(np.maximum(variances, 0.0)),
        quaternions=rotation_to_quaternion(axes),
        colors=color,
        fill_mode=fill,
    )


def _viridis(shares: FloatArray) -> NDArray[np.uint8]:
    """RGB (N, 3) uint8 of values (N,) from 0 to 1."""
    levels = np.round(255.0 * np.clip(shares, 0.0, 1.0)).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1], dtype=np.uint8)
