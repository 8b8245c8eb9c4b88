"""Clouds compared: how far the points of one lie from another, and the clouds of two maps to do it with.

The cloud-to-cloud distance (C2C) is CloudCompare's: from every point of the compared cloud to the nearest point of
the reference. Across a surface it is the distance between surfaces; along it, it can only see a shift up to the
spacing of the points.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from monoloc.errors import MissingExtraError
from monoloc.geometry import FloatArray
from monoloc.map.arguments import float64
from monoloc.map.compare import compare_maps
from monoloc.map.mixture import GaussianMixture

COMPARED_POINTS = 50_000  # 2 cm apart in a room: finer than what adaptation moves


@dataclass(frozen=True)
class CloudDistance:
    """C2C in a few numbers, as ``monoloc map compare --json`` names them, metres."""

    c2c_median_m: float
    c2c_p95_m: float
    c2c_max_m: float


@dataclass(frozen=True)
class MapClouds:
    """A map before and after adaptation, as clouds.

    Attributes:
        original, adapted: (N, 3) world frame, metres, see :func:`matched_clouds`.
        distances_m: (N,) from points of the original to the nearest adapted one.
        figures: as ``monoloc map compare --json`` names them: number of points and of components, C2C, the clouds'
            boxes along the world's axes, and what the components did.
    """

    original: FloatArray
    adapted: FloatArray
    distances_m: FloatArray
    figures: dict[str, Any]


def compare_clouds(
    original: GaussianMixture, adapted: GaussianMixture, count: int, rng: np.random.Generator
) -> MapClouds:
    """The clouds of two maps whose components correspond, held against one another.

    Args:
        original, adapted: K components each, world frame.
        count: N, points to draw.

    Raises:
        MissingExtraError, ValueError: as :func:`cloud_distances` and :func:`matched_clouds`.
    """
    clouds = matched_clouds(original, adapted, count, rng)
    distances_m = cloud_distances(*clouds)
    boxes = [{"lower": cloud.min(axis=0).tolist(), "upper": cloud.max(axis=0).tolist()} for cloud in clouds]
    figures = {
        "points": count,
        **asdict(summarise_distances(distances_m)),
        "box_original_m": boxes[0],
        "box_adapted_m": boxes[1],
        "components": len(original),
        **asdict(compare_maps(original, adapted)),
    }
    return MapClouds(*clouds, distances_m, figures)


def cloud_distances(points: ArrayLike, reference: ArrayLike) -> FloatArray:
    """Distance from every point to the nearest of a reference cloud, exact: (N, 3), (M, 3) -> (N,), metres.

    Raises:
        MissingExtraError: SciPy is not installed.
        ValueError: wrong shapes, values that are not finite, or an empty reference.
    """
    try:
        from scipy.spatial import cKDTree
    except ImportError as error:
        raise MissingExtraError("comparing clouds", "report") from error
    cloud, others = float64("points", points, None, 3), float64("reference", reference, None, 3)
    if len(others) == 0:
        raise ValueError("reference must have at least one point, got shape (0, 3)")
    return np.asarray(cKDTree(others).query(cloud)[0])


def summarise_distances(distances_m: FloatArray) -> CloudDistance:
    """Median, 95th percentile and maximum of distances (N,), N >= 1."""
    median, p95, largest = np.percentile(distances_m, [50.0, 95.0, 100.0])
    return CloudDistance(float(median), float(p95), float(largest))


def matched_clouds(
    original: GaussianMixture, adapted: GaussianMixture, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Clouds of two maps whose components correspond, point n of one being where point n of the other went.

    Points are drawn from the original, evenly from a box along each component's axes that has its mean and
    covariance: a component stands for a patch of surface, and a Gaussian's tails would reach far beyond the room.
    Each point is moved by the map that takes its component's Gaussian to the adapted one with the least motion,
    ``x -> mu_A + A (x - mu)`` with ``A = S^-1/2 (S^1/2 S_A S^1/2)^1/2 S^-1/2`` (Olkin and Pukelsheim 1982). So a map
    that did not change has a distance of zero, not that of two independent samples.

    Args:
        original, adapted: K components each, world frame.
        count: N, points to draw.

    Returns:
        Original and adapted cloud, (N, 3) each, world frame, metres.

    Raises:
        ValueError: not equally many components.
    """
    if len(original) != len(adapted):
        raise ValueError(f"maps must have the same components, got {len(original)} and {len(adapted)}")
    component = rng.choice(len(original), size=count, p=original.weights / original.weights.sum())
    root = _symmetric_power(original.covariances, 0.5)
    inverse_root = _symmetric_power(original.covariances, -0.5)
    motion = inverse_root @ _symmetric_power(root @ adapted.covariances @ root, 0.5) @ inverse_root
    variances, axes = np.linalg.eigh(original.covariances)
    within = rng.uniform(-np.sqrt(3.0), np.sqrt(3.0), (count, 3)) * np.sqrt(variances[component])
    offsets = np.einsum("nij,nj->ni", axes[component], within)
    return (
        original.means[component] + offsets,
        adapted.means[component] + np.einsum("nij,nj->ni", motion[component], offsets),
    )


def _symmetric_power(matrices: FloatArray, power: float) -> FloatArray:
    """Power of symmetric positive definite matrices, (K, 3, 3) -> (K, 3, 3)."""
    values, axes = np.linalg.eigh(matrices)
    return np.asarray((axes * values[:, None, :] ** power) @ axes.swapaxes(-1, -2))
