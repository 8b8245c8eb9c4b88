"""One pose, with its covariance, out of the particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray, invert, make_pose, nearest_rotation, se3_log
from monoloc.particle_filter.particles import Particles


@dataclass(frozen=True)
class Estimate:
    """Mean and spread of the belief.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        covariance: (6, 6) of the twist (rho, phi) in the estimated camera's frame: the true pose is
            ``pose @ exp(twist)``; m^2, m rad, rad^2.
        log_scale: mean log of true over predicted depth.
    """

    pose: FloatArray
    covariance: FloatArray
    log_scale: float


def estimate(particles: Particles) -> Estimate:
    """Weighted mean: arithmetic for position and log-scale, chordal for rotation (Hartley et al. 2013)."""
    weights = particles.weights
    position = weights @ particles.poses[:, :3, 3]
    rotation = nearest_rotation(np.einsum("n,nij->ij", weights, particles.poses[:, :3, :3]))
    pose = make_pose(rotation, position)
    twists = se3_log(invert(pose) @ particles.poses)
    return Estimate(pose, (weights[:, None] * twists).T @ twists, float(weights @ particles.log_scale))
