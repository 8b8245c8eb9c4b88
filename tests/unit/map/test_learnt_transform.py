"""The learnt transform without PyTorch: moments, its end at the room's border, and its recovery from two maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from map_helpers import make_mixture
from monoloc.map.learnt_transform import HIDDEN, LearntTransform
from monoloc.map.mixture import GaussianMixture


def bend(seed: int = 0, size_m: float = 0.1) -> LearntTransform:
    """Moves the points of a room of 4 m by about ``size_m``, smoothly."""
    rng = np.random.default_rng(seed)
    hidden = rng.uniform(-0.6, 0.6, (HIDDEN, 3)), rng.uniform(-0.6, 0.6, HIDDEN)
    return LearntTransform(np.zeros(3), 2.0, *hidden, size_m / 6.0 * rng.normal(size=(3, HIDDEN)), np.zeros(3))


def adapted_by(transform: LearntTransform, mixture: GaussianMixture) -> GaussianMixture:
    means, covariances = transform.moments(mixture.means, mixture.covariances)
    return GaussianMixture(mixture.weights, means, covariances)


def test_moments_are_those_of_transformed_points() -> None:
    mixture, transform = make_mixture(3), bend()
    means, covariances = transform.moments(mixture.means, mixture.covariances)
    rng = np.random.default_rng(1)
    for component in range(3):
        drawn = rng.multivariate_normal(mixture.means[component], mixture.covariances[component], 60_000)
        mapped = transform(drawn)
        assert np.linalg.norm(mapped.mean(axis=0) - drawn.mean(axis=0)) > 0.01
        np.testing.assert_allclose(means[component], mapped.mean(axis=0), atol=3e-3)
        np.testing.assert_allclose(covariances[component], np.cov(mapped.T), atol=1e-3)


def test_transform_is_recovered_from_the_maps_that_it_lies_between() -> None:
    mixture, transform = make_mixture(150), bend()
    recovered = LearntTransform.between(mixture, adapted_by(transform, mixture))
    points = mixture.sample(4000, np.random.default_rng(2))
    shift = np.linalg.norm(transform(points) - points, axis=1)
    error = np.linalg.norm(recovered(points) - transform(points), axis=1)
    assert np.median(shift) > 0.03
    assert np.median(error) < 0.05 * np.median(shift)


def test_displacement_ends_beyond_the_room() -> None:
    transform = bend()
    outward = np.outer([1.9, 2.5, 8.0], [1.0, 0.0, 0.0])
    shift = np.linalg.norm(transform(outward) - outward, axis=1)
    assert shift[0] > shift[1] > 0.0 and shift[2] < 1e-4 * shift[0]


def test_arrays_are_read_as_written() -> None:
    transform = bend()
    read = LearntTransform.from_arrays(transform.to_arrays("t_"), "t_")
    points = np.random.default_rng(3).uniform(-2.0, 2.0, (50, 3))
    assert read is not None
    np.testing.assert_allclose(read(points), transform(points), atol=1e-6)
    assert sum(array.nbytes for array in transform.to_arrays("t_").values()) == 4 * 903
    assert LearntTransform.from_arrays({}, "t_") is None


def test_invalid_values_are_refused() -> None:
    with pytest.raises(ValueError, match=r"output_bias must have shape \(3,\)"):
        replace(bend(), output_bias=np.zeros(2))
    with pytest.raises(ValueError, match="radius must be positive"):
        replace(bend(), radius=0.0)
    with pytest.raises(ValueError, match="same components"):
        LearntTransform.between(make_mixture(3), make_mixture(4))
