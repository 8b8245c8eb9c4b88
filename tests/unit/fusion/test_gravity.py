"""A pose is rotated towards the direction of gravity that a flight controller observes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monoloc.fusion.gravity import Gravity, align_with_gravity, rotation_centre_m
from monoloc.geometry import FloatArray, is_rigid, rotation_angle, se3_exp, so3_exp, transform
from monoloc.likelihood.scan import EMPTY_SCAN, Scan, uniform_scan
from monoloc.particle_filter.estimate import Estimate

DOWN = np.array([0.0, 1.0, 0.0])
UNKNOWN_SD, EXACT_SD = 100.0, 0.0  # of a pose's rotation
GRAVITY_SD = np.deg2rad(1.0)
POSE = se3_exp([0.3, 0.1, -0.2, 0.05, 0.4, 0.02])
seeds = st.integers(0, 10_000)


def estimate_at(pose: FloatArray) -> Estimate:
    return Estimate(pose, 1e-4 * np.eye(6), 0.1)


@given(seeds, st.floats(0.01, 2.5))
def test_pose_of_unknown_rotation_takes_the_observed_tilt_and_nothing_else(seed: int, tilt_rad: float) -> None:
    """Gravity is where it is observed, by the smallest rotation, and the centre of rotation stays where it was."""
    rng = np.random.default_rng(seed)
    pose, centre_m = se3_exp(rng.normal(size=6)), rng.uniform(0.5, 4.0)
    expected = pose[:3, :3].T @ DOWN
    axis = np.cross(expected, rng.normal(size=3))
    observed = so3_exp(tilt_rad * axis / np.linalg.norm(axis)) @ expected
    aligned = align_with_gravity(estimate_at(pose), observed, DOWN, centre_m, UNKNOWN_SD, GRAVITY_SD)
    np.testing.assert_allclose(aligned.pose[:3, :3].T @ DOWN, observed, atol=1e-3)
    assert rotation_angle(pose[:3, :3].T @ aligned.pose[:3, :3]) == pytest.approx(tilt_rad, rel=1e-3)
    centre = np.array([[0.0, 0.0, centre_m]])
    np.testing.assert_allclose(transform(aligned.pose, centre), transform(pose, centre), atol=1e-12)
    assert aligned.log_scale == 0.1 and np.array_equal(aligned.covariance, estimate_at(pose).covariance)


def test_share_of_the_tilt_is_that_of_the_two_variances() -> None:
    expected = POSE[:3, :3].T @ DOWN
    observed = so3_exp([0.1, 0.0, 0.0]) @ expected
    aligned = [
        align_with_gravity(estimate_at(POSE), observed, DOWN, 2.0, sd, GRAVITY_SD)
        for sd in (EXACT_SD, np.deg2rad(1.0), np.deg2rad(3.0))
    ]
    rotated = [rotation_angle(POSE[:3, :3].T @ each.pose[:3, :3]) for each in aligned]
    tilt_rad = float(np.arccos(observed @ expected))
    np.testing.assert_allclose(rotated, [0.0, 0.5 * tilt_rad, 0.9 * tilt_rad], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("tilt_deg", "sd_deg", "turns"), [(5.9, 1.0, True), (6.1, 1.0, False), (8.0, 3.0, True)])
def test_gravity_that_contradicts_the_pose_does_not_turn_it(tilt_deg: float, sd_deg: float, turns: bool) -> None:
    """As by a mount that is otherwise than stated: beyond six degrees, and three standard deviations."""
    scan = uniform_scan(np.array([[0.1, 0.0, 2.0], [0.0, 0.1, 3.0]]))
    observed = so3_exp([np.deg2rad(tilt_deg), 0.0, 0.0]) @ np.array([0.0, 1.0, 0.0])
    aligned = Gravity(DOWN, is_of_video=False).align(estimate_at(np.eye(4)), scan, observed, np.deg2rad(sd_deg))
    assert np.array_equal(aligned.pose, np.eye(4)) is not turns


def test_aligned_pose_stays_and_one_upside_down_stays_rigid() -> None:
    aligned, upside_down = (
        align_with_gravity(estimate_at(POSE), sign * POSE[:3, :3].T @ DOWN, DOWN, 2.0, UNKNOWN_SD, GRAVITY_SD).pose
        for sign in (1.0, -1.0)
    )
    np.testing.assert_allclose(aligned, POSE, atol=1e-6)
    assert is_rigid(upside_down, 1e-9)


@given(seeds)
def test_rotation_about_the_centre_is_independent_of_translation(seed: int) -> None:
    """In the least-squares fit of relative depth errors by a translation and a rotation about the centre."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.normal(size=(50, 2)), rng.uniform(0.5, 5.0, 50)]).astype(np.float32)
    centre_m = rotation_centre_m(Scan(points, np.ones(50, dtype=np.float32)), np.log(1.2))
    depth = 1.2 * points[:, 2].astype(np.float64)
    by_translation, by_rotation = 1.0 / depth, (depth - centre_m) / depth
    assert by_translation @ by_rotation == pytest.approx(0.0, abs=1e-6 * len(depth))
    assert depth.min() <= centre_m <= depth.max()


def test_direction_is_a_unit_vector() -> None:
    np.testing.assert_allclose(Gravity(DOWN, False).direction(np.array([0.0, 9.81, 0.0])), DOWN)
    assert Gravity(DOWN, False).direction(None) is None and Gravity(None, False).direction(None) is None


@pytest.mark.parametrize("down", [np.zeros(3), np.array([0.0, np.nan, 1.0]), np.ones(2), np.full(3, np.inf)])
def test_direction_that_is_none_is_refused(down: FloatArray) -> None:
    with pytest.raises(ValueError, match="down must be three finite numbers, not all zero"):
        Gravity(DOWN, False).direction(down)


def test_direction_in_a_room_that_does_not_tell_its_own_is_refused() -> None:
    with pytest.raises(ValueError, match="the room's surfaces do not tell its direction: leave it out"):
        Gravity(None, False).direction(DOWN)


def test_pose_stays_where_gravity_is_not_observed_or_unknown_and_without_a_scan() -> None:
    scan, pose = uniform_scan(np.ones((20, 3), dtype=np.float32)), estimate_at(POSE)
    assert Gravity(DOWN, False).align(pose, EMPTY_SCAN, DOWN, UNKNOWN_SD) is pose
    assert Gravity(DOWN, False).align(pose, scan, None, UNKNOWN_SD) is pose
    assert Gravity(None, False).align(pose, scan, DOWN, UNKNOWN_SD) is pose
    aligned = Gravity(DOWN, False).align(pose, scan, DOWN, UNKNOWN_SD)
    np.testing.assert_allclose(aligned.pose[:3, :3].T @ DOWN, DOWN, atol=1e-3)


def test_direction_in_a_map_of_a_video_counts_less() -> None:
    """It is known to five degrees there; a pose whose rotation is known to one is hardly turned by it."""
    scan, pose, sd = uniform_scan(np.ones((20, 3), dtype=np.float32)), estimate_at(POSE), np.deg2rad(1.0)
    observed = so3_exp([0.1, 0.0, 0.0]) @ POSE[:3, :3].T @ DOWN
    turned = [
        rotation_angle(POSE[:3, :3].T @ Gravity(DOWN, is_of_video).align(pose, scan, observed, sd).pose[:3, :3])
        for is_of_video in (False, True)
    ]
    assert turned[1] / turned[0] == pytest.approx((1.0 / 26.0) / 0.5, rel=1e-3)
