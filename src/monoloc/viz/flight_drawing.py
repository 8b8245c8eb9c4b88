"""Content of Rerun's viewer in flight: what a run shows, and obstacle sectors and latency."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.flight.flight_loop import FlightStep
from monoloc.geometry import FloatArray, invert, transform
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.obstacles import MOST_M, SECTORS, ObstacleWatch, Surroundings, tells_obstacles
from monoloc.particle_filter.particles import Particles
from monoloc.viz.rerun_viewer import RerunViewer, state_views

_NEAR, _FAR, _NEAR_M = 0xD55E00FF, 0xF0E442FF, 1.0  # colours of Okabe and Ito
_LATENCY = 0x56B4E9FF
_SHOWN_PX = 320  # width of the image in the viewer


class FlightDrawing:
    """Logs a flight to a stream.

    Args:
        stream: to the viewer.
        room: of the flight; None in a place, where nothing is shown before a room is entered. Each is drawn in its
            own world.
        camera: of its images.
        frames: of the vehicle, for obstacles; None shows none.
    """

    def __init__(
        self, stream: rr.RecordingStream, room: Bundle | None, camera: Camera, frames: AutopilotFrames | None
    ) -> None:
        self._stream, self._camera, self._frames = stream, camera, frames
        self._watch: ObstacleWatch | None = None
        self._has_room = False
        self._began_s: float | None = None
        # A browser decodes JPEG only of pages that it calls secure; a smaller image needs none.
        self._size = _SHOWN_PX, round(camera.height * _SHOWN_PX / camera.width)
        self._viewer = RerunViewer(stream, as_jpeg=False)
        if room is not None:
            self._begin_room(room)
        stream.log("latency_ms", rr.SeriesLines(colors=_LATENCY, names="latency"), static=True)

    def _begin_room(self, room: Bundle) -> None:
        self._has_room = True
        self._watch = ObstacleWatch.of(room) if self._frames is not None and tells_obstacles(room) else None
        self._viewer.begin_room(room, self._camera.resized(*self._size))

    def show(self, result: FlightStep, particles: Particles) -> None:
        """Log a frame, with the particles after its step."""
        if result.in_place is not None and result.in_place.entered is not None:
            self._begin_room(result.in_place.entered)
        if not self._has_room:
            return
        captured_s = result.frame.captured_s
        self._began_s = captured_s if self._began_s is None else self._began_s
        self._stream.set_time("seconds", duration=captured_s - self._began_s)
        color = cv2.resize(result.frame.color, self._size, interpolation=cv2.INTER_AREA)
        self._viewer.show_step(np.asarray(color, dtype=np.uint8), result.step, particles, None, result.room)
        self._stream.log("latency_ms", rr.Scalars(1e3 * (result.done_s - captured_s)))
        self._show_obstacles(result)

    def _show_obstacles(self, result: FlightStep) -> None:
        """Log what is around the vehicle; nothing while it is lost, and in a room whose network was not tuned."""
        is_lost = result.step.state == "lost"
        around, T_level_camera = None, np.eye(4)
        if self._frames is not None and self._watch is not None:
            T_level_camera = self._frames.T_level_camera(result.estimate)
            around = self._watch.update(result.frame.captured_s, result.step, T_level_camera)
        if is_lost or self._watch is None:  # else those of before would stay where they were, or in the next room
            self._stream.log("world/obstacles", rr.LineStrips3D.cleared())
        elif around is not None:
            T_world_level = result.step.estimate.pose @ invert(T_level_camera)
            self._stream.log("world/obstacles", self._obstacles(around, T_world_level))

    def _obstacles(self, around: Surroundings, T_world_level: FloatArray) -> rr.LineStrips3D:
        """An arc for each sector that is not free, at its distance around the vehicle; red within a metre."""
        distances_m = around.distances_m
        known = np.flatnonzero(distances_m <= MOST_M)  # NaN and infinity are not
        arcs = [transform(T_world_level, _arc(int(sector), float(distances_m[sector]))) for sector in known]
        colors = np.where(distances_m[known] < _NEAR_M, _NEAR, _FAR).astype(np.uint32)
        return rr.LineStrips3D(arcs, colors=colors, radii=rr.Radius.ui_points(3.0))


def _arc(sector: int, distance_m: float) -> FloatArray:
    """Both ends of a sector at a distance, (2, 3): forward, right, down."""
    width = 2.0 * np.pi / SECTORS
    azimuth = width * (sector + np.array([-0.5, 0.5]))
    return distance_m * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(2)], axis=1)


def flight_blueprint() -> rrb.Blueprint:
    """Layout with the room on the left; on the right images, state with reasons, plots of the last minute."""
    last_seconds = [
        rrb.VisibleTimeRange("seconds", start=rrb.TimeRangeBoundary.cursor_relative(seconds=-10.0), end=_NOW)
    ]
    last_minute = rrb.VisibleTimeRange(
        "seconds", start=rrb.TimeRangeBoundary.cursor_relative(seconds=-60.0), end=_NOW
    )
    room = rrb.Spatial3DView(
        origin="world", name="room", overrides={"world/estimate": rrb.VisibleTimeRanges(last_seconds)}
    )
    images = rrb.Horizontal(
        rrb.Spatial2DView(origin="world/camera/image", name="image, landmarks"),
        rrb.Spatial2DView(origin="depth", name="depth, 0 to 6 m"),
    )
    right = rrb.Vertical(
        images,
        state_views(),
        rrb.TimeSeriesView(origin="latency_ms", name="latency (ms)", time_ranges=[last_minute]),
        rrb.TimeSeriesView(
            origin="probability_far",
            name="probability of more than 30 cm off",
            axis_y=rrb.ScalarAxis(range=(0.0, 1.0), zoom_lock=True),
            time_ranges=[last_minute],
        ),
        row_shares=[3.0, 1.3, 1.5, 1.5],
    )
    return rrb.Blueprint(
        rrb.Horizontal(room, right, column_shares=[3.0, 2.0]),
        rrb.TimePanel(timeline="seconds", state="collapsed", play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


_NOW = rrb.TimeRangeBoundary.cursor_relative(seconds=0.0)
