"""Measures how the map lies to north, from the autopilot's yaw and the pose in the map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from monoloc.errors import DataError
from monoloc.flight.flight_loop import FlightStep
from monoloc.geometry import FloatArray
from monoloc.mavlink.autopilot_frames import north_from_heading
from monoloc.mavlink.autopilot_link import Attitude
from monoloc.supervision.state import VOUCHED_FOR

_FRAMES = 90  # that are enough
_LEAST_FRAMES = 10


class NorthMeasurement:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that collects the heading of the map's x axis.

    Args:
        T_body_camera: pose of the camera on the body, (4, 4).
        down_world: direction of gravity in the map, (3,).
        attitude_at: of the vehicle at a time of capture.
    """

    def __init__(
        self, T_body_camera: FloatArray, down_world: FloatArray, attitude_at: Callable[[float], Attitude | None]
    ) -> None:
        self._T_body_camera, self._down_world, self._attitude_at = T_body_camera, down_world, attitude_at
        self._norths_rad: list[float] = []

    @property
    def is_done(self) -> bool:
        return len(self._norths_rad) >= _FRAMES

    def take(self, result: FlightStep) -> None:
        attitude = self._attitude_at(result.frame.captured_s)
        if result.step.state not in VOUCHED_FOR or attitude is None:
            return
        pose = result.estimate.pose
        self._norths_rad.append(north_from_heading(pose, self._T_body_camera, self._down_world, attitude.yaw_rad))

    def idle(self, now_s: float) -> None:
        """Nothing: only frames count."""

    def close(self) -> None:
        """Nothing is held."""

    def north_deg(self) -> tuple[float, float]:
        """The heading and its standard deviation over the frames, degrees.

        Raises:
            DataError: too few frames had both a pose and an attitude.
        """
        if len(self._norths_rad) < _LEAST_FRAMES:
            problem = f"only {len(self._norths_rad)} frames had a pose and an attitude of the autopilot"
            raise DataError("--align", problem, "wait until the state is tracking, and check the link")
        turns = np.exp(1j * np.array(self._norths_rad))
        mean = turns.mean()
        sd_rad = np.std(np.angle(turns / mean))
        return float(np.rad2deg(np.angle(mean))), float(np.rad2deg(sd_rad))
