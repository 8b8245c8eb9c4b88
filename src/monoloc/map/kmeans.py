"""k-means++ and a few Lloyd iterations, the initialisation of EM."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray

LLOYD_STEPS = 4  # EM refines the clusters; more steps did not raise its final likelihood
_CHUNK = 4096  # points per block, which bounds the memory of distances


def kmeans(points: FloatArray, clusters: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Cluster index of each point: (N, 3) -> (N,). Each cluster has at least one point; requires clusters <= N.

    k-means++ draws each initial centre with probability proportional to the squared distance to the nearest previous
    centre (Arthur and Vassilvitskii 2007).
    """
    centres = _initial_centres(points, clusters, rng)
    labels = nearest(points, centres)
    for _ in range(LLOYD_STEPS):
        counts = np.bincount(labels, minlength=clusters)
        sums = np.stack([np.bincount(labels, points[:, axis], clusters) for axis in range(3)], axis=1)
        centres = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], centres)
        labels = nearest(points, centres)
    return _fill_empty(labels, clusters)


def nearest(points: FloatArray, centres: FloatArray) -> NDArray[np.intp]:
    """Index of the nearest centre: (N, 3), (K, 3) -> (N,)."""
    labels = np.empty(len(points), dtype=np.intp)
    half_norms = 0.5 * (centres**2).sum(axis=1)
    for first in range(0, len(points), _CHUNK):
        chunk = points[first : first + _CHUNK]
        labels[first : first + _CHUNK] = np.argmin(half_norms - chunk @ centres.T, axis=1)
    return labels


def _initial_centres(points: FloatArray, clusters: int, rng: np.random.Generator) -> FloatArray:
    centres = np.empty((clusters, 3))
    centres[0] = points[rng.integers(len(points))]
    axes = np.ascontiguousarray(points.T)
    distances = np.full(len(points), np.inf)
    for k in range(1, clusters):
        x, y, z = axes - centres[k - 1][:, None]
        np.minimum(distances, x * x + y * y + z * z, out=distances)
        cumulated = np.cumsum(distances)
        # If each point coincides with a centre (duplicates), any point is valid.
        drawn = np.searchsorted(cumulated, rng.random() * cumulated[-1], side="right")
        centres[k] = points[min(int(drawn), len(points) - 1)]
    return centres


def _fill_empty(labels: NDArray[np.intp], clusters: int) -> NDArray[np.intp]:
    """Move a point of the largest cluster to each empty cluster."""
    counts = np.bincount(labels, minlength=clusters)
    for empty in np.flatnonzero(counts == 0):
        largest = int(np.argmax(counts))
        labels[np.flatnonzero(labels == largest)[0]] = empty
        counts[largest] -= 1
        counts[empty] += 1
    return labels
