"""Frames of ROS (REP 103, REP 105) from monoloc's own.

*map* is the room with z up, and its x axis is the room's, levelled. A room whose z axis is up already is the map as
it is, and so is one whose direction of gravity is not known. *odom* is where *base_link* was at the first frame.
*base_link* is the vehicle: x forward, y left, z up. The camera's frame is an optical one: x right, y down, z forward.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import FloatArray, adjoint, invert, is_rigid, make_pose, quaternion_to_rotation
from monoloc.image_turns import T_camera_turned, turns_on_body
from monoloc.io.rosbag_messages import pose_row
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.particle_filter.estimate import Estimate
from monoloc.start import START_ERROR_DEG, START_ERROR_M, Start

_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # between axes with z down, y right and axes with z up, y left
_UP = np.array([0.0, 0.0, 1.0])
_LEVEL_RAD = np.deg2rad(5.0)  # of a z axis that counts as up: the direction measured of floor and walls errs too


@dataclass(frozen=True)
class FrameNames:
    """Names of the frames; *room* is the frame in which the bundle's map is, and which its files use."""

    map: str = "map"
    odom: str = "odom"
    base: str = "base_link"
    camera: str = "camera_optical_frame"
    room: str = "room"


class RosFrames:
    """How the camera sits on the vehicle, and how the room lies in the map.

    Args:
        T_body_camera: pose of the camera on the body, whose axes are forward, right, down, (4, 4), as
            :attr:`monoloc.flight.flight_settings.Mount.T_body_camera`.
        down_world: direction of gravity in the room, (3,), or None where it is not known.
        names: of the frames.

    Raises:
        SettingError: the camera's pose is not rigid, or gravity is no direction, or along the room's x axis.
    """

    def __init__(
        self, T_body_camera: ArrayLike, down_world: ArrayLike | None, names: FrameNames = FrameNames()
    ) -> None:
        down = -_UP if down_world is None else np.asarray(down_world, dtype=np.float64)
        frames = AutopilotFrames(T_body_camera, down, 0.0)
        self.names = names
        self.T_base_camera: FloatArray = _FLIP @ frames.T_body_camera
        is_level = down @ -_UP >= np.cos(_LEVEL_RAD) * np.linalg.norm(down)
        self.T_map_room: FloatArray = np.eye(4) if is_level else _FLIP @ frames.T_ned_world

    @classmethod
    def of_base(
        cls, T_base_camera: FloatArray, down_world: ArrayLike | None, names: FrameNames = FrameNames()
    ) -> RosFrames:
        """The frames by the pose of the camera on ``base_link``, (4, 4)."""
        return cls(_FLIP @ T_base_camera, down_world, names)

    @property
    def quarter_turns(self) -> int:
        """Turns, 0 to 3, that bring the camera's images upright, see :func:`monoloc.image_turns.turns_on_body`."""
        return turns_on_body(_FLIP @ self.T_base_camera)

    @property
    def upright(self) -> RosFrames:
        """The frames of the camera whose images are turned upright, which has a name of its own where they are."""
        turns, upright = self.quarter_turns, copy(self)
        if turns > 0:
            upright.T_base_camera = self.T_base_camera @ T_camera_turned(turns)
            upright.names = replace(self.names, camera=f"{self.names.camera}_upright")
        return upright

    def base_pose(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """``T_map_base`` (4, 4), and its covariance as ROS takes it, (6, 6).

        geometry_msgs/PoseWithCovariance has position, then rotation, about the fixed axes of the frame of its header.
        The estimate's covariance is of a twist after the camera's pose: the adjoint of the mounting takes it to the
        vehicle, with the lever arm, and the vehicle's attitude turns position and rotation to the map's axes. The
        rotation is that of the error, ``R_map_true = Rz Ry Rx R_map_base``, as tf2's transformCovariance turns it;
        these are not the variances of the attitude's own roll, pitch and yaw. It is of first order.
        """
        T_map_base = self.T_map_room @ estimate.pose @ invert(self.T_base_camera)
        turn = np.kron(np.eye(2), T_map_base[:3, :3]) @ adjoint(self.T_base_camera)
        covariance = turn @ estimate.covariance @ turn.T
        return T_map_base, (covariance + covariance.T) / 2.0

    def start(self, T_map_base: FloatArray, covariance: FloatArray) -> Start:
        """The start of a localizer from a vehicle's pose (4, 4) and its covariance (6, 6), as :meth:`base_pose`.

        A covariance of zeros says that there is none, and the default error is taken.

        Raises:
            ValueError: the pose is not rigid, or the covariance has a negative or no finite variance.
        """
        if not bool(is_rigid(T_map_base)):
            raise ValueError(f"pose must be rigid, got {T_map_base.tolist()}")
        T_base_camera = self.T_base_camera
        pose = invert(self.T_map_room) @ T_map_base @ T_base_camera
        if not covariance.any():
            return Start(pose, START_ERROR_M, float(np.deg2rad(START_ERROR_DEG)))
        turn = adjoint(invert(T_base_camera)) @ np.kron(np.eye(2), T_map_base[:3, :3].T)
        variances = np.diag(turn @ covariance @ turn.T)
        if not (np.isfinite(variances).all() and (np.diag(covariance) >= 0.0).all()):
            raise ValueError("covariance must be finite, with variances that are not negative")
        return Start(pose, *(float(np.sqrt(max(0.0, part.sum()))) for part in (variances[:3], variances[3:])))


def pose_of(message: Any) -> FloatArray:
    """Pose (4, 4) of a message with a pose or a transform, see :func:`monoloc.io.rosbag_messages.pose_row`.

    Raises:
        ValueError: its quaternion is zero or not finite.
    """
    row = pose_row(message)
    return make_pose(quaternion_to_rotation(row[3:]), row[:3])


def down_camera(orientation: Any, T_imu_camera: FloatArray) -> FloatArray:
    """Direction of gravity in the camera's frame, (3,), from the orientation of a sensor_msgs/Imu.

    Args:
        orientation: geometry_msgs/Quaternion that turns the sensor's axes to those of the world, z up (REP 145).
        T_imu_camera: pose of the camera in the sensor's frame, (4, 4).

    Raises:
        ValueError: as :func:`pose_of`.
    """
    R_level_imu = quaternion_to_rotation([orientation.x, orientation.y, orientation.z, orientation.w])
    return np.asarray(T_imu_camera[:3, :3].T @ R_level_imu.T @ -_UP)
