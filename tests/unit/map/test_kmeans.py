"""The start of expectation maximisation."""

from __future__ import annotations

import numpy as np

from monoloc.map.kmeans import kmeans


def test_kmeans_leaves_no_cluster_empty() -> None:
    points = np.repeat(np.eye(3), 10, axis=0)
    labels = kmeans(points, 12, np.random.default_rng(0))
    assert np.bincount(labels, minlength=12).min() >= 1
