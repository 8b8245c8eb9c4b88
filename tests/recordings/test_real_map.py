"""A map of a real room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from map_helpers import nats_with_outliers
from monoloc.geometry import FloatArray
from monoloc.io.cloud_files import read_cloud
from monoloc.map.cloud import remove_outliers
from monoloc.map.em import fit_mixture

pytestmark = pytest.mark.data


@pytest.fixture(scope="module")
def cloud(data_root: Path) -> FloatArray:
    return read_cloud(data_root / "rgbd-scenes-v2" / "pc" / "03_ascii.ply")


def test_cloud_is_read_and_hardly_thinned(cloud: FloatArray) -> None:
    assert cloud.shape == (20510, 3)
    np.testing.assert_allclose(cloud[0], [-1.99979, -0.0612951, 1.12089])
    assert len(remove_outliers(cloud)) > 20_000


def test_mixture_explains_the_cloud_and_its_index_is_accurate(cloud: FloatArray) -> None:
    rng = np.random.default_rng(0)
    result = fit_mixture(cloud, 200, rng)
    history = np.array(result.log_likelihood_history)
    assert np.all(np.diff(history) >= -1e-9 * np.abs(history[:-1]))
    # A random start and few iterations give -1.3 nats a point; k-means++ and convergence about -0.9.
    assert history[-1] / len(cloud) > -1.0
    mixture = result.mixture
    points = mixture.sample(20_000, rng) + rng.normal(0.0, 0.05, (20_000, 3))
    exact, indexed = (
        nats_with_outliers(log_density, 0.1, mixture.volume_m3)
        for log_density in (mixture.log_density(points), mixture.index().log_density(points))
    )
    assert np.abs(indexed - exact).mean() <= 0.01 and np.abs(indexed - exact).max() <= 0.1
