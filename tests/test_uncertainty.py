"""Whether a network knows how wrong it is: errors drawn from what it states, and from something else."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import laplace

from monoloc.errors import DataError
from monoloc.evaluation.uncertainty import ErrorCalibration, error_calibration
from monoloc.viz.calibration_plot import plot_calibration

FloatArray = NDArray[np.float64]

PIXELS = 40_000


def drawn(seed: int = 0, spread: float = 0.8, count: int = PIXELS) -> tuple[FloatArray, FloatArray]:
    """Errors, and the log of the Laplace scales that they are drawn from."""
    rng = np.random.default_rng(seed)
    log_scale = rng.normal(np.log(0.1), spread, count)
    return rng.laplace(scale=np.exp(log_scale)), log_scale


@pytest.mark.parametrize("spread", [0.0, 0.8])
def test_errors_as_stated_are_covered_as_stated(spread: float) -> None:
    """Within four standard errors of a share, and of a mean of exponential values, whose spread is their mean."""
    error, log_scale = drawn(spread=spread)
    found = error_calibration(error, log_scale)
    p = found.confidence
    assert 0.0 < p.min() <= 0.05 and 0.95 <= p.max() < 1.0 and (np.diff(p) > 0.0).all()
    assert (np.abs(found.coverage - p) < 4.0 * np.sqrt(p * (1.0 - p) / PIXELS)).all()
    np.testing.assert_allclose(found.actual, found.stated, rtol=4.0 / np.sqrt(PIXELS / 10) * (1.0 + spread))
    assert (np.diff(found.stated) >= 0.0).all()  # most certain first


def test_coverage_is_that_of_scipys_intervals() -> None:
    error, log_scale = drawn()
    log_scale = log_scale + 0.5  # stated wrong, so that the shares are not the confidences
    found = error_calibration(error, log_scale)
    for p, covered in zip(found.confidence, found.coverage, strict=True):
        low, high = laplace.interval(p, scale=np.exp(log_scale))
        assert covered == pytest.approx(np.mean((low <= error) & (error <= high)), abs=1e-12)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_too_much_and_too_little_confidence_show(factor: float) -> None:
    error, log_scale = drawn()
    found = error_calibration(error, log_scale + np.log(factor))
    np.testing.assert_allclose(found.stated / found.actual, factor, rtol=0.15)
    assert ((found.coverage > found.confidence) == (factor > 1.0)).all()
    assert found.nll > error_calibration(error, log_scale).nll + 0.1


@given(st.integers(0, 1000), st.floats(-1.0, 1.0))
@settings(max_examples=15)
def test_nll_is_scipys(seed: int, offset: float) -> None:
    error, log_scale = drawn(seed, count=200)
    log_scale = log_scale + offset
    found = error_calibration(error, log_scale)
    assert found.nll == pytest.approx(-laplace.logpdf(error, scale=np.exp(log_scale)).mean(), rel=1e-9)
    # The one scale that suits all best is the one that SciPy fits.
    _, scale = laplace.fit(error, floc=0.0)
    assert found.nll_constant == pytest.approx(-laplace.logpdf(error, scale=scale).mean(), rel=1e-9)


def test_knowing_pays_where_errors_differ_and_not_where_they_do_not() -> None:
    varied = error_calibration(*drawn())
    # By the gap between the logarithm of the mean scale and the mean of its logarithm: half the latter's variance.
    assert varied.nll_constant - varied.nll == pytest.approx(0.5 * 0.8**2, abs=0.05)
    error, _ = drawn(spread=0.0)
    best = np.full(PIXELS, np.log(np.abs(error).mean()))
    constant = error_calibration(error, best)
    assert constant.nll == pytest.approx(constant.nll_constant, rel=1e-9)


@given(st.integers(0, 1000))
@settings(max_examples=10)
def test_the_sign_of_errors_and_their_order_do_not_matter(seed: int) -> None:
    error, log_scale = drawn(seed, count=300)
    order = np.random.default_rng(seed).permutation(300)
    one, other = error_calibration(error, log_scale), error_calibration(-error[order], log_scale[order])
    for name in ("stated", "actual", "coverage", "nll", "nll_constant"):
        np.testing.assert_allclose(getattr(other, name), getattr(one, name), rtol=1e-12)


def test_bins_hold_equally_many_pixels() -> None:
    """Ten of one each: sorted by what is stated."""
    log_scale = np.log(np.array([0.3, 0.1, 0.2, 0.5, 0.4, 0.7, 0.6, 1.0, 0.9, 0.8]))
    found = error_calibration(np.arange(10.0), log_scale)
    np.testing.assert_allclose(found.stated, 0.1 * np.arange(1, 11))
    np.testing.assert_array_equal(found.actual, [1, 2, 0, 4, 3, 6, 5, 9, 8, 7])


def test_a_network_without_error_has_a_finite_figure() -> None:
    found = error_calibration(np.zeros(20), np.full(20, -2.0))
    assert np.isfinite(found.nll_constant) and (found.coverage == 1.0).all()


# --- Errors and pictures ---


@pytest.mark.parametrize(
    ("error", "log_scale", "shapes"),
    [
        (np.zeros(20), np.zeros(19), r"\(20,\) and \(19,\)"),
        (np.zeros((4, 5)), np.zeros((4, 5)), r"\(4, 5\) and \(4, 5\)"),
        (np.zeros(9), np.zeros(9), r"\(9,\) and \(9,\)"),
    ],
)
def test_shapes_that_do_not_fit(error: FloatArray, log_scale: FloatArray, shapes: str) -> None:
    with pytest.raises(ValueError, match=rf"need two arrays \(N,\), N >= 10, got {shapes}"):
        error_calibration(error, log_scale)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("which", [0, 1])
def test_values_that_are_no_numbers(value: float, which: int) -> None:
    arrays = [np.zeros(20), np.zeros(20)]
    arrays[which][3] = value
    with pytest.raises(ValueError, match="errors and scales must be finite"):
        error_calibration(*arrays)


@pytest.fixture(scope="module")
def calibrations() -> dict[str, ErrorCalibration]:
    error, log_scale = drawn(count=2000)
    return {"as stated": error_calibration(error, log_scale), "too sure": error_calibration(error, log_scale - 0.7)}


def test_calibrations_are_drawn(tmp_path: Path, calibrations: dict[str, ErrorCalibration]) -> None:
    plot_calibration(tmp_path / "calibration.png", calibrations)
    image = cv2.imread(str(tmp_path / "calibration.png"))
    assert image is not None and image.shape[0] >= 400 and image.shape[1] >= 900
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20
    assert [path.name for path in tmp_path.iterdir()] == ["calibration.png"]


def test_a_picture_that_cannot_be_written(tmp_path: Path, calibrations: dict[str, ErrorCalibration]) -> None:
    with pytest.raises(DataError, match=r"calibration\.png: cannot be written"):
        plot_calibration(tmp_path / "absent" / "calibration.png", calibrations)
