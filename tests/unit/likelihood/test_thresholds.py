"""Thresholds on the scan's likelihood."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.likelihood.thresholds import LikelihoodThresholds


def test_low_is_the_first_percentile_and_lost_as_far_below() -> None:
    thresholds = LikelihoodThresholds.from_log_likelihoods(np.linspace(-2.0, -1.0, 101))
    assert thresholds.low == pytest.approx(-1.99)
    assert thresholds.lost < thresholds.low
    assert thresholds.low - thresholds.lost == pytest.approx(-1.5 - thresholds.low)


def test_few_frames_have_a_least_range() -> None:
    thresholds = LikelihoodThresholds.from_log_likelihoods([1.0, 1.02])
    assert thresholds.low < 0.7 and thresholds.lost < 0.3
    wide = LikelihoodThresholds.from_log_likelihoods(np.linspace(0.0, 2.0, 5))  # as measured
    assert wide.low == pytest.approx(0.02)
    nine, ten = (LikelihoodThresholds.from_log_likelihoods(np.linspace(1.0, 1.02, count)) for count in (9, 10))
    assert nine.low == pytest.approx(1.01 - 0.4) and ten.low > 1.0


def test_no_value_is_below_the_thresholds_of_none() -> None:
    assert LikelihoodThresholds.none().lost == LikelihoodThresholds.none().low == -np.inf
