"""Rigid motions in SE(3), as NumPy arrays.

``T_a_b`` maps coordinates in frame b to frame a: ``x_a = T_a_b[:3, :3] @ x_b + T_a_b[:3, 3]``.
Every function accepts any number of leading batch axes. A twist is ``(rho, phi)``: translation in metres,
then rotation vector in radians. Formulas: Solà et al., *A micro Lie theory for state estimation in robotics* (2018).
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

import monoloc._core as _core

FloatArray = NDArray[np.float64]

MAX_DISTANCE_M = 1e5
"""Of a pose or a point from the origin of the world: single precision resolves 8 mm there."""

TURN_WORTH_M = 1.0  # metres that change the view as much as one radian of rotation


def hat(vector: ArrayLike) -> FloatArray:
    """Cross-product matrix: (..., 3) -> (..., 3, 3) with ``hat(a) @ b == cross(a, b)``."""
    v = np.asarray(vector, dtype=np.float64)
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2] = -v[..., 2], v[..., 1]
    matrix[..., 1, 0], matrix[..., 1, 2] = v[..., 2], -v[..., 0]
    matrix[..., 2, 0], matrix[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrix


def se3_exp(twist: ArrayLike) -> FloatArray:
    """Pose of a twist (rho, phi): (..., 6) -> (..., 4, 4).

    NumPy twins of this function, its inverse and the pose distance: :mod:`monoloc.geometry_numpy_twins`.
    """
    xi = np.asarray(twist, dtype=np.float64)
    return _core.se3_exp(xi.reshape(-1, 6)).reshape(*xi.shape[:-1], 4, 4)


def se3_log(pose: ArrayLike) -> FloatArray:
    """Twist (rho, phi) of a pose, norm of phi in [0, pi]: (..., 4, 4) -> (..., 6)."""
    T = np.asarray(pose, dtype=np.float64)
    return _core.se3_log(T.reshape(-1, 4, 4)).reshape(*T.shape[:-2], 6)


def so3_exp(rotation_vector: ArrayLike) -> FloatArray:
    """Rotation matrix of a rotation vector: (..., 3) rad -> (..., 3, 3)."""
    phi = np.asarray(rotation_vector, dtype=np.float64)
    return se3_exp(np.concatenate([np.zeros_like(phi), phi], axis=-1))[..., :3, :3]


def so3_log(rotation: ArrayLike) -> FloatArray:
    """Rotation vector of a rotation matrix, norm in [0, pi]: (..., 3, 3) -> (..., 3) rad."""
    return se3_log(make_pose(rotation, 0.0))[..., 3:]


def make_pose(rotation: ArrayLike, translation_m: ArrayLike) -> FloatArray:
    """Pose from rotation (..., 3, 3) and translation (..., 3)."""
    R = np.asarray(rotation, dtype=np.float64)
    pose = np.zeros((*R.shape[:-2], 4, 4))
    pose[..., :3, :3] = R
    pose[..., :3, 3] = translation_m
    pose[..., 3, 3] = 1.0
    return pose


def invert(pose: ArrayLike) -> FloatArray:
    """``T_b_a`` of ``T_a_b``: (..., 4, 4) -> (..., 4, 4)."""
    T = np.asarray(pose, dtype=np.float64)
    R_transposed = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_pose(R_transposed, -(R_transposed @ T[..., :3, 3:])[..., 0])


def transform(pose: ArrayLike, points: ArrayLike) -> FloatArray:
    """Map points from frame b to frame a by ``T_a_b``: (..., 4, 4), (..., P, 3) -> (..., P, 3)."""
    T = np.asarray(pose, dtype=np.float64)
    return np.asarray(points, dtype=np.float64) @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def angle_between(a: FloatArray, b: FloatArray) -> float:
    """Angle between two unit vectors (3,), in [0, pi] rad."""
    return float(np.arccos(np.clip(a @ b, -1.0, 1.0)))


def rotation_angle(rotation: ArrayLike) -> FloatArray:
    """Angle of a rotation, in [0, pi]: (..., 3, 3) -> (...) rad."""
    R = np.asarray(rotation, dtype=np.float64)
    difference = R - np.swapaxes(R, -1, -2)
    sine = 0.5 * np.sqrt(difference[..., 2, 1] ** 2 + difference[..., 0, 2] ** 2 + difference[..., 1, 0] ** 2)
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1.0)
    return np.asarray(np.arctan2(sine, cosine))


def adjoint(pose: ArrayLike) -> FloatArray:
    """Adjoint matrix of a pose, (..., 4, 4) -> (..., 6, 6), with ``pose @ exp(x) == exp(adjoint @ x) @ pose``."""
    matrix = np.asarray(pose, dtype=np.float64)
    rotation = matrix[..., :3, :3]
    result = np.zeros((*matrix.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    result[..., :3, 3:] = hat(matrix[..., :3, 3]) @ rotation
    return result


def ray_jacobian(points: FloatArray) -> FloatArray:
    """Jacobian of (x / z, y / z) with respect to the point: (N, 3) -> (N, 2, 3)."""
    z = points[:, 2]
    J = np.zeros((len(points), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0 / z
    J[:, :, 2] = -points[:, :2] / z[:, None] ** 2
    return J


def ray_twist_jacobian(local: FloatArray) -> FloatArray:
    """Jacobian of (x / z, y / z) of points in a camera's frame by the camera's twist: (N, 3) -> (N, 2, 6)."""
    by_point = ray_jacobian(local)
    return np.concatenate([-by_point, by_point @ hat(local)], axis=2)


def pose_distance_m(pose: FloatArray, others: FloatArray) -> FloatArray:
    """Distance in metres plus one metre per radian of rotation, from a pose (4, 4) to others (N, 4, 4): (N,)."""
    return _core.pose_distances(pose, others, TURN_WORTH_M)


def steps_m(poses: FloatArray) -> FloatArray:
    """Pose distance from each pose to the next, (N, 4, 4) -> (N - 1,)."""
    return np.array([pose_distance_m(a, b[None])[0] for a, b in itertools.pairwise(poses)])


def is_rigid(pose: ArrayLike, tolerance: float = 1e-3) -> NDArray[np.bool_]:
    """Whether each pose (..., 4, 4) is finite and has last row (0, 0, 0, 1) and a proper rotation: (...).

    The tolerance bounds the largest entry of ``R^T R - I``; recorded poses carry rounding of 1e-6 to 1e-4.
    """
    T = np.asarray(pose, dtype=np.float64)
    finite = np.asarray(np.isfinite(T).all(axis=(-1, -2)))
    T = np.where(finite[..., None, None], T, 0.0)
    R = T[..., :3, :3]
    orthogonal = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(axis=(-1, -2)) < tolerance
    last_row = np.abs(T[..., 3, :] - np.array([0.0, 0.0, 0.0, 1.0])).max(axis=-1) < tolerance
    return np.asarray(finite & orthogonal & last_row & (np.linalg.det(R) > 0.0))


def nearest_rotation(matrix: ArrayLike) -> FloatArray:
    """The rotation closest to a matrix in the Frobenius norm: (..., 3, 3) -> (..., 3, 3).

    For a weighted sum of rotations, this is their chordal mean. Source: Umeyama 1991.
    """
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    sign = np.ones(u.shape[:-1])
    sign[..., 2] = np.sign(np.linalg.det(u @ vt))
    return np.asarray((u * sign[..., None, :]) @ vt)


def made_rigid(pose: ArrayLike) -> FloatArray:
    """Exactly rigid pose of one that nearly is, see :func:`is_rigid`: (4, 4) -> (4, 4), a copy.

    Inversion by the transpose requires exact rotations, and in a product of thousands rounding adds up. A pose that
    is exact up to the last digits keeps them, so that it can be recorded and read again.
    """
    T = np.array(pose, dtype=np.float64)
    return T if bool(is_rigid(T, 1e-12)) else make_pose(nearest_rotation(T[:3, :3]), T[:3, 3])


# --- Quaternions exist only in files and messages. These two functions convert them. ---


def quaternion_to_rotation(quaternion_xyzw: ArrayLike) -> FloatArray:
    """Rotation matrix of a quaternion (x, y, z, w) of any length: (..., 4) -> (..., 3, 3).

    Raises:
        ValueError: the quaternion is zero or not finite.
    """
    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(np.isfinite(norm)) or np.any(norm < 1e-9):
        raise ValueError("quaternion must be finite and not zero")
    q = q / norm
    vector_hat, w = hat(q[..., :3]), q[..., 3, None, None]
    return np.asarray(np.eye(3) + 2.0 * w * vector_hat + 2.0 * (vector_hat @ vector_hat))


def rotation_to_quaternion(rotation: ArrayLike) -> FloatArray:
    """Unit quaternion (x, y, z, w) with w >= 0 of a rotation: (..., 3, 3) -> (..., 4).

    The symmetric 4x4 matrix 4 q q^T is linear in the rotation, and each of its columns is a multiple of q. The column
    with the largest diagonal entry is never near zero, so it is normalised (Markley 2008).
    """
    R = np.asarray(rotation, dtype=np.float64)
    outer = np.zeros((*R.shape[:-2], 4, 4))
    trace = np.trace(R, axis1=-2, axis2=-1)[..., None, None]
    outer[..., :3, :3] = R + np.swapaxes(R, -1, -2) + (1.0 - trace) * np.eye(3)
    axial = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    outer[..., :3, 3] = outer[..., 3, :3] = axial
    outer[..., 3, 3] = 1.0 + trace[..., 0, 0]
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    quaternion = column / np.linalg.norm(column, axis=-1, keepdims=True)
    return np.asarray(np.where(quaternion[..., 3:] < 0.0, -quaternion, quaternion))
