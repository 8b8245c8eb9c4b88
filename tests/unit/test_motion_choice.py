"""Which motion counts where images and another sensor measured it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from monoloc.geometry import se3_exp
from monoloc.motion_choice import chosen_motion
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.motion_model import MotionConfig, motion_sd

NOISE = MotionConfig()
FRAME_S = 1.0 / 30.0
TWIST = np.array([0.02, 0.0, 0.01, 0.0, 0.01, 0.0])
BY_IMAGES = Motion(se3_exp(TWIST), 250, np.ones((250, 3)), np.full(250, 0.02))


def measured(by: ArrayLike) -> Motion:
    return Motion.metric(se3_exp(TWIST + by), 0.001, 0.001)


def test_motions_that_agree_count_by_their_noise() -> None:
    close = measured([0.004, 0.0, 0.0, 0.0, 0.002, 0.0])
    for odometry, other in ((BY_IMAGES, close), (Motion(se3_exp(TWIST), 20), close)):
        motion = chosen_motion(odometry, other, FRAME_S, NOISE)
        assert motion is not None and motion.translation == "metric" and not motion.is_contradicted
        assert motion.inliers == odometry.inliers and motion.points is odometry.points


@pytest.mark.parametrize("by", [[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.8, 0.0]])
def test_a_jump_leaves_the_motion_of_the_images_as_uncertain_as_an_unknown_one(by: list[float]) -> None:
    motion = chosen_motion(BY_IMAGES, measured(by), FRAME_S, NOISE)
    assert motion is not None and motion.is_contradicted and motion.translation == "scaled"
    np.testing.assert_array_equal(motion.T_previous_current, BY_IMAGES.T_previous_current)
    jumped = np.repeat([any(by[:3]), any(by[3:])], 3)
    stated, unknown, odometry = (motion_sd(which, FRAME_S, 0.0, NOISE) for which in (motion, None, BY_IMAGES))
    np.testing.assert_allclose(stated[jumped], unknown[jumped])
    assert (stated >= odometry).all()


def test_the_noise_of_a_contradicted_motion_allows_for_the_other() -> None:
    motion = chosen_motion(BY_IMAGES, measured([0.018, 0.0, 0.0, 0.0, 0.0, 0.0]), FRAME_S, NOISE)
    assert motion is not None and motion.is_contradicted
    assert motion.translation_sd_m == pytest.approx(0.018 / np.sqrt(3.0), rel=0.05)


def test_a_turn_alone_contradicts_nothing() -> None:
    """Where corners fail, it replaces odometry; where they do not, odometry used it to find them."""
    turn = Motion.rotation(se3_exp([0.0, 0.0, 0.0, 0.0, 0.8, 0.0])[:3, :3], 0.001)
    assert chosen_motion(BY_IMAGES, turn, FRAME_S, NOISE) is BY_IMAGES
    assert chosen_motion(None, turn, FRAME_S, NOISE) is turn
    assert chosen_motion(BY_IMAGES, None, FRAME_S, NOISE) is BY_IMAGES
