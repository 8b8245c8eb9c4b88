"""Points drawn into an image: the kernel against its NumPy twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc import _core
from monoloc.adapt.draw_points import NO_POINT, draw_points
from monoloc.adapt.warp import lens_array
from monoloc.camera import Camera
from monoloc.distortion import DistortionModel
from monoloc.geometry import se3_exp

CAMERA = Camera(64, 48, 56.0, 56.0, 31.5, 23.5)


# Standard deviations of coefficients that fold the image for no seed.
BENDS: dict[DistortionModel, list[float]] = {
    "brown": [0.05, 0.01, 0.005, 0.005, 0.001],
    "rational": [0.05, 0.01, 0.005, 0.005, 0.001, 0.05, 0.01, 0.001],
    "fisheye": [0.02, 0.01, 0.005, 0.001],
}


@pytest.mark.parametrize("model", BENDS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=5)
def test_kernel_draws_as_numpy_does(model: DistortionModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = replace(CAMERA, distortion=tuple(rng.normal(scale=BENDS[model])), distortion_model=model)
    points, pose = rng.normal(scale=2.0, size=(10_000, 3)), se3_exp(rng.normal(size=6))
    points = np.concatenate([points, points])  # of two at the same depth, the first is seen
    lens, is_fisheye = lens_array(camera), model == "fisheye"
    shape = (camera.height, camera.width)
    images = [(np.empty(shape, np.uint32), np.empty(shape, np.float32)) for _ in range(2)]
    for draw, image in zip((_core.draw_points, draw_points), images, strict=True):
        draw(points, pose, lens, is_fisheye, np.array(camera.sight), 0.3, *image)
    (front, depth_m), (expected_front, expected_depth) = images
    is_drawn = expected_front != NO_POINT
    assert np.mean(is_drawn) > 0.01  # 0.013 at least, over all seeds
    assert (expected_front[is_drawn] < 10_000).all()
    np.testing.assert_array_equal(expected_depth > 0.0, is_drawn)
    # Where a compiler fuses multiplications and additions, a point on a pixel's border may fall to its other side.
    assert np.mean(front != expected_front) < 1e-3
    assert np.mean(~np.isclose(depth_m, expected_depth, rtol=1e-5)) < 2e-3
