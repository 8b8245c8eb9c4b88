"""The camera's rotation by the attitude of its vehicle, such as an autopilot's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import is_rigid, make_pose
from monoloc.odometry.gyroscope import rotation_sd_rad
from monoloc.odometry.motion import Motion
from monoloc.odometry.pose_history import PoseHistory

_MAX_GAP_S = 0.12  # between samples; slower than ten a second, a turn bends between them
_SD_RAD = 0.003  # of the difference of two attitudes, at rest
_MOST_RATE_RAD_S = 6.0  # no vehicle in a room turns faster; an estimator whose heading is corrected jumps


class AttitudeHistory:
    """Interpolates attitudes between samples; its reference may be any that does not turn.

    Args:
        R_body_camera: turns the camera's axes into the body's, (3, 3).

    Raises:
        ValueError: it is no rotation.
    """

    def __init__(self, R_body_camera: ArrayLike = np.eye(3)) -> None:
        self._T_body_camera = make_pose(R_body_camera, np.zeros(3))
        if self._T_body_camera.shape != (4, 4) or not is_rigid(self._T_body_camera):
            raise ValueError("R_body_camera must be a rotation matrix, (3, 3)")
        self._history = PoseHistory(_MAX_GAP_S, most_turn_rad_s=_MOST_RATE_RAD_S)

    def add(self, time_s: float, R_reference_body: ArrayLike) -> None:
        """Take a sample, later than all before.

        Args:
            time_s: when it was measured, by the clock of the frames.
            R_reference_body: turns the body's axes into those of the reference, (3, 3).

        Raises:
            ValueError: the time is not after the last one, or it is no rotation; nothing has changed then.
        """
        self._history.add(time_s, make_pose(R_reference_body, np.zeros(3)) @ self._T_body_camera)

    def between(self, start_s: float, end_s: float) -> Motion | None:
        """The camera's rotation from one time of capture to another; None across dropouts and jumps."""
        turn = self._history.between(start_s, end_s)
        if turn is None:
            return None
        return Motion.rotation(turn[:3, :3], rotation_sd_rad(turn[:3, :3], _SD_RAD))
