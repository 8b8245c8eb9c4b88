"""Changes between an original and an adapted map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from map_helpers import make_mixture
from monoloc.map.compare import compare_maps


def test_identical_maps_show_no_change() -> None:
    change = compare_maps(make_mixture(40), make_mixture(40))
    assert change.shift_median_m == change.shift_p95_m == 0.0
    assert change.correspondence_share == 1.0 and change.size_ratio_median == pytest.approx(1.0)


@given(st.integers(0, 1000), st.floats(0.0, 1.0), st.floats(0.5, 2.0))
@settings(max_examples=20)
def test_change_is_that_of_its_definition(seed: int, sd_m: float, factor: float) -> None:
    original, rng = make_mixture(60), np.random.default_rng(seed)
    moved = original.means + rng.normal(0.0, sd_m, original.means.shape)
    adapted = replace(original, means=moved, covariances=original.covariances * factor**2)
    change = compare_maps(original, adapted)
    nearest = cKDTree(moved).query(original.means)[1]
    assert change.correspondence_share == pytest.approx(np.mean(nearest == np.arange(60)))
    shift = np.linalg.norm(moved - original.means, axis=1)
    assert change.shift_median_m == pytest.approx(np.median(shift))
    assert change.shift_p95_m == pytest.approx(np.percentile(shift, 95.0))
    assert change.size_ratio_median == pytest.approx(factor)


def test_swapped_components_lower_the_correspondence() -> None:
    original = make_mixture(30)
    order = np.arange(30)
    order[:6] = order[:6][::-1]
    swapped = replace(original, means=original.means[order])
    assert compare_maps(original, swapped).correspondence_share == pytest.approx(24 / 30)


def test_maps_of_different_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match="maps must have the same components, got 3 and 4"):
        compare_maps(make_mixture(3), make_mixture(4))
