"""Networks in 8 bits: how little they differ, that they repeat, and what cannot be quantised."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray

from depth_helpers import TINY, lively_export, random_image, run_onnx, smooth_images
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.session import load_session
from monoloc.depth.spec import DepthModel, monoloc_spec
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.quantise import QuantisationReport, quantise
from monoloc.errors import DataError, SettingError

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def lively() -> tuple[DepthNetwork, bytes]:
    return lively_export()


@pytest.fixture(scope="module")
def quantised(lively: tuple[DepthNetwork, bytes]) -> tuple[bytes, QuantisationReport]:
    return quantise(lively[1], smooth_images(12))


def outputs(content: bytes, images: Sequence[NDArray[np.float32]], name: str = "log_depth") -> NDArray[np.float32]:
    session = load_session(content, "network")
    return np.concatenate([np.asarray(session.run([name], {"image": image})[0]) for image in images])


def test_eight_bits_differ_little_and_without_bias(
    lively: tuple[DepthNetwork, bytes], quantised: tuple[bytes, QuantisationReport]
) -> None:
    content, images = lively[1], smooth_images(12)
    small, report = quantised
    assert report.bytes == len(small) < 0.4 * len(content)
    # Every other image calibrates; on those the last bias compensates for the mean shift of rounding.
    shift = outputs(small, images[::2]) - outputs(content, images[::2])
    assert abs(float(shift.mean())) < 1e-5
    others = np.abs(outputs(small, images[1::2]) - outputs(content, images[1::2]))
    assert report.difference_mean == pytest.approx(float(others.mean()), rel=1e-5)
    assert report.difference_max == pytest.approx(float(others.max()), rel=1e-5)
    for name in ("log_depth", "log_error_scale"):
        exact = outputs(content, images[1::2], name)
        assert np.abs(outputs(small, images[1::2], name) - exact).mean() < 0.2 * exact.std()


def test_quantised_file_has_the_original_s_metadata_inputs_and_outputs(
    lively: tuple[DepthNetwork, bytes], quantised: tuple[bytes, QuantisationReport]
) -> None:
    small = quantised[0]
    before, after = onnx.load_from_string(lively[1]), onnx.load_from_string(small)
    assert {e.key: e.value for e in after.metadata_props} == {e.key: e.value for e in before.metadata_props}
    assert [value.name for value in after.graph.input] == ["image"]
    assert [value.name for value in after.graph.output] == ["log_depth", "log_error_scale"]
    # Only the convolutions of the heads remain in 32 bits.
    assert [node.op_type for node in after.graph.node].count("Conv") == 2
    onnx.checker.check_model(after)
    # Any image size.
    other = smooth_images(1, height=96, width=32)[0]
    assert run_onnx(small, other).shape == (1, 1, 24, 8)
    camera = Camera(192, 128, 95.0, 93.0, 93.0, 66.0)
    prediction = DepthPredictor(DepthModel(small, monoloc_spec(TINY.focal_px)), camera)(random_image(128, 192))
    assert prediction.depth_m.shape == (16, 24) and (prediction.depth_m > 0.0).all()


@pytest.mark.slow
def test_quantising_repeats_and_prints_nothing(
    lively: tuple[DepthNetwork, bytes],
    quantised: tuple[bytes, QuantisationReport],
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Standard output belongs to --json, and a library's remarks on its own graph concern nobody."""
    assert quantise(lively[1], smooth_images(12))[0] == quantised[0]
    assert capfd.readouterr().out == ""
    assert [record.getMessage() for record in caplog.records] == []


def test_network_in_8_bits_is_not_quantised_again(quantised: tuple[bytes, QuantisationReport]) -> None:
    with pytest.raises(DataError, match=r"^network: is in 8 bits already; give it as it was before"):
        quantise(quantised[0], smooth_images(10))


def test_too_few_images_are_refused(lively: tuple[DepthNetwork, bytes]) -> None:
    with pytest.raises(SettingError, match=r"^int8: has 9 frames; calibrate on at least 10$"):
        quantise(lively[1], smooth_images(9))
