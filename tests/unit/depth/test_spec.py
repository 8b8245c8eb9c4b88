"""How images go into a network and how depth comes out: sizes and validation."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from monoloc.camera import Camera
from monoloc.depth.spec import ModelSpec, network_size
from onnx_networks import PLAIN


def test_network_size_is_never_empty() -> None:
    assert network_size(Camera(640, 480, 5000.0, 5000.0, 320.0, 240.0), 136.0) == (32, 32)


def test_spec_needs_a_size_or_a_focal_length() -> None:
    with pytest.raises(ValidationError, match="focal_px"):
        ModelSpec(**PLAIN, output="depth", metric=True)


@pytest.mark.parametrize("name", ["mean", "std"])
def test_normalisation_of_values_up_to_255_is_refused(name: str) -> None:
    """ImageNet's, as some export scripts state it."""
    ranges = {"mean": (123.675, 116.28, 103.53), "std": (58.395, 57.12, 57.375)}
    values = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
    ModelSpec(width=64, height=64, output="depth", metric=True, **values)
    with pytest.raises(ValidationError, match="Mean and std are of values from 0 to 1: divide those of 0 to 255 by"):
        ModelSpec(width=64, height=64, output="depth", metric=True, **values | {name: ranges[name]})
