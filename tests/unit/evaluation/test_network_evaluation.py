"""A network's figures on a recording with depth: which pixels and frames count."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.bundle import read_network
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import DepthModel
from monoloc.errors import DataError
from monoloc.evaluation.network_evaluation import evaluate_network
from onnx_networks import onnx_network, spec
from refusals import refuses_data
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

# Disparity below the shift is no depth: this network predicts near surfaces only.
NEAR_ONLY = spec(scale=1.0, shift=-0.4)


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(4), SMALL_CAMERA)


@pytest.fixture(scope="module")
def predictor() -> DepthPredictor:
    return DepthPredictor(DepthModel(onnx_network(NEAR_ONLY), NEAR_ONLY, "near"), SMALL_CAMERA)


def test_predicted_share_is_that_of_pixels_with_both_depths(
    predictor: DepthPredictor, recording: RoomRecording
) -> None:
    result = evaluate_network(predictor, recording)
    near = np.mean([1.0 / recording.depth(index) > 0.41 for index in range(4)])  # the rest is beyond 100 m
    assert result.predicted_share == pytest.approx(near, abs=0.03)
    assert result.evaluated == [0, 1, 2, 3]
    assert result.calibration is None


def test_frames_without_a_pixel_that_has_both_depths_are_not_judged(
    predictor: DepthPredictor, recording: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    depth = recording.depth

    def far_only(index: int) -> np.ndarray:
        return np.where(depth(index) > 3.0, depth(index), np.float32(0.0)) if index == 0 else depth(index)

    monkeypatch.setattr(recording, "depth", far_only)
    assert evaluate_network(predictor, recording).evaluated == [1, 2, 3]


def test_network_without_depth_at_known_pixels_is_refused(recording: RoomRecording) -> None:
    none = spec(scale=1.0, shift=-9.0)
    predictor = DepthPredictor(DepthModel(onnx_network(none), none, "none"), SMALL_CAMERA)
    with pytest.raises(DataError, match="none: gives no depth at any pixel of known depth; "):
        evaluate_network(predictor, recording)


def test_a_recording_without_known_depth_is_refused(
    recording: RoomRecording, predictor: DepthPredictor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "depth", lambda index: np.zeros((SMALL_CAMERA.height, SMALL_CAMERA.width)))
    refuses_data(lambda: evaluate_network(predictor, recording), recording.name, "has no depth at any pixel", "check")


def test_depth_at_a_few_pixels_is_compared_without_a_calibration(
    recording: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a sparse lidar gives it: smaller images of the network hold hardly a pixel that has depth."""
    depth = recording.depth

    def sparse(index: int) -> np.ndarray:
        kept = np.zeros_like(depth(index))
        kept[::20, ::40] = depth(index)[::20, ::40]
        return kept

    monkeypatch.setattr(recording, "depth", sparse)
    result = evaluate_network(DepthPredictor(read_network("tiny-0.35"), SMALL_CAMERA), recording)
    assert result.evaluated == [0, 1, 2, 3] and result.calibration is None
