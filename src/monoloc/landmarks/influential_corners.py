"""How well landmarks determine a pose if the corners on which it rests most are wrong matches.

One corner of a room often has several landmarks, one a scale, and they are matched wrongly together. So thirty
landmarks may be no more than seven corners. If the right ones lie on a distant picture, which hardly determines the
pose, then three wrong ones beside it do, and the stated covariance believes them. Leaving out the most influential
observations shows on how many a fit rests (Belsley, Kuh and Welsch, *Regression Diagnostics*, 1980).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, invert, ray_twist_jacobian, transform
from monoloc.landmarks.pnp import LandmarkPose

_CORNER_RAD = 0.03  # within which landmarks are of one corner: about 10 px of the images in which they are found
_LEFT_OUT, _LEAST_CORNERS = 4, 3  # corners that are left out, and that must be left
# Corners below which a share of the landmarks in view must agree. What repeats, such as the keys of a keyboard,
# agrees with wrong poses by chance: in mirrored images at up to 15 corners and 1.9 % of the landmarks in view.
_MANY_CORNERS, _LEAST_FOUND = 16, 0.02
_LEAST_INFORMATION = 1e-3  # of a twist, in m^-2 and rad^-2, so that every sum can be inverted
_LEAST_VARIANCE = 1e-12  # of a ray, so that a pose may be stated as exact


def sd_without_influential_corners(place: LandmarkPose) -> float:
    """Largest standard deviation of the position, m, without the four corners on which the pose rests most.

    The landmarks of one corner count as one. Each time, the corner with the greatest leverage of those left goes.

    Returns:
        Infinity where fewer than three corners would be left.
    """
    local = transform(invert(place.pose), place.points)
    corner_of = corners_of(local)
    sizes = np.bincount(corner_of)
    if len(sizes) < _LEFT_OUT + _LEAST_CORNERS:
        return math.inf
    information = _information(local)
    # Of a ray, as the covariance says.
    variance = max(_LEAST_VARIANCE, float(np.trace(place.covariance @ information.sum(axis=0))) / 6.0)
    corners = np.zeros((len(sizes), 6, 6))
    np.add.at(corners, corner_of, information / (variance * sizes[corner_of, None, None]))
    for _ in range(_LEFT_OUT):
        leverages = np.einsum("cij,ij->c", corners, _covariance(corners))
        corners = np.delete(corners, leverages.argmax(), axis=0)
    return float(np.sqrt(np.linalg.eigvalsh(_covariance(corners)[:3, :3])[-1]))


def are_few_of_many(local: FloatArray, in_view: int) -> bool:
    """Whether landmarks (N, 3) in the camera's frame are at few corners, and few of those that should be in view."""
    return len(local) < _LEAST_FOUND * in_view and int(corners_of(local).max(initial=-1)) + 1 < _MANY_CORNERS


def corners_of(local: FloatArray) -> NDArray[np.int64]:
    """The corner that each of N points belongs to, (N,) from 0 on, by their directions in the camera's frame."""
    rays = local / np.linalg.norm(local, axis=1, keepdims=True)
    corner_of, corner, left = np.zeros(len(rays), dtype=np.int64), 0, np.arange(len(rays))
    while len(left) > 0:
        is_near = np.linalg.norm(rays[left] - rays[left[0]], axis=1) < _CORNER_RAD
        corner_of[left[is_near]] = corner
        corner, left = corner + 1, left[~is_near]
    return corner_of


def _information(local: FloatArray) -> FloatArray:
    """Of the camera's twist, by each of N points in its frame, (N, 6, 6), if its ray has a deviation of 1."""
    by_twist = ray_twist_jacobian(local)
    return np.asarray(by_twist.transpose(0, 2, 1) @ by_twist)


def _covariance(information: FloatArray) -> FloatArray:
    """Of a twist, (6, 6), by the sum of information (N, 6, 6)."""
    return np.asarray(np.linalg.inv(information.sum(axis=0) + _LEAST_INFORMATION * np.eye(6)))
