"""NumPy twins of the native kernels of landmarks: readable reference implementations for tests.

Tests check that ``monoloc._core`` gives the same results.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, hat, invert, ray_jacobian, se3_exp, se3_log, transform

_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)


def match_descriptors(
    expected: FloatArray,
    known: NDArray[np.uint8],
    pixels: FloatArray,
    descriptors: NDArray[np.uint8],
    radius_px: float,
    most_bits: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """As :func:`monoloc.landmarks.features.match_descriptors`, of descriptors that differ by fewer than some bits."""
    by_x = np.argsort(pixels[:, 0], kind="stable")
    first, last = (np.searchsorted(pixels[by_x, 0], expected[:, 0] + side * radius_px) for side in (-1.0, 1.0))
    counts = last - first
    which = np.repeat(np.arange(len(expected)), counts)
    where = by_x[np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts - first, counts)]
    is_near = np.abs(expected[which, 1] - pixels[where, 1]) < radius_px
    which, where = which[is_near], where[is_near]
    bits = _ONES[known[which] ^ descriptors[where]].sum(axis=1, dtype=np.int64)
    matches = bits < most_bits
    which, where, bits = which[matches], where[matches], bits[matches]
    order = np.argsort(bits, kind="stable")
    first_which, first_where = np.full(len(expected), -1), np.full(len(pixels), -1)
    first_which[which[order[::-1]]] = order[::-1]  # the last to be written is the best match
    first_where[where[order[::-1]]] = order[::-1]
    both = np.flatnonzero(
        (first_which[which] == np.arange(len(which))) & (first_where[where] == np.arange(len(which)))
    )
    return which[both], where[both]


def nearest_descriptors(
    descriptors: NDArray[np.uint8], known: NDArray[np.uint8], kept: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """As :func:`monoloc.landmarks.features.nearest_descriptors`."""
    bits = _ONES[descriptors[:, None] ^ known].sum(axis=2, dtype=np.int32)
    nearest = np.argsort(bits, axis=1, kind="stable")[:, :kept]
    return np.take_along_axis(bits, nearest, axis=1), nearest


def fit_pose(
    points: FloatArray,
    rays: FloatArray,
    sd: FloatArray,
    prior: FloatArray,
    information: FloatArray,
    kernel_sds: FloatArray,
    nearest_m: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Pose from landmarks (M, 3), world frame, seen as rays, of which some are wrong matches: Gauss-Newton.

    Args:
        rays, sd: (M, 2) image coordinates at z = 1, and their standard deviations.
        prior, information: ``T_world_camera``, (4, 4), and the inverse covariance of its twist, (6, 6).
        kernel_sds: (S,) standard deviations at which a landmark's weight is a quarter, one of each step.
        nearest_m: depth of a landmark, at least.

    Returns:
        The pose, (4, 4), and there, with the last kernel and without the prior: normal matrix (6, 6) and gradient
        (6,) of its twist, and weights (M,) of the landmarks.
    """
    pose = prior
    for kernel_sd in kernel_sds:
        normal, gradient, _ = _normal_equations(pose, points, rays, sd, kernel_sd, nearest_m)
        offset = se3_log(invert(prior) @ pose)
        pose = pose @ se3_exp(-np.linalg.solve(normal + information, gradient + information @ offset))
    return pose, *_normal_equations(pose, points, rays, sd, kernel_sds[-1], nearest_m)


def fit_log_focal(
    points: FloatArray,
    rays: FloatArray,
    sd: FloatArray,
    pose: FloatArray,
    information: FloatArray,
    kernel_sds: FloatArray,
    nearest_m: float,
) -> tuple[float, float]:
    """Logarithm of true over stated focal length, and its standard deviation, from landmarks (M, 3) seen as rays.

    The residuals of a wrong focal length grow with the radius; a step along the view takes up a part of them. So pose
    and focal length are estimated together, again from a wide kernel, since those that agreed with a wrong focal
    length are near the centre.

    Args:
        pose, information: prior ``T_world_camera``, (4, 4), and the inverse covariance of its twist and of the
            logarithm, (7, 7).
    """
    start, log_focal = pose, 0.0
    for kernel_sd in kernel_sds:
        seen = rays * np.exp(-log_focal)  # a ray is a pixel over the focal length
        residuals, jacobian = _residuals(pose, points, seen, sd, nearest_m)
        columns = np.concatenate([jacobian, (seen / sd)[..., None]], axis=2).reshape(-1, 7)
        weighted = columns * np.repeat(_weights(residuals, kernel_sd), 2)[:, None]
        normal = weighted.T @ columns + information
        offset = np.append(se3_log(invert(start) @ pose), log_focal)
        step = -np.linalg.solve(normal, weighted.T @ residuals.ravel() + information @ offset)
        pose, log_focal = pose @ se3_exp(step[:6]), log_focal + float(step[6])
    return log_focal, float(np.sqrt(np.linalg.inv(normal)[6, 6]))


def _normal_equations(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray, kernel_sd: float, nearest_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal matrix (6, 6) and gradient (6,) of the pose's twist, and weights (M,) of the points."""
    residuals, jacobian = _residuals(pose, points, rays, sd, nearest_m)
    weights = _weights(residuals, kernel_sd)
    flat = jacobian.reshape(-1, 6)
    weighted = flat * np.repeat(weights, 2)[:, None]
    return weighted.T @ flat, weighted.T @ residuals.ravel(), weights


def _weights(residuals: FloatArray, kernel_sd: float) -> FloatArray:
    """Geman-McClure weights (M,) of residuals (M, 2) in standard deviations."""
    return np.asarray((1.0 + np.sum(residuals**2, axis=1) / kernel_sd**2) ** -2)


def _residuals(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray, nearest_m: float
) -> tuple[FloatArray, FloatArray]:
    """Residuals (M, 2) in standard deviations, and their derivative by the pose's twist, (M, 2, 6)."""
    local = transform(invert(pose), points)
    local[:, 2] = np.maximum(local[:, 2], nearest_m)
    by_point = ray_jacobian(local)
    jacobian = np.concatenate([-by_point, by_point @ hat(local)], axis=2)
    return (local[:, :2] / local[:, 2:] - rays) / sd, jacobian / sd[..., None]
