"""Calibration of stated errors: errors drawn from the stated distribution, and from another."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import laplace

from monoloc.evaluation.uncertainty import error_calibration

FloatArray = NDArray[np.float64]

PIXELS = 40_000


def draw(seed: int = 0, spread: float = 0.8, count: int = PIXELS) -> tuple[FloatArray, FloatArray]:
    """Errors, and the log of the Laplace scales that they were drawn from."""
    rng = np.random.default_rng(seed)
    log_scale = rng.normal(np.log(0.1), spread, count)
    return rng.laplace(scale=np.exp(log_scale)), log_scale


@pytest.mark.parametrize("spread", [0.0, 0.8])
def test_coverage_of_errors_as_stated_is_the_confidence(spread: float) -> None:
    """Within four standard errors of a share, and of a mean of exponential values, whose spread is their mean."""
    error, log_scale = draw(spread=spread)
    calibration = error_calibration(error, log_scale)
    p = calibration.confidence
    assert 0.0 < p.min() <= 0.05 and 0.95 <= p.max() < 1.0 and (np.diff(p) > 0.0).all()
    assert (np.abs(calibration.coverage - p) < 4.0 * np.sqrt(p * (1.0 - p) / PIXELS)).all()
    np.testing.assert_allclose(
        calibration.actual, calibration.stated, rtol=4.0 / np.sqrt(PIXELS / 10) * (1.0 + spread)
    )
    assert (np.diff(calibration.stated) >= 0.0).all()  # most certain first


def test_coverage_equals_that_of_scipys_intervals() -> None:
    error, log_scale = draw()
    log_scale = log_scale + 0.5  # wrong, so that coverage is not the confidence
    calibration = error_calibration(error, log_scale)
    for p, covered in zip(calibration.confidence, calibration.coverage, strict=True):
        low, high = laplace.interval(p, scale=np.exp(log_scale))
        assert covered == pytest.approx(np.mean((low <= error) & (error <= high)), abs=1e-12)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_overconfidence_and_underconfidence_show(factor: float) -> None:
    error, log_scale = draw()
    calibration = error_calibration(error, log_scale + np.log(factor))
    np.testing.assert_allclose(calibration.stated / calibration.actual, factor, rtol=0.15)
    assert ((calibration.coverage > calibration.confidence) == (factor > 1.0)).all()
    assert calibration.nll > error_calibration(error, log_scale).nll + 0.1


@given(st.integers(0, 1000), st.floats(-1.0, 1.0))
@settings(max_examples=15)
def test_nll_equals_scipys(seed: int, offset: float) -> None:
    error, log_scale = draw(seed, count=200)
    log_scale = log_scale + offset
    calibration = error_calibration(error, log_scale)
    assert calibration.nll == pytest.approx(-laplace.logpdf(error, scale=np.exp(log_scale)).mean(), rel=1e-9)
    # The best single scale is the one that SciPy fits.
    _, scale = laplace.fit(error, floc=0.0)
    assert calibration.nll_constant == pytest.approx(-laplace.logpdf(error, scale=scale).mean(), rel=1e-9)


def test_stated_errors_lower_the_nll_only_where_errors_differ() -> None:
    varied = error_calibration(*draw())
    # By the logarithm of the mean scale less the mean of its logarithm: half the latter's variance.
    assert varied.nll_constant - varied.nll == pytest.approx(0.5 * 0.8**2, abs=0.05)
    error, _ = draw(spread=0.0)
    best = np.full(PIXELS, np.log(np.abs(error).mean()))
    constant = error_calibration(error, best)
    assert constant.nll == pytest.approx(constant.nll_constant, rel=1e-9)


@given(st.integers(0, 1000))
@settings(max_examples=10)
def test_sign_and_order_of_errors_do_not_matter(seed: int) -> None:
    error, log_scale = draw(seed, count=300)
    order = np.random.default_rng(seed).permutation(300)
    one, other = error_calibration(error, log_scale), error_calibration(-error[order], log_scale[order])
    for name in ("stated", "actual", "coverage", "nll", "nll_constant"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-12)


def test_bins_hold_equally_many_pixels() -> None:
    """Ten bins of one pixel, sorted by the stated error."""
    log_scale = np.log(np.array([0.3, 0.1, 0.2, 0.5, 0.4, 0.7, 0.6, 1.0, 0.9, 0.8]))
    calibration = error_calibration(np.arange(10.0), log_scale)
    np.testing.assert_allclose(calibration.stated, 0.1 * np.arange(1, 11))
    np.testing.assert_array_equal(calibration.actual, [1, 2, 0, 4, 3, 6, 5, 9, 8, 7])


def test_nll_without_any_error_is_finite() -> None:
    calibration = error_calibration(np.zeros(20), np.full(20, -2.0))
    assert np.isfinite(calibration.nll_constant) and (calibration.coverage == 1.0).all()


@pytest.mark.parametrize(
    ("error", "log_scale", "shapes"),
    [
        (np.zeros(20), np.zeros(19), r"\(20,\) and \(19,\)"),
        (np.zeros((4, 5)), np.zeros((4, 5)), r"\(4, 5\) and \(4, 5\)"),
        (np.zeros(9), np.zeros(9), r"\(9,\) and \(9,\)"),
    ],
)
def test_arrays_of_wrong_shape_are_refused(error: FloatArray, log_scale: FloatArray, shapes: str) -> None:
    with pytest.raises(ValueError, match=rf"need two arrays \(N,\), N >= 10, got {shapes}"):
        error_calibration(error, log_scale)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("which", [0, 1])
def test_values_that_are_not_finite_are_refused(value: float, which: int) -> None:
    arrays = [np.zeros(20), np.zeros(20)]
    arrays[which][3] = value
    with pytest.raises(ValueError, match="errors and scales must be finite"):
        error_calibration(*arrays)
