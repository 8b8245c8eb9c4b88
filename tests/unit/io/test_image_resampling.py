"""Images rendered as another camera sees them, against the room seen by that camera."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.io.image_resampling import Resampler, common_camera
from synthetic_room import Room, make_path

COMMON = Camera(160, 128, 136.0, 138.0, 75.5, 66.0)


@pytest.mark.parametrize(
    "own",
    [
        Camera(160, 128, 140.0, 141.0, 78.0, 63.0),
        Camera(160, 128, 137.0, 137.0, 75.5, 66.0, (-0.25, 0.05, 0.002, 0.0, 0.0)),
        Camera(160, 128, 136.0, 136.0, 75.5, 66.0, (0.05, 0.0, 0.0, 0.0), "fisheye"),
    ],
)
def test_image_is_what_the_common_camera_sees(own: Camera) -> None:
    pose = make_path(5)[4]
    expected_color, expected_depth = Room().view(pose, COMMON)
    color, depth = Room().view(pose, own)
    resampler = Resampler(COMMON, [COMMON, own])
    rendered_color, rendered_depth = resampler.color(1, color), resampler.depth(1, depth)
    inside = (slice(12, -12), slice(12, -12))
    error = np.abs(rendered_color[inside].astype(float) - expected_color[inside])
    unrendered = np.abs(color[inside].astype(float) - expected_color[inside])
    assert error[..., :2].mean() < 0.5 * unrendered[..., :2].mean()
    depth_error, unrendered_m = (np.abs(each[inside] - expected_depth[inside]) for each in (rendered_depth, depth))
    assert np.quantile(depth_error, 0.9) < 0.5 * np.quantile(unrendered_m, 0.9)
    # Nothing was mixed: each depth is one that was stored, or unknown.
    assert np.isin(rendered_depth, np.append(depth, 0.0)).all()


def test_image_of_the_common_camera_is_unchanged() -> None:
    color, depth = Room().view(make_path(1)[0], COMMON)
    nearly = Camera(160, 128, 136.3, 138.3, 75.5, 66.0)
    resampler = Resampler(COMMON, [COMMON, nearly])
    for index in (0, 1):
        assert resampler.color(index, color) is color and resampler.depth(index, depth) is depth


def test_what_an_image_does_not_show_has_no_depth() -> None:
    narrow = Camera(160, 128, 142.0, 144.0, 75.5, 66.0)
    depth = Resampler(COMMON, [narrow]).depth(0, np.ones((128, 160), dtype=np.float32))
    assert (depth[:2] == 0.0).all() and (depth[:, -3:] == 0.0).all() and (depth[8:-8, 8:-8] == 1.0).all()


def test_common_camera_is_the_median_of_the_most_frequent_size() -> None:
    cameras = [Camera(160, 128, f, f, 80.0, 64.0) for f in (130.0, 150.0, 134.0, 132.0, 136.0)]
    cameras += [Camera(128, 160, 100.0, 100.0, 64.0, 80.0)] * 2
    camera, alike = common_camera(cameras)
    assert camera == cameras[2]
    np.testing.assert_array_equal(alike, [True, False, True, True, True, False, False])
