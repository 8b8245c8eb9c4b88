"""On how few corners a landmark pose rests."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import FloatArray, make_pose, se3_exp, so3_exp, transform
from monoloc.landmarks.influential_corners import sd_without_influential_corners
from monoloc.landmarks.pnp import LandmarkPose

POSE = make_pose(so3_exp([0.1, 0.8, -0.2]), [1.0, 2.0, 0.5])
RAY_SD = 2.0 / 330.0  # two pixels of the images in which landmarks are found
# In the camera's frame: all over a room, and a flat picture of half a metre that is 4 m away.
DIRECTIONS = np.array([[x, y, 1.0] for x in np.linspace(-0.5, 0.5, 8) for y in np.linspace(-0.4, 0.4, 5)])
ROOM = np.random.default_rng(0).uniform(1.5, 4.0, (40, 1)) * DIRECTIONS
PICTURE = np.array([[x, y, 4.0] for x in np.linspace(0.0, 0.6, 4) for y in np.linspace(-0.2, 0.2, 3)])
BESIDE = np.array([[-0.8, 0.4, 2.0], [-0.5, 0.5, 1.8], [-0.9, 0.1, 2.5], [-0.4, 0.3, 1.5]])


def jacobian(local: FloatArray, step: float = 1e-6) -> FloatArray:
    """Of the rays of points (N, 3) by the camera's twist, (2N, 6), by finite differences."""

    def rays(twist: FloatArray) -> FloatArray:
        moved = transform(se3_exp(-twist), local)
        return (moved[:, :2] / moved[:, 2:]).ravel()

    return np.stack([(rays(axis) - rays(-axis)) / (2.0 * step) for axis in step * np.eye(6)], axis=1)


def covariance_of(local: FloatArray) -> FloatArray:
    by_twist = jacobian(local) / RAY_SD
    return np.linalg.inv(by_twist.T @ by_twist)


def place_of(local: FloatArray) -> LandmarkPose:
    return LandmarkPose(POSE, covariance_of(local), transform(POSE, local))


def largest_sd(covariance: FloatArray) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))


def test_equals_the_covariance_without_the_four_corners_of_greatest_leverage() -> None:
    left = ROOM
    for _ in range(4):
        covariance = covariance_of(left)
        leverages = [np.trace(rows @ covariance @ rows.T) for rows in jacobian(left).reshape(-1, 2, 6)]
        left = np.delete(left, np.argmax(leverages), axis=0)
    expected = largest_sd(covariance_of(left))
    assert sd_without_influential_corners(place_of(ROOM)) == pytest.approx(expected, rel=1e-3)
    assert expected < 0.05


def test_pose_that_a_flat_picture_and_a_few_corners_beside_it_determine_is_not_certain() -> None:
    local = np.concatenate([PICTURE, BESIDE])
    assert largest_sd(covariance_of(local)) < 0.06
    assert sd_without_influential_corners(place_of(local)) > 0.3


@pytest.mark.parametrize("local", [ROOM, np.concatenate([PICTURE, BESIDE])], ids=["room", "picture"])
def test_several_landmarks_of_each_corner_make_no_pose_more_certain(local: FloatArray) -> None:
    once, five_times = place_of(local), place_of(np.repeat(local, 5, axis=0))
    assert largest_sd(five_times.covariance) == pytest.approx(largest_sd(once.covariance) / np.sqrt(5.0))
    assert sd_without_influential_corners(five_times) == pytest.approx(sd_without_influential_corners(once))


def test_pose_that_is_stated_as_exact_is_certain() -> None:
    assert sd_without_influential_corners(LandmarkPose(POSE, np.zeros((6, 6)), transform(POSE, ROOM))) < 1e-3


@pytest.mark.parametrize(("corners", "is_finite"), [(6, False), (7, True)])
def test_pose_of_fewer_than_seven_corners_is_never_certain(corners: int, is_finite: bool) -> None:
    place = place_of(np.repeat(ROOM[:corners], 6, axis=0))
    assert np.isfinite(sd_without_influential_corners(place)) == is_finite
