"""A pose with its covariance, and the weighted mean of particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray, invert, make_pose, nearest_rotation, se3_log
from monoloc.particle_filter.particles import Particles

UNKNOWN_POSITION_SD_M = 0.5
"""Standard deviation of position beyond which an estimate does not say where in a room the camera is."""


@dataclass(frozen=True)
class Estimate:
    """A pose and depth scale with their uncertainty.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        covariance: (6, 6) of the twist (rho, phi) in the estimated camera's frame: the true pose is
            ``pose @ exp(twist)``; m^2, m rad, rad^2.
        log_scale: mean log of true over predicted depth.
    """

    pose: FloatArray
    covariance: FloatArray
    log_scale: float

    @property
    def position_sd_m(self) -> float:
        """Standard deviation of position along its least certain axis."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))

    @property
    def position_is_unknown(self) -> bool:
        return self.position_sd_m > UNKNOWN_POSITION_SD_M


def estimate(particles: Particles) -> Estimate:
    """Weighted mean: arithmetic for position and log-scale, chordal for rotation (Hartley et al. 2013)."""
    weights = particles.weights
    position = weights @ particles.poses[:, :3, 3]
    rotation = nearest_rotation(np.einsum("n,nij->ij", weights, particles.poses[:, :3, :3]))
    pose = make_pose(rotation, position)
    twists = se3_log(invert(pose) @ particles.poses)
    return Estimate(pose, (weights[:, None] * twists).T @ twists, float(weights @ particles.log_scale))
