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
