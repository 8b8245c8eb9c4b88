"""The networks that come with monoloc are what their catalogue says, and run and load as they should."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.depth.model_files import read_model, trainable_file
from monoloc.depth.models import DEFAULT, is_shipped, shipped_file, shipped_models
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.family import named_config
from monoloc.errors import DataError, SettingError
from synthetic_room import CAMERA, Room, RoomRecording, make_path

NAMES = ["full-0.35", "two-thirds-0.35", "one-third-0.35", "tiny-0.35"]
ALL_NAMES = [name + bits for name in NAMES for bits in ("", "-int8")]


def test_the_whole_family_is_shipped_in_both_precisions_under_six_megabytes() -> None:
    assert [model.name for model in shipped_models()] == NAMES
    assert is_shipped(DEFAULT)
    assert sum(shipped_file(name).stat().st_size for name in ALL_NAMES) < 6e6
    folder = shipped_file(DEFAULT).parent
    assert sorted(file.name for file in folder.glob("*.onnx")) == sorted(f"{name}.onnx" for name in ALL_NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_the_catalogue_says_what_the_files_are(name: str) -> None:
    entry = next(model for model in shipped_models() if model.name == name)
    network = load_network(shipped_file(name))
    assert network.config == named_config(name)
    assert entry.width == network.config.width
    assert entry.parameters == network.parameter_count()
    assert entry.macs == network.multiply_adds(entry.input_width, entry.input_height)
    assert entry.bytes_fp32 == shipped_file(name).stat().st_size
    assert entry.bytes_int8 == shipped_file(f"{name}-int8").stat().st_size
    # A quarter of the parameters' size would be exact were there no scales, names and last layers in 32 bits.
    assert entry.bytes_int8 < 0.4 * entry.bytes_fp32
    assert 0.4 < entry.delta1_int8 <= entry.delta1 + 0.02 and 0.15 < entry.absrel < 0.35


def test_smaller_networks_are_not_better_on_paper_than_they_are_large() -> None:
    macs = [model.macs for model in shipped_models()]
    assert macs == sorted(macs, reverse=True)


@pytest.mark.parametrize("name", NAMES)
def test_eight_bits_see_what_thirty_two_see(name: str) -> None:
    walk = RoomRecording(Room(), make_path(3), CAMERA)
    exact, small = (DepthPredictor(read_model(name + bits), CAMERA) for bits in ("", "-int8"))
    for index in range(len(walk)):
        one, other = exact(walk.color(index)), small(walk.color(index))
        difference = np.abs(np.log(one.depth_m / other.depth_m))
        # A painted room is far from what calibrated the network; on real rooms it is 3 % (see the report).
        assert difference.mean() < 0.1
        assert one.log_error is not None and other.log_error is not None
        assert np.abs(one.log_error - other.log_error).mean() < 0.3
        assert np.all((np.exp(one.log_error) > 0.01) & (np.exp(one.log_error) < 2.0))


def test_only_thirty_two_bits_can_be_tuned() -> None:
    for name in NAMES:
        assert trainable_file(name) == shipped_file(name)
        assert trainable_file(f"{name}-int8") is None


def test_a_file_in_eight_bits_can_only_be_run_whatever_it_is_called(tmp_path: Path) -> None:
    for bits in ("", "-int8"):
        file = tmp_path / f"mine{len(bits)}.onnx"
        file.write_bytes(shipped_file(f"tiny-0.35{bits}").read_bytes())
        assert trainable_file(file) == (None if bits else file)


def test_a_name_that_was_mistyped_is_answered_with_the_names() -> None:
    for look_up in (trainable_file, read_model):
        with pytest.raises(
            DataError, match=r"^one-thrid-0\.35: does not exist; give .*or one of full-0\.35, .*tiny-0\.35$"
        ):
            look_up("one-thrid-0.35")


@pytest.mark.parametrize("name", ["half-0.35", "full", "full-0.35-int4", "", str(Path("full-0.35.onnx"))])
def test_an_unknown_name_is_refused(name: str) -> None:
    assert not is_shipped(name)
    line = "choose one of full-0.35, two-thirds-0.35, one-third-0.35, tiny-0.35, or the same with -int8"
    with pytest.raises(SettingError, match=line):
        shipped_file(name)
