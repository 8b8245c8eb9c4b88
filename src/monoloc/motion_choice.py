"""The camera's motion, where both images and another sensor measured it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from monoloc.geometry import invert, rotation_angle
from monoloc.odometry.motion import Motion, tracks_translation
from monoloc.particle_filter.motion_model import MotionConfig, motion_sd

_MOST_SD = 5.0  # by which two motions of one camera differ


def chosen_motion(
    odometry: Motion | None, measured: Motion | None, elapsed_s: float, noise: MotionConfig
) -> Motion | None:
    """The motion that states the smaller noise; corners are the odometry's.

    The two are not averaged: odometry's errors of rotation and translation go together, and its translation has
    another unit. For the same reason a gyroscope's rotation does not replace that of odometry.

    Where they contradict each other, it is odometry's, with noise that allows for the other motion, but at most as if
    nothing had measured it. A tracking camera that corrects its own drift jumps, and images do not.

    Args:
        odometry: by images, None where they do not show it.
        measured: by another sensor, None where there is none.
        elapsed_s: that the motions are of.
        noise: of the settings.
    """
    if odometry is None or measured is None:
        return measured if odometry is None else odometry
    if not tracks_translation(measured):
        return odometry
    odometry_sd, measured_sd = (motion_sd(motion, elapsed_s, 0.0, noise) for motion in (odometry, measured))
    difference = invert(odometry.T_previous_current) @ measured.T_previous_current
    apart = np.array([np.linalg.norm(difference[:3, 3]), rotation_angle(difference[:3, :3])])
    if np.any(apart > _MOST_SD * np.hypot(odometry_sd, measured_sd)[::3]):
        allowed = np.minimum(apart / np.sqrt(3.0), motion_sd(None, elapsed_s, 0.0, noise)[::3])
        translation_sd_m, rotation_sd_rad = np.maximum(allowed, odometry_sd[::3]).tolist()
        return replace(
            odometry, translation_sd_m=translation_sd_m, rotation_sd_rad=rotation_sd_rad, is_contradicted=True
        )
    if np.linalg.norm(odometry_sd) <= np.linalg.norm(measured_sd):
        return odometry
    return replace(measured, inliers=odometry.inliers, points=odometry.points, log_depth_sd=odometry.log_depth_sd)
