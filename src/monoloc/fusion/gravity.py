"""What the particles say, turned upright where something tells which way is down, as a flight controller can.

Depth that errs tells little of a turn about what the camera looks at: turned a little and moved aside to match, its
scan fits as well. So what tells the tilt tells the place too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc.likelihood.scan import Scan
from monoloc.particle_filter.estimate import Estimate

_DOWN_SD_RAD = np.deg2rad(1.0)  # of a flight controller's tilt, and of the map's


def turned_about_m(scan: Scan, log_scale: float) -> float:
    """How far ahead the point is about which a turn changes the scan's depth least, as a share of it.

    A turn by psi and a shift by tau move what is at depth z aside by ``tau + (z - a) psi``; held against depth, which
    is what errors go with, both are independent for ``a = sum(1 / z) / sum(1 / z^2)``.

    Args:
        scan: one point at least.
        log_scale: natural logarithm of true over predicted depth.
    """
    nearness = 1.0 / np.asarray(scan.points[:, 2], dtype=np.float64)
    return float(np.exp(log_scale) * nearness.sum() / np.square(nearness).sum())


def upright(
    located: Estimate, down_camera: FloatArray, down_world: FloatArray, ahead_m: float, rotation_sd: float
) -> Estimate:
    """A pose turned to where down is seen, by the share that the two errors ask for.

    Args:
        located: the pose.
        down_camera, down_world: which way is down, in the camera's frame and in the world, (3,) unit vectors.
        ahead_m: on the optical axis, the point about which it is turned, see :func:`turned_about_m`.
        rotation_sd: standard deviation of the pose's rotation, rad an axis.
    """
    expected = located.pose[:3, :3].T @ down_world
    axis = np.cross(down_camera, expected)
    sine = np.linalg.norm(axis)
    if sine == 0.0:  # as it should be, or just upside down, when nothing says which way to turn
        return located
    share = rotation_sd**2 / (rotation_sd**2 + _DOWN_SD_RAD**2)
    turn = so3_exp(share * np.arctan2(sine, down_camera @ expected) * axis / sine)
    stays = np.array([0.0, 0.0, ahead_m])
    return replace(located, pose=located.pose @ make_pose(turn, stays - turn @ stays))
