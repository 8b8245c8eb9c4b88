"""Predicted numbers of landmarks against a loop over views, and at poses where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.geometry import make_pose, so3_exp
from monoloc.landmarks.expected_landmarks import ExpectedLandmarks
from monoloc.landmarks.landmark_map import LandmarkViews

CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
AHEAD = np.array([[0.0, 0.0, 2.0]], np.float32)


def by_loop(point: np.ndarray, views: LandmarkViews, index: int, position: np.ndarray) -> float:
    """The module's formula, one landmark and one view at a time."""
    found = seen = 0.0
    for pose, row in zip(views.poses, views.found, strict=True):
        local = np.linalg.inv(pose) @ [*point, 1.0]
        pixel = CAMERA.project(local[:3])
        in_image = local[2] > 0.05 and -1.0 <= pixel[0] <= 160.0 and -1.0 <= pixel[1] <= 120.0
        if not (in_image or row[index]):
            continue
        now, then = point - position, point - pose[:3, 3]
        between = now / np.linalg.norm(now) - then / np.linalg.norm(then)
        nearer = np.log(np.linalg.norm(now) / np.linalg.norm(then))
        weight = (1.0 + (np.linalg.norm(between) / 0.12) ** 2 + (nearer / 0.20) ** 2) ** -1.5
        seen += weight
        found += weight * row[index]
    return found / (seen + 2.0)


def test_rates_are_those_of_a_loop_over_landmarks_and_views() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal([0.0, 0.0, 2.5], 0.7, (40, 3)).astype(np.float32)
    poses = np.stack([make_pose(so3_exp(rng.normal(0.0, 0.2, 3)), rng.normal(0.0, 0.3, 3)) for _ in range(12)])
    views = LandmarkViews(poses, rng.uniform(size=(12, 40)) < 0.4)
    position = np.array([0.2, -0.1, 0.3])
    rates = ExpectedLandmarks(points, views, CAMERA).rates(position)
    expected = [by_loop(point.astype(np.float64), views, index, position) for index, point in enumerate(points)]
    np.testing.assert_allclose(rates, expected, rtol=1e-4)


@pytest.mark.parametrize(("views", "found", "rate"), [(8, 8, 0.8), (8, 2, 0.2), (2, 2, 0.5), (4, 0, 0.0)])
def test_rate_at_a_view_is_the_share_that_found_it_with_two_more_that_did_not(
    views: int, found: int, rate: float
) -> None:
    seen = LandmarkViews(np.tile(np.eye(4), (views, 1, 1)), np.arange(views)[:, None] < found)
    assert ExpectedLandmarks(AHEAD, seen, CAMERA).rates(np.zeros(3))[0] == pytest.approx(rate)


def test_rate_falls_with_direction_and_with_distance_both_ways() -> None:
    expected = ExpectedLandmarks(AHEAD, LandmarkViews(np.eye(4)[None], np.ones((1, 1), np.bool_)), CAMERA)

    def falls(positions: list[list[float]]) -> bool:
        rates = [float(expected.rates(np.array(position))[0]) for position in positions]
        return rates == sorted(rates, reverse=True) and rates[-1] < 0.1 * rates[0]

    assert falls([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.6, 0.0, 0.1], [0.0, 0.0, 4.0]])
    assert falls([[0.0, 0.0, 0.0], [0.0, 0.0, 0.3], [0.0, 0.0, 1.0]])
    assert falls([[0.0, 0.0, 0.0], [0.0, 0.0, -0.5], [0.0, 0.0, -2.0]])


def test_only_landmarks_in_the_image_count() -> None:
    points = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [5.0, 0.0, 2.0]], np.float32)
    seen = LandmarkViews(np.eye(4)[None], np.ones((1, 3), np.bool_))
    expected = ExpectedLandmarks(points, seen, CAMERA)
    rates = expected.rates(np.zeros(3))
    assert expected.count(np.eye(4), CAMERA, rates) == pytest.approx(rates[0])
    assert expected.count(make_pose(so3_exp([0.0, np.pi, 0.0]), np.zeros(3)), CAMERA, rates) == pytest.approx(
        rates[1]
    )
