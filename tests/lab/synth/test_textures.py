"""Procedural textures."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc_lab.synth.materials import Material
from monoloc_lab.synth.textures import TEXTURES, texture


@pytest.mark.parametrize("name", list(TEXTURES))
def test_textures_are_repeatable_and_tile(name: str) -> None:
    material = Material(name, (0.6, 0.5, 0.4), (0.3, 0.2, 0.1), seed=5)
    image = texture(material)
    assert image.dtype == np.float32 and image.shape[2] == 3
    assert image.min() >= 0.0 and image.max() <= 1.0
    assert image.tobytes() == texture(material).tobytes()
    if name == "plain":
        return
    assert image.std() > 0.003
    assert texture(material.seeded(6)).tobytes() != image.tobytes()
    if name in ("plaster", "wood", "fabric", "leaves", "brick"):
        # At a seam the difference would exceed that of neighbours, joints included.
        steps = np.abs(np.diff(image, axis=1)).mean(axis=(0, 2))
        assert np.abs(image[:, 0] - image[:, -1]).mean() < 1.3 * steps.max()
