"""Alignment of a measured pose with gravity, where a flight controller gives roll and pitch.

Biased depth constrains a rotation about the scene poorly: the camera can turn a little and shift to match, and its
scan fits as well. So knowing the tilt corrects the position too.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from monoloc.geometry import FloatArray, angle_between, make_pose, so3_exp
from monoloc.likelihood.scan import Scan
from monoloc.particle_filter.estimate import Estimate

# Of a flight controller's tilt and of the map's. Of a video of RedKitchen, the map's was 3.4 to 6.5 degrees off.
_SENSOR_SD_RAD, _VIDEO_SD_RAD = np.deg2rad(1.0), np.deg2rad(5.0)
# Gravity farther from where a pose expects it, in standard deviations and at least, is that of a wrong mount.
_CONTRADICTING_SDS, _CONTRADICTING_RAD = 3.0, np.deg2rad(6.0)


def rotation_centre_m(scan: Scan, log_scale: float) -> float:
    """Depth of the point about which a rotation changes the scan's depth least, relative to depth.

    A rotation by psi and a translation by tau shift a point at depth z sideways by ``tau + (z - a) psi``. With errors
    proportional to depth, both are independent for ``a = sum(1 / z) / sum(1 / z^2)``.

    Args:
        scan: at least one point.
        log_scale: natural logarithm of true over predicted depth.
    """
    inverse_depth = 1.0 / np.asarray(scan.points[:, 2], dtype=np.float64)
    return float(np.exp(log_scale) * inverse_depth.sum() / np.square(inverse_depth).sum())


def align_with_gravity(
    measured: Estimate,
    down_camera: FloatArray,
    down_world: FloatArray,
    centre_m: float,
    rotation_sd: float,
    gravity_sd: float,
) -> Estimate:
    """A pose rotated towards the observed direction of gravity, by the share that the two variances give.

    Args:
        measured: the pose.
        down_camera, down_world: direction of gravity in the camera's frame and in the world, (3,) unit vectors.
        centre_m: depth on the optical axis of the centre of rotation, see :func:`rotation_centre_m`.
        rotation_sd, gravity_sd: standard deviations of the pose's rotation and of the two directions, rad an axis.
    """
    expected = measured.pose[:3, :3].T @ down_world
    axis = np.cross(down_camera, expected)
    sine = np.linalg.norm(axis)
    if sine == 0.0:  # aligned, or exactly upside down, where no direction of rotation is better than another
        return measured
    share = rotation_sd**2 / (rotation_sd**2 + gravity_sd**2)
    rotation = so3_exp(share * np.arctan2(sine, down_camera @ expected) * axis / sine)
    centre = np.array([0.0, 0.0, centre_m])
    return replace(measured, pose=measured.pose @ make_pose(rotation, centre - rotation @ centre))


def unit_direction(down_camera: FloatArray) -> FloatArray:
    """The unit vector of an observed direction of gravity, (3,) of any length.

    Raises:
        ValueError: it is not a direction.
    """
    length = math.hypot(*down_camera) if np.shape(down_camera) == (3,) else 0.0
    if not 0.0 < length < np.inf:
        raise ValueError(f"down must be three finite numbers, not all zero, got {down_camera}")
    return np.asarray(down_camera, dtype=np.float64) / length


class Gravity:
    """Direction of gravity in a room.

    Args:
        down_world: (3,) unit vector, world frame; None where the room's surfaces do not determine it.
        is_of_video: whether the map's poses come from structure from motion, so that its direction is less accurate.
    """

    def __init__(self, down_world: FloatArray | None, is_of_video: bool) -> None:
        self._down_world = down_world
        self._sd_rad = _VIDEO_SD_RAD if is_of_video else _SENSOR_SD_RAD

    def direction(self, down_camera: FloatArray | None) -> FloatArray | None:
        """The unit vector of an observed direction, (3,) of any length; None of None.

        Raises:
            ValueError: it is not a direction, or the room's own is unknown.
        """
        if down_camera is None:
            return None
        if self._down_world is None:
            raise ValueError("down is given, but the room's surfaces do not tell its direction: leave it out")
        return unit_direction(down_camera)

    def align(self, measured: Estimate, scan: Scan, down_camera: FloatArray | None, rotation_sd: float) -> Estimate:
        """As :func:`align_with_gravity`, or the pose as it is.

        The pose stays where gravity is not observed, where the scan is empty, and where gravity contradicts it: that
        of a camera that is mounted otherwise than stated would turn the pose until it fits.
        """
        if down_camera is None or self._down_world is None or len(scan) == 0:
            return measured
        apart_rad = angle_between(measured.pose[:3, :3].T @ self._down_world, down_camera)
        if apart_rad > max(_CONTRADICTING_RAD, _CONTRADICTING_SDS * float(np.hypot(rotation_sd, self._sd_rad))):
            return measured
        centre_m = rotation_centre_m(scan, measured.log_scale)
        return align_with_gravity(measured, down_camera, self._down_world, centre_m, rotation_sd, self._sd_rad)
