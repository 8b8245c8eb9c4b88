"""Particles with given poses and weights, and scans for them."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import ArrayLike

from monoloc.likelihood.scan import Scan, uniform_scan
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.particles import Particles


def particles_at(poses: ArrayLike, log_scale: ArrayLike | None = None, weights: ArrayLike | None = None) -> Particles:
    """Particles at poses (N, 4, 4), of log-scale 0 and equal weights unless these are given, (N,) each."""
    poses = np.asarray(poses)
    count = len(poses)
    with np.errstate(divide="ignore"):
        return Particles(
            poses=poses,
            log_scale=np.zeros(count) if log_scale is None else np.asarray(log_scale, dtype=np.float64),
            log_weights=np.full(count, -np.log(count)) if weights is None else np.log(np.asarray(weights)),
        )


def scan_ahead(mixture: GaussianMixture, count: int, rng: np.random.Generator) -> Scan:
    """Points of the mixture that a camera at the origin can see: at least 20 cm before it."""
    points = mixture.sample(8 * count, rng)
    return uniform_scan(points[points[:, 2] > 0.2][:count].astype(np.float32))


# As a filter has them: of very different sizes, some of them zero.
weight_vectors = (
    arrays(np.float64, st.integers(1, 60), elements=st.floats(-40.0, 0.0))
    .map(np.exp)
    .flatmap(lambda w: arrays(np.bool_, len(w)).map(lambda zero, w=w: np.where(zero, 0.0, w)))
    .filter(lambda w: w.sum() > 0.0)
    .map(lambda w: w / w.sum())
)
