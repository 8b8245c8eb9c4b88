"""Depth networks by name or file: what describes itself, what a TOML describes, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import onnx
import pytest
from onnx import TensorProto

from monoloc.bundle import read_network
from monoloc.depth.model_files import read_model, trainable_file
from monoloc.depth.models import DEFAULT, shipped_file
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import DepthModel, ModelSpec
from monoloc.errors import BundleError, DataError
from onnx_networks import IMAGE, MIDAS, SCALE, SHIFT, onnx_network, spec, takes, toml_of, write_network
from refusals import refuses
from repository import REPOSITORY
from synthetic_room import CAMERA, depth_from_blue


def test_description_and_network_are_read(tmp_path: Path) -> None:
    used = spec(scale=SCALE, shift=SHIFT, channels="bgr", layout="nhwc")
    content = onnx_network(used, SCALE, SHIFT)
    model = read_model(write_network(tmp_path, used, content))
    assert model == DepthModel(content, used, "another")


def test_description_in_the_documentation_is_valid_and_complete(tmp_path: Path) -> None:
    text = (REPOSITORY / "docs" / "how-to" / "another-depth-network.md").read_text()
    toml = text.split("```toml\n")[1].split("```")[0]
    (tmp_path / "midas.toml").write_text(toml)
    used = spec(width=256, height=256)
    (tmp_path / "midas-small.onnx").write_bytes(onnx_network(used))
    assert read_model(tmp_path / "midas.toml") == DepthModel(onnx_network(used), used, "midas")
    for field in (*ModelSpec.model_fields, "file"):
        assert f"`{field}`" in text, field


def test_own_networks_describe_themselves(tmp_path: Path) -> None:
    (tmp_path / "mine.onnx").write_bytes(depth_from_blue().content)
    mine = read_model(tmp_path / "mine.onnx")
    assert mine.content == depth_from_blue().content and mine.spec == depth_from_blue().spec and mine.name == "mine"
    shipped = read_model(DEFAULT)
    assert shipped == DepthModel(shipped_file(DEFAULT).read_bytes(), shipped.spec, DEFAULT)
    assert shipped.spec.focal_px == 136.0 and shipped.spec.is_usable


def test_only_networks_in_32_bits_can_be_tuned(tmp_path: Path) -> None:
    assert trainable_file("tiny-0.35") == shipped_file("tiny-0.35")
    assert trainable_file("tiny-0.35-int8") is None
    for bits in ("", "-int8"):
        file = tmp_path / f"mine{len(bits)}.onnx"
        file.write_bytes(shipped_file(f"tiny-0.35{bits}").read_bytes())
        assert trainable_file(file) == (None if bits else file)


def test_mistyped_name_lists_the_known_ones() -> None:
    for look_up in (trainable_file, read_model):
        with pytest.raises(
            DataError, match=r"^one-thrid-0\.35: does not exist; give .*or one of full-0\.35, .*tiny-0\.35$"
        ):
            look_up("one-thrid-0.35")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("mean", "meen"), "meen: is unknown, the nearest is mean"),
        (lambda text: text.replace("mean = ", "# "), "mean: is missing"),
        (lambda text: text + "colour = 3\n", "colour: is unknown, known are "),
        (lambda text: text + "focal_px = 136\n", "focal_px: Give either width and height, or focal_px"),
        (lambda text: text.replace("width = 128\n", ""), "height: Width and height go together"),
        (
            lambda text: text.replace("width = 128\n", "").replace("height = 128\n", ""),
            "focal_px: Give either width and height, or focal_px",
        ),
        (lambda text: text.replace("width = 128", "width = 32"), "width: .*greater than or equal to 64"),
        (lambda text: text.replace("0.229", "0.0"), "std.0: .*greater than 0"),
        (lambda text: text.replace("0.485", "nan"), "mean.0: .*finite"),
        (lambda text: text.replace('"disparity"', '"depths"'), "output: .*'depth', 'log-depth' or 'disparity'"),
        (lambda text: text + "shift = 1.0\n", "shift: Give scale as well"),
        (
            lambda text: text.replace('"disparity"', '"log-depth"') + "scale = 2\nshift = 1\n",
            "shift: Log-depth has a scale only",
        ),
        (lambda text: text + "scale = -2\n", "scale: .*greater than 0"),
        (lambda text: "width 3\n", "is not valid TOML"),
        (lambda text: text.replace("another.onnx", "no.onnx"), "file: .*no.onnx cannot be read; name the ONNX file"),
    ],
)
def test_invalid_description_is_refused(tmp_path: Path, change: Callable[[str], str], message: str) -> None:
    path = write_network(tmp_path, MIDAS, onnx_network(MIDAS))
    path.write_text(change(path.read_text()))
    refuses(lambda: read_model(path), DataError, rf"another\.toml: {message}")


@pytest.mark.parametrize("damage", ["empty", "text", "cut short"])
def test_damaged_network_is_refused(tmp_path: Path, damage: str) -> None:
    content = onnx_network(MIDAS)
    damaged = {"empty": b"", "text": b"not a network", "cut short": content[:-60]}[damage]
    path = write_network(tmp_path, MIDAS, damaged)
    for file in (path, tmp_path / "another.onnx"):
        refuses(
            lambda file=file: read_model(file), DataError, r"another\.onnx: cannot be loaded \(.*\); give one self-"
        )
    model = DepthModel(damaged, MIDAS, "another")
    refuses(lambda: DepthPredictor(model, CAMERA), DataError, r"another: cannot be loaded \(.*\); give one self-")


def test_undescribed_onnx_is_refused(tmp_path: Path) -> None:
    write_network(tmp_path, MIDAS, onnx_network(MIDAS))
    message = (
        r"another\.onnx: was not exported by monoloc.*; write a TOML with file, width and height .*output and met"
    )
    refuses(lambda: read_model(tmp_path / "another.onnx"), DataError, message)


def test_own_onnx_with_an_invalid_focal_length_is_refused(tmp_path: Path) -> None:
    model = onnx.load_from_string(depth_from_blue().content)
    for value in ("wide", "-1.0", "nan"):
        model.metadata_props[0].value = value
        (tmp_path / "depth.onnx").write_bytes(model.SerializeToString())
        message = rf"depth\.onnx: has metadata monoloc_focal_px = {value}, which is no focal"
        refuses(lambda: read_model(tmp_path / "depth.onnx"), DataError, message)


def test_missing_network_is_refused(tmp_path: Path) -> None:
    refuses(lambda: read_model(tmp_path / "no.toml"), DataError, r"no\.toml: does not exist; give a .*full-0.35")
    refuses(lambda: read_model("fulll"), DataError, r"fulll: does not exist; give a .*full-0.35")
    refuses(lambda: read_network(tmp_path), BundleError, "is not a bundle")


@pytest.mark.parametrize(
    ("content", "changes", "message"),
    [
        (
            takes(IMAGE, ("size", TensorProto.INT64, [2])),
            {},
            r"has 2 inputs \(pixels, size\); export it with the image",
        ),
        (takes(("pixels", TensorProto.FLOAT, [3, 128, 128])), {}, r"takes tensor\(float\) of 3 axes; export it with"),
        (takes(("pixels", TensorProto.UINT8, [1, 3, 128, 128])), {}, r"takes tensor\(uint8\) of 4 axes; export it"),
        (
            onnx_network(MIDAS, declared=[1, 3, 256, 256]),
            {},
            "takes 1 x 3 x 256 x 256, not 1 x 3 x 128 x 128; correct width",
        ),
        (onnx_network(MIDAS, declared=[2, 3, "h", "w"]), {}, "takes 2 x 3 x any x any, not 1 x 3 x 128 x 128"),
        (onnx_network(MIDAS), {"layout": "nhwc"}, "takes 1 x 3 x any x any, not 1 x 128 x 128 x 3; correct .*layout"),
        (
            onnx_network(MIDAS, declared=[1, 3, 256, 256]),
            {"width": None, "height": None, "focal_px": 136.0},
            "takes 1 x 3 x 256 x 256, not images of any size; give width and height",
        ),
    ],
)
def test_network_with_another_input_is_refused(
    tmp_path: Path, content: bytes, changes: dict[str, Any], message: str
) -> None:
    path = write_network(tmp_path, spec(**changes), content)
    path.write_text(toml_of(ModelSpec(**{k: v for k, v in spec(**changes).model_dump().items() if v is not None})))
    refuses(lambda: read_model(path), DataError, rf"another\.toml: {message}")
