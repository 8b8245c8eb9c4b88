"""Compares the attitude by pose and mount with the autopilot's: a wrong mount turns every pose that is sent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monoloc.flight.flight_loop import FlightStep
from monoloc.geometry import angle_between
from monoloc.mavlink.autopilot_frames import AutopilotFrames, rotation_of
from monoloc.mavlink.autopilot_link import Attitude
from monoloc.supervision.state import VOUCHED_FOR

MOST_TILT_DEG, MOST_YAW_DEG = 6.0, 15.0
"""Between the body by pose and mount and by the autopilot; more are of a wrong mount, and of a wrong north."""

_LEAST_FRAMES, _ENOUGH_FRAMES = 10, 300


@dataclass(frozen=True)
class MountErrors:
    """How the body's attitude by pose and mount differs from the autopilot's, medians over frames.

    Attributes:
        tilt_deg: angle between the two directions of gravity.
        pitch_deg, roll_deg: of the body by pose and mount, less those of the autopilot.
        yaw_deg: the same of the heading, from -180 to 180.
    """

    tilt_deg: float
    pitch_deg: float
    roll_deg: float
    yaw_deg: float


class MountCheck:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that collects both attitudes.

    Args:
        frames: of vehicle and map.
        attitude_at: of the vehicle at a time of capture.
    """

    def __init__(self, frames: AutopilotFrames, attitude_at: Callable[[float], Attitude | None]) -> None:
        self._frames, self._attitude_at = frames, attitude_at
        self._errors: list[tuple[float, float, float, float]] = []

    def take(self, result: FlightStep) -> None:
        attitude = None if self.is_done else self._attitude_at(result.frame.captured_s)
        if attitude is None or result.step.state not in VOUCHED_FOR:
            return
        by_pose = self._frames.body_pose(result.estimate)
        known = np.array([attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad])
        roll, pitch, yaw = (by_pose.euler_rad - known + np.pi) % (2.0 * np.pi) - np.pi
        down_by_pose, down = by_pose.T_ned_body[2, :3], rotation_of(*known)[2]  # in the body's axes
        tilt = angle_between(down_by_pose, down)
        self._errors.append((tilt, pitch, roll, yaw))

    def idle(self, now_s: float) -> None:
        """Nothing: only frames count."""

    def close(self) -> None:
        """Nothing is held."""

    @property
    def is_done(self) -> bool:
        """Whether enough frames had both."""
        return len(self._errors) >= _ENOUGH_FRAMES

    @property
    def errors(self) -> MountErrors | None:
        """None where too few frames had both a pose and an attitude."""
        if len(self._errors) < _LEAST_FRAMES:
            return None
        tilt, pitch, roll, yaw = np.array(self._errors).T
        heading = np.angle(np.median(np.cos(yaw)) + 1j * np.median(np.sin(yaw)))
        medians = (np.median(tilt), np.median(pitch), np.median(roll), heading)
        return MountErrors(*(float(np.rad2deg(each)) for each in medians))
