"""Distances between clouds, and clouds of two maps to compare.

The cloud-to-cloud distance (C2C) is CloudCompare's: the distance from every point of the compared cloud to the
nearest point of the reference. Perpendicular to a surface it is the distance between surfaces. Along a surface it
shows a shift only up to the spacing of the points.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from monoloc.errors import MissingExtraError
from monoloc.geometry import FloatArray
from monoloc.map.arguments import float64
from monoloc.map.compare import compare_maps
from monoloc.map.mixture import GaussianMixture
from monoloc.map.surface import patch_offsets

COMPARED_POINTS = 50_000  # spaced about 2 cm in a room, finer than the motion due to adaptation


@dataclass(frozen=True)
class CloudDistance:
    """Summary of C2C distances in metres, named as in ``monoloc map compare --json``."""

    c2c_median_m: float
    c2c_p95_m: float
    c2c_max_m: float


@dataclass(frozen=True)
class MapClouds:
    """Clouds of a map before and after adaptation.

    Attributes:
        original, adapted: (N, 3) world frame, metres, see :func:`matched_clouds`.
        distances_m: (N,) distance from each original point to the nearest adapted point, metres.
        figures: named as in ``monoloc map compare --json``: number of points and of components, C2C, axis-aligned
            bounding boxes of the clouds in the world frame, and changes of the components. Empty of clouds that were
            read back to be drawn.
    """

    original: FloatArray
    adapted: FloatArray
    distances_m: FloatArray
    figures: dict[str, Any] = field(default_factory=dict)


def compare_clouds(
    original: GaussianMixture, adapted: GaussianMixture, count: int, rng: np.random.Generator
) -> MapClouds:
    """Compare the clouds of two maps with corresponding components.

    Args:
        original, adapted: maps of K components each, world frame.
        count: number N of points to draw.
        rng: source of the random numbers.

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
    """Exact distance from every point to the nearest point of a reference cloud: (N, 3), (M, 3) -> (N,), metres.

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
    """Draw clouds from two maps with corresponding components; their points correspond index by index.

    Points are drawn from the original map's patches, see :mod:`monoloc.map.surface`.
    The optimal transport map from a component's Gaussian to the adapted one moves each point:
    ``x -> mu_A + A (x - mu)`` with ``A = S^-1/2 (S^1/2 S_A S^1/2)^1/2 S^-1/2`` (Olkin and Pukelsheim 1982). So an
    unchanged map has distance zero, whereas two independent samples would not.

    Args:
        original, adapted: maps of K components each, world frame.
        count: number N of points to draw.
        rng: source of the random numbers.

    Returns:
        Original and adapted cloud, (N, 3) each, world frame, metres.

    Raises:
        ValueError: the maps have different numbers of components.
    """
    if len(original) != len(adapted):
        raise ValueError(f"maps must have the same components, got {len(original)} and {len(adapted)}")
    component, offsets = patch_offsets(original, count, rng)
    root = _symmetric_power(original.covariances, 0.5)
    inverse_root = _symmetric_power(original.covariances, -0.5)
    motion = inverse_root @ _symmetric_power(root @ adapted.covariances @ root, 0.5) @ inverse_root
    return (
        original.means[component] + offsets,
        adapted.means[component] + np.einsum("nij,nj->ni", motion[component], offsets),
    )


def _symmetric_power(matrices: FloatArray, power: float) -> FloatArray:
    """Power of symmetric positive definite matrices, (K, 3, 3) -> (K, 3, 3)."""
    values, axes = np.linalg.eigh(matrices)
    return np.asarray((axes * values[:, None, :] ** power) @ axes.swapaxes(-1, -2))
