"""Removal of Monte Carlo noise."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc_lab.synth.denoise import Guide, denoised


def test_denoising_preserves_texture_edges_and_lamps() -> None:
    rng = np.random.default_rng(0)
    albedo = np.where(rng.uniform(size=(80, 80, 1)) < 0.5, 0.2, 0.7).repeat(3, axis=2).astype(np.float32)
    normals = np.zeros((80, 80, 3), np.float32)
    normals[:, :40], normals[:, 40:] = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    points = np.zeros((80, 80, 3), np.float32)
    points[:, :40, 1:] = np.stack(np.mgrid[0:80, 0:40] / 40.0, axis=-1)
    points[:, 40:, ::2] = np.stack(np.mgrid[0:80, 0:40] / 40.0, axis=-1)
    shading = np.where(np.arange(80)[None, :, None] < 40, 1.0, 2.0).astype(np.float32)
    shines = np.zeros((80, 80), bool)
    shines[:6, :6] = True
    truth = albedo * shading
    truth[shines] = 500.0
    noisy = (truth * rng.gamma(8.0, 1.0 / 8.0, (80, 80, 1))).astype(np.float32)
    clean = denoised(noisy, Guide(albedo, normals, points, shines))
    np.testing.assert_array_equal(clean[shines], noisy[shines])
    rest = np.ones((80, 80), bool)
    rest[:8, :8] = False
    error = [np.sqrt(np.mean((image[rest] / truth[rest] - 1.0) ** 2)) for image in (noisy, clean)]
    assert error[1] < 0.25 * error[0]
    assert clean[20:60, 36:40].mean() / truth[20:60, 36:40].mean() == pytest.approx(1.0, abs=0.06)
