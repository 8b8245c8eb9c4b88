"""A point from the pixels that several frames saw it at."""

from __future__ import annotations

import numpy as np

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, ray_jacobian, transform

_STEPS = 8
_LEAST_DETERMINED = 1e-12  # of a normal matrix without a unit: a point on parallel rays is nowhere


def triangulate(camera: Camera, poses: FloatArray, pixels: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Least-squares position of a point, (3,), and its covariance for pixels with a standard deviation of 1, (3, 3).

    Args:
        camera: of the images.
        poses: ``T_world_camera`` of the frames that saw the point, (N, 4, 4), N >= 2.
        pixels: (N, 2) where.

    Returns:
        None where the frames saw it from one side only, or behind them.
    """
    rays = camera.rays(pixels)
    directions = np.einsum("nij,nj->ni", poses[:, :3, :3], rays / np.linalg.norm(rays, axis=1, keepdims=True))
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    if np.linalg.det(across.sum(axis=0)) < _LEAST_DETERMINED:
        return None
    point = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, poses[:, :3, 3]))
    for _ in range(_STEPS):
        local = transform(invert(poses), point[None])[:, 0]
        if np.any(local[:, 2] <= 0.0):
            return None
        jacobian = ray_jacobian(local) @ np.swapaxes(poses[:, :3, :3], 1, 2)
        offset = local[:, :2] / local[:, 2:] - rays[:, :2]
        normal = np.einsum("nij,nik->jk", jacobian, jacobian)
        if np.linalg.det(normal * np.median(local[:, 2]) ** 2) < _LEAST_DETERMINED:
            return None
        point = point - np.linalg.solve(normal, np.einsum("nij,ni->j", jacobian, offset))
    return point, np.asarray(np.linalg.inv(normal) / camera.focal_px**2)


def distance_sd(first: tuple[FloatArray, FloatArray], second: tuple[FloatArray, FloatArray]) -> tuple[float, float]:
    """Distance of two points with their covariances, and its standard deviation."""
    offset = second[0] - first[0]
    distance = float(np.linalg.norm(offset))
    direction = offset / distance
    return distance, float(np.sqrt(direction @ (first[1] + second[1]) @ direction))
