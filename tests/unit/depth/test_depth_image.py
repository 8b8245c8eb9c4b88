"""Depth images: sampled between pixels, and their discontinuities."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.depth.depth_image import at_discontinuity, sample_depth


def test_sampled_depth_of_a_slanted_plane_is_exact() -> None:
    small, large = Camera(40, 30, 30.0, 30.0, 19.5, 14.5), Camera(320, 240, 240.0, 240.0, 159.5, 119.5)
    columns, rows = np.meshgrid(np.arange(40), np.arange(30))
    depth = (2.0 + 0.01 * columns - 0.02 * rows).astype(np.float32)
    pixels = np.random.default_rng(0).uniform([4, 4], [315, 235], (200, 2)).astype(np.float32)
    # Bilinear interpolation is exact on what is linear; pixel centres move by half a pixel under scaling.
    x, y = (pixels[:, 0] + 0.5) / 8 - 0.5, (pixels[:, 1] + 0.5) / 8 - 0.5
    sampled = sample_depth(pixels, large, depth, small, relative=0.15)
    assert np.allclose(sampled, 2.0 + 0.01 * x - 0.02 * y, atol=1e-5)


@pytest.mark.parametrize("distortion", [(), (-0.1, 0.02, 0.001, 0.0)])
def test_depth_of_another_field_of_view_is_that_on_the_same_ray(distortion: tuple[float, ...]) -> None:
    """A depth image cut out of the lens's, and one of a sensor that sees more, or less, and has no distortion."""
    camera = Camera(320, 240, 240.0, 240.0, 159.5, 119.5, distortion)
    cut = camera.resized(80, 60).cropped(20, 10, 40, 30)
    for other in (cut, Camera(80, 60, 40.0, 40.0, 39.5, 29.5), Camera(80, 60, 120.0, 120.0, 39.5, 29.5)):
        rays = other.pixel_rays()
        depth = (2.0 + 0.3 * rays[..., 0] - 0.5 * rays[..., 1]).astype(np.float32)  # by the ray
        pixels = np.random.default_rng(0).uniform([0, 0], [319, 239], (300, 2)).astype(np.float32)
        seen = camera.rays(pixels)
        sampled = sample_depth(pixels, camera, depth, other, relative=0.15)
        shown = other.project(seen)
        is_shown = np.all((shown >= 0.0) & (shown <= [other.width - 1, other.height - 1]), axis=1)
        expected = 2.0 + 0.3 * seen[:, 0] - 0.5 * seen[:, 1]
        np.testing.assert_allclose(sampled[is_shown], expected[is_shown], atol=2e-3)
        is_outside = np.any((shown < -1.5) | (shown > [other.width + 0.5, other.height + 0.5]), axis=1)
        assert is_shown.sum() > 20 and not sampled[is_outside].any()


def test_depth_beyond_the_border_is_that_of_the_nearest_pixel() -> None:
    camera = Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
    depth = np.full((30, 40), 2.0, dtype=np.float32)
    corners = np.array([[-0.5, -0.5], [39.5, 29.5], [39.0, 0.0], [0.0, 29.0], [-9.0, 50.0]], dtype=np.float32)
    assert np.allclose(sample_depth(corners, camera, depth, camera, relative=0.15), 2.0)


def test_depth_at_edges_and_holes_is_zero() -> None:
    camera = Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
    depth = np.full((30, 40), 2.0, dtype=np.float32)
    depth[:, 20:] = 3.0
    depth[5, 5] = 0.0
    pixels = np.array([[19.5, 10.0], [18.5, 10.0], [21.5, 10.0], [5.0, 5.0], [5.5, 4.5], [7.5, 5.0]], np.float32)
    sampled = sample_depth(pixels, camera, depth, camera, relative=0.15)
    assert np.allclose(sampled, [0.0, 2.0, 3.0, 0.0, 0.0, 2.0])
    # A jump that is allowed is interpolated.
    assert sample_depth(pixels[:1], camera, depth, camera, relative=0.6)[0] == pytest.approx(2.5)


def test_discontinuities_are_marked_on_both_sides_and_holes_are_not() -> None:
    depth = np.full((6, 8), 1.0)
    depth[:, 4:] = 2.0
    depth[0, 0] = 0.0
    marked = at_discontinuity(depth, 0.5)
    assert np.array_equal(np.flatnonzero(marked.any(axis=0)), [3, 4])
    assert marked[:, 3:5].all()
    assert not at_discontinuity(depth, 1.5).any()
