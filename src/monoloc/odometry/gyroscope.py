"""The camera's rotation by a gyroscope."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import FloatArray, is_rigid, make_pose, rotation_angle, so3_exp
from monoloc.odometry.motion import Motion
from monoloc.odometry.pose_history import PoseHistory

_MAX_GAP_S = 0.05  # between samples: the slowest gyroscopes in use give a hundred a second
# Of a turn: an axis that is mounted 1 degree off, and a stamp that is late while the turn begins.
TURN_SD_RATIO = 0.02


class Gyroscope:
    """Integrates angular velocity between two times of capture.

    The bias is not estimated. At 0.01 rad/s, that of a cheap sensor which was not calibrated, it turns the camera by
    a third of a degree in half a second, far less than the motion model allows for where nothing is measured; so it
    is part of the stated noise.

    Args:
        R_camera_sensor: turns the sensor's axes into the camera's, (3, 3).
        sd_rad_s: standard deviation of the angular velocity's error per axis over a frame, bias included.
        memory_s: for which samples are kept at least.

    Raises:
        ValueError: it is no rotation, or the standard deviation is not positive.
    """

    def __init__(
        self, R_camera_sensor: ArrayLike = np.eye(3), sd_rad_s: float = 0.01, memory_s: float = 60.0
    ) -> None:
        self._R_camera_sensor = np.asarray(R_camera_sensor, dtype=np.float64)
        if self._R_camera_sensor.shape != (3, 3) or not is_rigid(make_pose(self._R_camera_sensor, np.zeros(3))):
            raise ValueError("R_camera_sensor must be a rotation matrix, (3, 3)")
        if not 0.0 < sd_rad_s < np.inf:
            raise ValueError(f"sd_rad_s must be positive and finite, got {sd_rad_s}")
        self._sd_rad_s = sd_rad_s
        self._history = PoseHistory(_MAX_GAP_S, memory_s)
        self._rate: FloatArray = np.zeros(3)  # of the last sample, camera's axes

    def add(self, time_s: float, rate_rad_s: ArrayLike) -> None:
        """Take a sample, later than all before.

        Args:
            time_s: when it was measured, by the clock of the frames.
            rate_rad_s: angular velocity, (3,), in the sensor's axes.

        Raises:
            ValueError: the time is not after the last one, or a value is not finite; nothing has changed then.
        """
        rate = np.asarray(rate_rad_s, dtype=np.float64)
        if rate.shape != (3,) or not np.all(np.isfinite(rate)):
            raise ValueError(f"an angular velocity is three finite numbers, got {rate_rad_s!r}")
        rate = self._R_camera_sensor @ rate
        rotation, newest = np.eye(3), self._history.newest
        if newest is not None:
            rotation = newest[1][:3, :3] @ so3_exp(0.5 * (self._rate + rate) * (time_s - newest[0]))
        self._history.add(time_s, make_pose(rotation, np.zeros(3)))
        self._rate = rate

    def between(self, start_s: float, end_s: float) -> Motion | None:
        """The camera's rotation from one time of capture to another; None where samples miss for 50 ms."""
        turn = self._history.between(start_s, end_s)
        if turn is None or start_s == end_s:  # which has no noise
            return None
        rotation = turn[:3, :3]
        return Motion.rotation(rotation, rotation_sd_rad(rotation, self._sd_rad_s * (end_s - start_s)))


def rotation_sd_rad(rotation: FloatArray, least_rad: float) -> float:
    """Standard deviation per axis of a rotation (3, 3) that an inertial sensor measured."""
    return float(np.hypot(least_rad, TURN_SD_RATIO * rotation_angle(rotation)))
