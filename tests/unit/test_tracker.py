"""Particles and belief from frame to frame."""

from __future__ import annotations

import numpy as np
import pytest

from map_helpers import motion_of
from monoloc.fusion.bias_filter import BiasAugmentedFilter
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import se3_exp
from monoloc.localizer_config import LocalizerConfig
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.motion_model import predict
from monoloc.particle_filter.particles import Particles, normalised, scatter
from monoloc.tracker import Tracker

CONFIG = LocalizerConfig(particle_bias=BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.03))
START = scatter(np.eye(4), 100, 0.1, 0.05, CONFIG.log_scale_sd, np.random.default_rng(0))
MOTION = motion_of(se3_exp([0.1, 0.0, 0.05, 0.0, 0.1, 0.0]))
ELAPSED_S = 0.1


def make_tracker() -> Tracker:
    return Tracker(START, CONFIG, ReferencePoses.none(), np.random.default_rng(1))


def moved(particles: Particles, motion: Motion | None, time_since_update_s: float) -> Particles:
    """By the motion model, with the tracker's first random numbers."""
    noise = CONFIG.motion_noise
    rng = np.random.default_rng(1)
    return predict(particles, motion, ELAPSED_S, time_since_update_s, CONFIG.log_scale_sd, noise, rng)


@pytest.mark.parametrize("motion", [None, MOTION])
def test_first_frame_leaves_the_particles(motion: Motion | None) -> None:
    tracker = make_tracker()
    assert tracker.predict(motion, ELAPSED_S) is START
    predicted = tracker.predict(motion, ELAPSED_S)
    np.testing.assert_array_equal(predicted.poses, moved(START, motion, 0.0).poses)
    assert tracker.particles is predicted


@pytest.mark.parametrize(("from_search", "time_since_update_s"), [(False, 2.0), (True, 0.0)])
def test_particles_spread_with_the_time_since_an_update(from_search: bool, time_since_update_s: float) -> None:
    """But for particles of a recent search, which are as if updated."""
    tracker = make_tracker()
    tracker.predict(None, 0.0)
    tracker.fuse(None, 2.0, estimate(START), accepted=False)
    predicted = tracker.predict(None, ELAPSED_S, from_search)
    np.testing.assert_array_equal(predicted.poses, moved(START, None, time_since_update_s).poses)


def test_what_was_allowed_for_while_an_image_repeated_does_not_last() -> None:
    """The motion of the next one begins at the held particles and belief."""
    tracker, twin = make_tracker(), make_tracker()
    for each in (tracker, twin):
        each.predict(None, 0.0)
        each.fuse(None, 0.0, estimate(START), accepted=True)
    before = tracker.fusion.belief
    for _ in range(3):
        tracker.hold()
        tracker.fuse(None, ELAPSED_S, estimate(tracker.predict(None, ELAPSED_S)), accepted=False)
    assert tracker.fusion.belief.position_sd_m > before.position_sd_m + 0.02
    for each in (tracker, twin):
        each.resume()
    np.testing.assert_array_equal(tracker.particles.poses, START.poses)
    beliefs = [each.fuse(MOTION, 4.0 * ELAPSED_S, estimate(START), accepted=False) for each in (tracker, twin)]
    np.testing.assert_array_equal(beliefs[0].pose, beliefs[1].pose)
    np.testing.assert_array_equal(beliefs[0].covariance, beliefs[1].covariance)


def test_update_returns_the_weighted_pose_and_resamples() -> None:
    weighed = Particles(START.poses, START.log_scale, normalised(-2000.0 * START.poses[:, 0, 3] ** 2))
    tracker = make_tracker()
    belief = tracker.update(START, lambda _: weighed)
    np.testing.assert_array_equal(belief.pose, estimate(weighed).pose)
    np.testing.assert_allclose(tracker.particles.weights, 1.0 / len(START))


@pytest.mark.parametrize("accepted", [False, True])
def test_fused_belief_takes_the_particles_pose_only_if_accepted(accepted: bool) -> None:
    tracker = make_tracker()
    measured = Estimate(se3_exp([0.2, 0.0, 0.0, 0.0, 0.1, 0.0]), 1e-4 * np.eye(6), 0.0)
    fusion = BiasAugmentedFilter(
        estimate(START), CONFIG.particle_bias, CONFIG.motion_noise, ReferencePoses.none(), CONFIG.landmark_bias
    )
    expected = fusion.predict(MOTION, ELAPSED_S, measured)
    if accepted:
        expected = fusion.update_from_particles(measured)
    belief = tracker.fuse(MOTION, ELAPSED_S, measured, accepted)
    np.testing.assert_array_equal(belief.pose, expected.pose)
    np.testing.assert_array_equal(belief.covariance, expected.covariance)
    np.testing.assert_array_equal(tracker.fusion.belief.pose, expected.pose)
