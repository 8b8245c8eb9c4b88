"""From the camera's pose in the map to the body's pose as an autopilot fuses it.

Frames: *ned* has its origin at the map's origin, x north, y east, z down. *body* is the vehicle's: x forward, y
right, z down, origin where the autopilot has its own. Roll, pitch and yaw turn ned into body in the order yaw, pitch,
roll.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, adjoint, invert, is_rigid, make_pose, so3_exp
from monoloc.particle_filter.estimate import Estimate

_LEAST_HORIZONTAL = np.sin(np.deg2rad(20.0))  # of an axis that has a heading
_LEAST_COSINE = 0.05  # of pitch: at 90 degrees roll and yaw are one angle, and their variances are infinite


@dataclass(frozen=True)
class BodyPose:
    """The pose of the vehicle.

    Attributes:
        T_ned_body: (4, 4).
        covariance: (6, 6) of x, y, z in metres along north, east, down and of roll, pitch, yaw in radians.
    """

    T_ned_body: FloatArray
    covariance: FloatArray

    @property
    def euler_rad(self) -> FloatArray:
        """Roll, pitch and yaw, (3,)."""
        return euler_of(self.T_ned_body[:3, :3])

    @property
    def is_finite(self) -> bool:
        """Whether every entry is a number and no variance is negative."""
        is_number = np.isfinite(self.T_ned_body).all() and np.isfinite(self.covariance).all()
        return bool(is_number and np.all(np.diag(self.covariance) >= 0.0))


class AutopilotFrames:
    """How the camera sits on the vehicle and how the map lies in the world.

    Args:
        T_body_camera: pose of the camera on the body, (4, 4).
        down_world: direction of gravity in the map, (3,) of any length, as :attr:`monoloc.bundle.Bundle.down`.
        north_rad: heading of the map's x axis, clockwise from north as seen from above; see
            :func:`north_from_heading`.

    Raises:
        SettingError: the camera's pose is not rigid, the direction is none, or the heading is not finite.
    """

    def __init__(self, T_body_camera: ArrayLike, down_world: ArrayLike, north_rad: float) -> None:
        self.T_body_camera = np.asarray(T_body_camera, dtype=np.float64)
        if self.T_body_camera.shape != (4, 4) or not bool(is_rigid(self.T_body_camera)):
            raise SettingError("T_body_camera", "is no rigid pose", "give a rotation and a translation, (4, 4)")
        if not np.isfinite(north_rad):
            raise SettingError("north", f"is {north_rad}", "give the heading of the map's x axis")
        self.T_ned_world = make_pose(_level_axes(down_world, north_rad), np.zeros(3))
        self._T_camera_body = invert(self.T_body_camera)
        self._adjoint = adjoint(self.T_body_camera)

    def body_pose(self, estimate: Estimate) -> BodyPose:
        """The vehicle's pose with its covariance.

        The estimate's covariance is of a twist after the pose, so the adjoint of the mounting takes it to the body,
        with the lever arm between them. The pose turns its position to ned, and the kinematics of Euler angles turn
        its rotation vector to changes of roll, pitch and yaw. Both are of first order.
        """
        T_ned_body = self.T_ned_world @ estimate.pose @ self._T_camera_body
        covariance_body = self._adjoint @ estimate.covariance @ self._adjoint.T
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = T_ned_body[:3, :3]
        jacobian[3:, 3:] = _euler_rates(euler_of(T_ned_body[:3, :3]))
        covariance = jacobian @ covariance_body @ jacobian.T
        return BodyPose(T_ned_body, (covariance + covariance.T) / 2.0)

    def T_level_camera(self, estimate: Estimate) -> FloatArray:
        """Pose of the camera from the vehicle's origin along axes that are level: forward, right, down; (4, 4)."""
        T_ned_camera = self.T_ned_world @ estimate.pose
        T_ned_body = T_ned_camera @ self._T_camera_body
        heading = make_pose(so3_exp([0.0, 0.0, euler_of(T_ned_body[:3, :3])[2]]), T_ned_body[:3, 3])
        return np.asarray(invert(heading) @ T_ned_camera)

    def down_camera(self, roll_rad: float, pitch_rad: float) -> FloatArray:
        """Direction of gravity in the camera's frame from the vehicle's attitude, (3,) unit vector."""
        down_body = [-np.sin(pitch_rad), np.sin(roll_rad) * np.cos(pitch_rad), np.cos(roll_rad) * np.cos(pitch_rad)]
        return np.asarray(self.T_body_camera[:3, :3].T @ down_body)


def north_from_heading(
    T_world_camera: FloatArray, T_body_camera: ArrayLike, down_world: ArrayLike, heading_rad: float
) -> float:
    """Heading of the map's x axis, measured where both the pose in the map and the vehicle's heading are known.

    Args:
        T_world_camera: pose of the camera, (4, 4).
        T_body_camera: pose of the camera on the body, (4, 4).
        down_world: direction of gravity in the map, (3,).
        heading_rad: of the vehicle, clockwise from north, as its compass or a person says.

    Returns:
        ``north_rad`` of :class:`AutopilotFrames`, in (-pi, pi].

    Raises:
        SettingError: as :class:`AutopilotFrames`.
    """
    frames = AutopilotFrames(T_body_camera, down_world, 0.0)
    T_ned_body = frames.T_ned_world @ T_world_camera @ invert(frames.T_body_camera)
    turn = heading_rad - euler_of(T_ned_body[:3, :3])[2]
    return float(-((np.pi - turn) % (2.0 * np.pi) - np.pi))


def euler_of(rotation: FloatArray) -> FloatArray:
    """Roll, pitch, yaw of ``R_ned_body``, (3, 3) -> (3,) rad; at a pitch of 90 degrees roll is 0."""
    sin_pitch = float(np.clip(-rotation[2, 0], -1.0, 1.0))
    if abs(sin_pitch) > 1.0 - 1e-9:
        return np.array([0.0, np.arcsin(sin_pitch), np.arctan2(-rotation[0, 1], rotation[1, 1])])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, np.arcsin(sin_pitch), np.arctan2(rotation[1, 0], rotation[0, 0])])


def rotation_of(roll_rad: float, pitch_rad: float, yaw_rad: float) -> FloatArray:
    """``R_ned_body``, (3, 3), of roll, pitch and yaw."""
    roll, pitch, yaw = so3_exp(np.diag([roll_rad, pitch_rad, yaw_rad]))
    return np.asarray(yaw @ pitch @ roll)


def _euler_rates(euler_rad: FloatArray) -> FloatArray:
    """Changes of roll, pitch and yaw by small rotations about the body's axes, (3, 3)."""
    roll, pitch, _ = euler_rad
    sin_roll, cos_roll = np.sin(roll), np.cos(roll)
    cos_pitch = max(float(np.cos(pitch)), _LEAST_COSINE)
    tan_pitch = np.sin(pitch) / cos_pitch
    return np.array(
        [
            [1.0, sin_roll * tan_pitch, cos_roll * tan_pitch],
            [0.0, cos_roll, -sin_roll],
            [0.0, sin_roll / cos_pitch, cos_roll / cos_pitch],
        ]
    )


def _level_axes(down_world: ArrayLike, north_rad: float) -> FloatArray:
    """``R_ned_world``: the map's axes with its down direction at z and its x axis at a heading.

    Raises:
        SettingError: the direction is none, or the x axis has no heading.
    """
    down = np.asarray(down_world, dtype=np.float64)
    length = float(np.linalg.norm(down)) if down.shape == (3,) else 0.0
    if not 0.0 < length < np.inf:
        raise SettingError("down", f"is {down_world!r}", "give the direction of gravity in the map, three numbers")
    down = down / length
    ahead = np.array([1.0, 0.0, 0.0]) - down[0] * down  # the x axis, levelled
    horizontal = float(np.linalg.norm(ahead))
    if horizontal < _LEAST_HORIZONTAL:
        raise SettingError("down", "is along the map's x axis, which thus has no heading", "turn the map's poses")
    ahead /= horizontal
    R_level_world = np.stack([ahead, np.cross(down, ahead), down])
    cosine, sine = np.cos(north_rad), np.sin(north_rad)
    return np.asarray(np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ R_level_world)
