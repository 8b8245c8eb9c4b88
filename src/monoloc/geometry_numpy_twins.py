"""NumPy twins of the native kernels of :mod:`monoloc.geometry`, which the tests hold equal to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import TURN_WORTH_M, FloatArray, hat, rotation_angle, rotation_to_quaternion

_SMALL_ANGLE = 1e-4  # below this, series replace the quotients of sine and cosine


def se3_exp(twist: ArrayLike) -> FloatArray:
    """As :func:`monoloc.geometry.se3_exp`."""
    xi = np.asarray(twist, dtype=np.float64)
    rho, phi = xi[..., :3], xi[..., 3:]
    a, b, c = _angle_quotients(np.linalg.norm(phi, axis=-1))
    phi_hat = hat(phi)
    phi_hat_squared = phi_hat @ phi_hat
    pose = np.zeros((*xi.shape[:-1], 4, 4))
    pose[..., :3, :3] = np.eye(3) + a[..., None, None] * phi_hat + b[..., None, None] * phi_hat_squared
    left_jacobian = np.eye(3) + b[..., None, None] * phi_hat + c[..., None, None] * phi_hat_squared
    pose[..., :3, 3] = (left_jacobian @ rho[..., None])[..., 0]
    pose[..., 3, 3] = 1.0
    return pose


def se3_log(pose: ArrayLike) -> FloatArray:
    """As :func:`monoloc.geometry.se3_log`."""
    T = np.asarray(pose, dtype=np.float64)
    phi = _so3_log(T[..., :3, :3])
    _, b, c = _angle_quotients(np.linalg.norm(phi, axis=-1))
    phi_hat = hat(phi)
    left_jacobian = np.eye(3) + b[..., None, None] * phi_hat + c[..., None, None] * (phi_hat @ phi_hat)
    rho = np.linalg.solve(left_jacobian, T[..., :3, 3:])
    return np.concatenate([rho[..., 0], phi], axis=-1)


def pose_distance_m(pose: FloatArray, others: FloatArray) -> FloatArray:
    """As :func:`monoloc.geometry.pose_distance_m`."""
    shift = np.linalg.norm(others[:, :3, 3] - pose[:3, 3], axis=1)
    return np.asarray(shift + TURN_WORTH_M * rotation_angle(pose[:3, :3].T @ others[:, :3, :3]))


def _angle_quotients(angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute sin(t)/t, (1 - cos(t))/t^2 and (t - sin(t))/t^3, stable at t = 0."""
    small = angle < _SMALL_ANGLE
    t = np.where(small, 1.0, angle)
    squared = angle**2
    a = np.where(small, 1.0 - squared / 6.0, np.sin(t) / t)
    b = np.where(small, 0.5 - squared / 24.0, 2.0 * np.sin(t / 2.0) ** 2 / t**2)
    c = np.where(small, 1.0 / 6.0 - squared / 120.0, (t - np.sin(t)) / t**3)
    return a, b, c


def _so3_log(R: FloatArray) -> FloatArray:
    """Rotation vector of a rotation, well conditioned at every angle, including pi: (..., 3, 3) -> (..., 3) rad."""
    quaternion = rotation_to_quaternion(R)
    vector, w = quaternion[..., :3], quaternion[..., 3]
    norm = np.linalg.norm(vector, axis=-1)
    small = norm < _SMALL_ANGLE
    # If the norm (a sine) is small, w (a cosine) is near 1; otherwise w may be 0, at pi.
    scale = np.where(small, 2.0 / np.where(small, w, 1.0), 2.0 * np.arctan2(norm, w) / np.where(small, 1.0, norm))
    return np.asarray(scale[..., None] * vector)
