"""The depth network that comes with monoloc: trained by ``monoloc depth train`` with ``train.toml`` beside it."""

from __future__ import annotations

from pathlib import Path

SHIPPED_NETWORK = Path(__file__).parent / "full-0.35.safetensors"
SHIPPED_ONNX = SHIPPED_NETWORK.with_suffix(".onnx")
