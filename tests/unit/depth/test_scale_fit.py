"""Scale and shift of a network's output, from known depth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.scale_fit import fit_to_depth, fitted_spec
from monoloc.depth.spec import DepthModel
from monoloc.errors import DataError
from onnx_networks import MIDAS, SCALE, SHIFT, error_at_95_percent, onnx_network, spec
from refusals import refuses
from synthetic_room import Room, RoomRecording, make_path


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(6))


def depths(count: int, seed: int) -> NDArray[np.float32]:
    return np.exp(np.random.default_rng(seed).uniform(np.log(0.5), np.log(6.0), count)).astype(np.float32)


@given(
    st.sampled_from(["depth", "disparity"]),
    st.floats(-3.0, 3.0).map(lambda power: 10.0**power),
    st.floats(-2.0, 2.0),
    st.floats(0.0, 0.3),
    st.integers(0, 100),
)
@settings(max_examples=25)
def test_scale_and_shift_are_recovered(
    output: str, scale: float, shift: float, wrong_share: float, seed: int
) -> None:
    """Under noise of 5 %, and with up to 30 % of the pixels wrong."""
    rng = np.random.default_rng(seed)
    truth = depths(3000, seed)
    seen = truth * np.exp(rng.normal(0.0, 0.05, len(truth)))
    wrong = rng.uniform(size=len(truth)) < wrong_share
    seen[wrong] = depths(int(wrong.sum()), seed + 1)
    raw = ((1.0 / seen if output == "disparity" else seen) - shift) / scale
    fitted = fitted_spec(spec(output=output), raw.astype(np.float32), truth, "another")
    predicted = fitted.depth(((1.0 / truth if output == "disparity" else truth) - shift).astype(np.float32) / scale)
    np.testing.assert_allclose(predicted, truth, rtol=0.06)
    if wrong_share == 0.0:
        assert fitted.scale == pytest.approx(scale, rel=0.03)
        assert fitted.shift == pytest.approx(shift, abs=0.05)


@given(
    st.sampled_from(["depth", "disparity", "log-depth"]),
    st.booleans(),
    st.floats(-2.0, 2.0).map(lambda power: 10.0**power),
    st.floats(0.0, 0.4),
    st.integers(0, 100),
)
@settings(max_examples=25)
def test_scale_of_a_metric_network_is_recovered(
    output: str, metric: bool, scale: float, wrong_share: float, seed: int
) -> None:
    """Also that of relative log-depth, whose shift is a scale."""
    metric = metric or output != "log-depth"
    rng = np.random.default_rng(seed)
    truth = depths(3000, seed)
    raw = {"depth": truth / scale, "disparity": 1.0 / (truth * scale), "log-depth": np.log(truth / scale)}[output]
    raw = raw.astype(np.float32)
    raw[rng.uniform(size=len(raw)) < 0.5 * wrong_share] = raw.max()
    raw[rng.uniform(size=len(raw)) < 0.5 * wrong_share] = raw.min()
    fitted = fitted_spec(spec(output=output, metric=metric), raw, truth, "another")
    assert fitted.scale == pytest.approx(scale, rel=0.02) and fitted.shift == 0.0
    assert fitted.is_usable


def test_fit_on_frames_recovers_scale_and_shift(recording: RoomRecording) -> None:
    """Through images and rays, for canonical depth, with holes in the true depth."""
    used = spec(width=None, height=None, focal_px=120.0)
    model = DepthModel(onnx_network(used, SCALE, SHIFT), used, "another")

    def with_holes(index: int) -> NDArray[np.float32]:
        depth = recording.depth(index).copy()
        depth[:, : 40 * index] = 0.0
        depth[0] = np.nan
        return depth

    done: list[int] = []
    fitted = fit_to_depth(model, recording, with_holes, done.append)
    assert done == list(range(1, 7))
    assert fitted.content == model.content and fitted.name == "another"
    prediction = DepthPredictor(fitted, recording.camera)(recording.color(3))
    assert error_at_95_percent(prediction, recording, 3) < 0.03


def fit_reversed(output: str, metric: bool) -> None:
    truth = depths(1000, 0)
    raw = truth if output == "disparity" else 1.0 / truth
    fitted_spec(spec(output=output, metric=metric), raw, truth, "another")


@pytest.mark.parametrize(
    ("fit", "message"),
    [
        (
            lambda: fit_reversed("depth", False),
            r'do not grow with depth \(fitted scale -.*\); write output = "disparity"',
        ),
        (lambda: fit_reversed("disparity", False), r'do not grow with disparity \(.*\); write output = "depth"'),
        (lambda: fit_reversed("depth", True), r"do not grow with depth \(correlation -1.00\)"),
        (lambda: fit_reversed("disparity", True), r"do not grow with disparity \(correlation -1.00\)"),
        (lambda: fitted_spec(MIDAS, np.full(500, 3.0), depths(500, 0), "another"), "gives the same value everywhere"),
        (
            lambda: fitted_spec(MIDAS, depths(9, 0), depths(9, 0), "another"),
            "a value at only 9 pixels of known depth",
        ),
        (lambda: fitted_spec(MIDAS, np.full(500, np.nan), depths(500, 0), "another"), "a value at only 0 pixels"),
        (
            lambda: fitted_spec(
                spec(output="depth", metric=True), np.linspace(-9, 1, 500), depths(500, 0), "another"
            ),
            "positive depth at only 10% of the pixels; check output",
        ),
    ],
)
def test_output_that_does_not_follow_depth_is_refused(fit: Callable[[], object], message: str):
    refuses(fit, DataError, "another: .*" + message)
