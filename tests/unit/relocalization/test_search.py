"""The search for a camera around the reference poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as trials
from hypothesis import strategies as st

from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import make_pose, pose_distance_m, se3_exp
from monoloc.likelihood.ray import RayLikelihood
from monoloc.likelihood.scan import scan_from_depth
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.estimate import Estimate
from monoloc.relocalization.search import GlobalRelocalizer
from synthetic_room import SETTINGS, RoomRecording, sparse_depth

FRAMES = 50


def test_search_finds_where_a_scan_was_taken(mixture: GaussianMixture, recording: RoomRecording) -> None:
    likelihood = RayLikelihood(mixture, SETTINGS.likelihood)
    relocalizer = GlobalRelocalizer(likelihood, SETTINGS.likelihood, recording.poses[::10], SETTINGS.log_scale_sd)
    far = Estimate(make_pose(np.eye(3), np.array([0.0, 0.0, -1.5])), np.eye(6), 0.0)
    rng = np.random.default_rng(0)
    for index in (5, 25, 45):
        scan = scan_from_depth(sparse_depth(recording, index), SETTINGS.scan_points, rng)
        found, value = relocalizer.relocalize(scan, far, rng)
        error = pose_errors(found.pose[None], recording.poses[index][None])
        assert error.position_m[0] < 0.3 and error.rotation_rad[0] < 0.2
        expected = likelihood.mean_log_likelihood(found.pose[None], np.array([found.log_scale]), scan)[0]
        assert value == pytest.approx(expected, abs=1e-4)  # particles weighed together share what is looked up
        # The true pose fits better than what was found, so as the current pose it is what is found.
        true = Estimate(recording.poses[index], np.eye(6), 0.0)
        assert relocalizer.relocalize(scan, true, rng)[0] is true


@trials(max_examples=20, deadline=None)
@given(count=st.integers(1, 60), spread_m=st.floats(0.0, 3.0), seed=st.integers(0, 1000))
def test_samples_are_near_reference_poses_and_near_every_one(count: int, spread_m: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    reference_poses = se3_exp(rng.standard_normal((count, 6)) * np.repeat([spread_m, 0.3 * spread_m], 3))
    relocalizer = GlobalRelocalizer(None, SETTINGS.likelihood, reference_poses, 0.05)
    samples = relocalizer.sample_everywhere(3000, rng)
    assert len(samples) == 3000 and samples.weights.sum() == pytest.approx(1.0)
    distances_m = np.stack([pose_distance_m(pose, samples.poses) for pose in reference_poses])
    # Drawn with 20 cm and 10 degrees an axis around poses that are at most 30 cm from any other.
    assert distances_m.min(axis=0).max() < 6.0 * (0.2 * np.sqrt(3.0) + np.deg2rad(10.0) * np.sqrt(3.0))
    assert distances_m.min(axis=1).max() < 0.3 + 0.8


def test_samples_around_a_place_have_its_error_before_refinement(recording: RoomRecording) -> None:
    relocalizer = GlobalRelocalizer(None, SETTINGS.likelihood, recording.poses[:1], 0.05)
    place = Estimate(recording.poses[20], np.eye(6), 0.0)
    samples = relocalizer.sample_around(place, 2000, np.random.default_rng(0))
    errors = pose_errors(samples.poses, np.repeat(place.pose[None], 2000, axis=0))
    assert np.sqrt(np.mean(errors.position_m**2) / 3.0) == pytest.approx(0.1, rel=0.1)
    assert np.sqrt(np.mean(errors.rotation_rad**2) / 3.0) == pytest.approx(np.deg2rad(6.0), rel=0.1)
    assert samples.log_scale.std() == pytest.approx(0.05, rel=0.1)
