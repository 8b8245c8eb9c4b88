"""The motion model: how particles move between two frames."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.geometry import FloatArray, rotation_angle, se3_exp
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.frame_share import share_of_frame
from monoloc.particle_filter.particles import Particles

# The fewer corners agree with a motion, the less exact it is: a power law. Median error of the rotation in 800 steps
# of two real recordings: 0.2 degrees by more than 200 of at most 300 corners, 0.5 by 100 to 150, 0.9 by 70 to 100.
_ENOUGH_INLIERS, _INLIER_POWER = 200, 1.5


class MotionConfig(BaseModel):
    """Noise of the motion models and of the depth's scale.

    Attributes:
        speed_sd_m_s, turn_sd_rad_s: for frames without odometry: standard deviation of the velocity per axis. The
            velocity is redrawn after every frame that constrains the pose and constant while none does.
        translation_sd_m, translation_sd_ratio: odometry's translation noise, per axis: constant and share of
            the distance moved, if many corners agree with it; with few, both are larger. Both are of one frame; a
            camera above 16 Hz has the variance of one at 16 Hz in a second, and over a distance.
        rotation_sd_rad, rotation_sd_ratio: its rotation noise, likewise.
        log_scale_correlation: correlation of the depth's log-scale over one second.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    speed_sd_m_s: float = Field(0.35, gt=0.0, le=100.0)
    turn_sd_rad_s: float = Field(0.5, gt=0.0, le=100.0)
    translation_sd_m: float = Field(0.002, gt=0.0, le=10.0)
    translation_sd_ratio: float = Field(0.1, ge=0.0, le=10.0)
    rotation_sd_rad: float = Field(0.0015, gt=0.0, le=10.0)
    rotation_sd_ratio: float = Field(0.05, ge=0.0, le=10.0)
    log_scale_correlation: float = Field(0.95, ge=0.0, lt=1.0)


def few_corners_factor(inliers: int) -> float:
    """By which odometry's standard deviations are larger; 1 of a motion that no corners measured."""
    return max(1.0, (_ENOUGH_INLIERS / inliers) ** _INLIER_POWER) if inliers > 0 else 1.0


def motion_sd(
    motion: Motion | None, elapsed_s: float, time_since_update_s: float, config: MotionConfig
) -> FloatArray:
    """Standard deviations of a motion's twist in the new camera's frame, (6,).

    Args:
        motion: of the odometry; None for an unknown constant velocity over ``time_since_update_s + elapsed_s``, of
            whose spread the last ``elapsed_s`` is returned. So is the translation's where only the rotation is known.
        elapsed_s: since the previous frame.
        time_since_update_s: from the last frame that constrained the pose to the previous one.
    """
    equivalent_s = float(np.sqrt((time_since_update_s + elapsed_s) ** 2 - time_since_update_s**2))
    if motion is None:
        return np.repeat([config.speed_sd_m_s, config.turn_sd_rad_s], 3) * equivalent_s
    delta = motion.T_previous_current
    translation_ratio, rotation_ratio = config.translation_sd_ratio, config.rotation_sd_ratio
    root = math.sqrt(share_of_frame(elapsed_s))
    moved_m, turned_rad = np.linalg.norm(delta[:3, 3]) / root, rotation_angle(delta[:3, :3]) / root
    translation_sd = float(np.hypot(root * config.translation_sd_m, translation_ratio * moved_m))
    rotation_sd = float(np.hypot(root * config.rotation_sd_rad, rotation_ratio * turned_rad))
    factor = few_corners_factor(motion.inliers)
    translation_sd, rotation_sd = factor * translation_sd, factor * rotation_sd
    if motion.translation == "unknown":
        translation_sd = config.speed_sd_m_s * equivalent_s
    elif motion.translation_sd_m is not None:
        translation_sd = motion.translation_sd_m
    if motion.rotation_sd_rad is not None:
        rotation_sd = motion.rotation_sd_rad
    return np.repeat([translation_sd, rotation_sd], 3)


def predict(
    particles: Particles,
    motion: Motion | None,
    elapsed_s: float,
    time_since_update_s: float,
    log_scale_sd: float,
    config: MotionConfig,
    rng: np.random.Generator,
) -> Particles:
    """Move every particle by odometry where there is some, else at random; noise as :func:`motion_sd`.

    A translation that was measured in predicted depth is multiplied by each particle's own depth scale.
    The log-scale is a first-order autoregressive process whose spread stays ``log_scale_sd``.
    """
    count = len(particles)
    noise = rng.standard_normal((count, 6)) * motion_sd(motion, elapsed_s, time_since_update_s, config)
    poses = particles.poses
    if motion is not None:
        factors = np.ones(count) if motion.translation == "metric" else np.exp(particles.log_scale)
        poses = poses @ _scaled(motion.T_previous_current, factors)
    poses = poses @ se3_exp(noise)
    keep = config.log_scale_correlation**elapsed_s
    spread = log_scale_sd * np.sqrt(1.0 - keep**2)
    log_scale = keep * particles.log_scale + spread * rng.standard_normal(count)
    return Particles(poses, log_scale, particles.log_weights)


def _scaled(pose: FloatArray, factors: FloatArray) -> FloatArray:
    """A pose with its translation multiplied by each factor: (4, 4), (N,) -> (N, 4, 4)."""
    poses = np.repeat(pose[None], len(factors), axis=0)
    poses[:, :3, 3] *= factors[:, None]
    return poses
