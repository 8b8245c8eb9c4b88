"""Poses of frames in two worlds: the transform between the worlds, and the reading by which they agree."""

from __future__ import annotations

import numpy as np
import pytest

from altered_recordings import POSES, turning_path
from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc.recording_check.world_agreement import agreeing_reading, common_transform

PATH = turning_path(60)[::4]
T_MAP_WORLD = make_pose(so3_exp([0.1, 0.7, -0.2]), np.array([1.0, -0.5, 2.0]))


def in_map(poses: FloatArray) -> FloatArray:
    """In another world, where single poses are off by two centimetres, and one is wrong."""
    found = T_MAP_WORLD @ poses
    found[:, :3, 3] += 0.02 * np.random.default_rng(0).normal(size=(len(poses), 3))
    found[3] = np.eye(4)
    return found


@pytest.mark.parametrize("name", [name for name in POSES if name not in ("late", "early")])
def test_poses_of_another_convention_are_named(name: str) -> None:
    stored = POSES[name].poses(PATH)
    reading = agreeing_reading(in_map(PATH), stored)
    assert reading is not None and reading.option == POSES[name].option
    np.testing.assert_allclose(reading.convert(stored), PATH, atol=1e-6)


def test_poses_that_agree_or_are_noise_have_no_other_reading() -> None:
    agreeing, T_map_world = common_transform(in_map(PATH), PATH)
    assert agreeing == len(PATH) - 1
    np.testing.assert_allclose(T_map_world, T_MAP_WORLD, atol=0.03)
    assert agreeing_reading(in_map(PATH), PATH) is None
    assert agreeing_reading(in_map(PATH), np.random.default_rng(1).permutation(PATH)) is None
    assert agreeing_reading(in_map(PATH)[:3], POSES["OpenGL"].poses(PATH)[:3]) is None, "too few"


def test_an_estimate_that_stands_has_no_other_reading_of_a_walk() -> None:
    """In millimetres, the walk would stand too."""
    walk = np.tile(np.eye(4), (20, 1, 1))
    walk[:, 0, 3] = np.linspace(0.0, 2.0, 20)
    assert agreeing_reading(np.tile(np.eye(4), (20, 1, 1)), walk) is None


def test_a_camera_that_stands_has_no_other_reading() -> None:
    standing = np.tile(PATH[:1], (20, 1, 1))
    assert agreeing_reading(T_MAP_WORLD @ standing, standing) is None
