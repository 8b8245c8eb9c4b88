"""Poses of a build's frames, refined against the map: towards the truth, as far as the prior allows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import approx_fprime

from map_helpers import make_mixture
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pose_refinement import MixtureTarget, PosePrior, refine_poses
from monoloc.builder.room_map import fit_map
from monoloc.errors import SettingError
from monoloc.evaluation.trajectory import PoseErrors, pose_errors
from monoloc.geometry import make_pose, se3_exp, so3_exp
from monoloc.io.recording import Recording, Selection
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from synthetic_room import SMALL_CAMERA, Room, RoomRecording

FloatArray = NDArray[np.float64]

FRAMES = 30
PRIOR = PosePrior(0.02, float(np.deg2rad(1.0)))


def camera_poses(rng: np.random.Generator) -> FloatArray:
    """Cameras in the middle of the room that look at one side of it, each part seen by several, (FRAMES, 4, 4)."""
    turns = np.stack([rng.uniform(-0.3, 0.3, FRAMES), np.linspace(-0.8, 0.8, FRAMES), np.zeros(FRAMES)], axis=1)
    return make_pose(so3_exp(turns), rng.uniform(-0.4, 0.4, (FRAMES, 3)))


@pytest.fixture(scope="module")
def truth() -> FloatArray:
    return camera_poses(np.random.default_rng(0))


@pytest.fixture(scope="module")
def noisy(truth: FloatArray) -> RoomRecording:
    """Depth from the true poses, and poses 2 cm and 1 degree off per axis."""
    recording = RoomRecording(Room(), truth, SMALL_CAMERA)
    sd = np.repeat([PRIOR.position_sd_m, PRIOR.rotation_sd_rad], 3)
    recording.poses = truth @ se3_exp(np.random.default_rng(1).normal(scale=sd, size=(FRAMES, 6)))
    return recording


def errors(recording: Recording, truth: FloatArray) -> PoseErrors:
    assert recording.poses is not None
    return pose_errors(recording.poses, truth)


@pytest.fixture(scope="module")
def mixture() -> GaussianMixture:
    return fit_mixture(Room().cloud(0.06), 200, np.random.default_rng(0)).mixture


def test_poses_are_refined_against_a_given_map(
    noisy: RoomRecording, truth: FloatArray, mixture: GaussianMixture
) -> None:
    done: list[int] = []
    refined = refine_poses(noisy, mixture, None, PRIOR, np.random.default_rng(0), done.append)
    before, after = errors(noisy, truth), errors(refined, truth)
    assert np.median(after.position_m) < 0.5 * np.median(before.position_m)
    assert np.median(after.rotation_rad) < 0.5 * np.median(before.rotation_rad)
    assert done == list(range(1, FRAMES + 1))
    assert refined.frame_names == noisy.frame_names and noisy.poses is not refined.poses


@pytest.mark.slow
def test_poses_are_refined_against_their_own_map(noisy: RoomRecording, truth: FloatArray) -> None:
    def remap(recording: Recording) -> GaussianMixture:
        config = BuildConfig(components=100)
        return fit_map(recording, None, config, np.random.default_rng(0), NoProgress())[1]

    refined = refine_poses(noisy, remap(noisy), remap, PRIOR, np.random.default_rng(0))
    before, after = errors(noisy, truth), errors(refined, truth)
    # Measured: 0.7 and 0.4. Along bare walls only the prior fixes a camera's position.
    assert np.median(after.position_m) < 0.85 * np.median(before.position_m)
    assert np.median(after.rotation_rad) < 0.6 * np.median(before.rotation_rad)


@pytest.mark.slow
def test_right_poses_hardly_change_and_those_without_depth_not_at_all(
    truth: FloatArray, mixture: GaussianMixture
) -> None:
    class OneWithoutDepth(RoomRecording):
        def depth(self, index: int) -> NDArray[np.float32]:
            return super().depth(index) * np.float32(index != 2)

    recording = OneWithoutDepth(Room(), truth, SMALL_CAMERA)
    refined = refine_poses(recording, mixture, None, PRIOR, np.random.default_rng(0))
    changes = errors(refined, truth)
    assert np.median(changes.position_m) < 0.012 and np.median(changes.rotation_rad) < np.deg2rad(0.4)
    assert refined.poses is not None
    np.testing.assert_array_equal(refined.poses[2], truth[2])
    assert not np.array_equal(refined.poses[3], truth[3])


def test_certain_poses_do_not_change(noisy: RoomRecording, mixture: GaussianMixture) -> None:
    some = Selection(noisy, np.arange(5))
    refined = refine_poses(some, mixture, None, PosePrior(1e-6, 1e-6), np.random.default_rng(0))
    assert some.poses is not None and refined.poses is not None
    np.testing.assert_allclose(refined.poses, some.poses, atol=1e-5)


def test_gradient_is_that_of_the_likelihood() -> None:
    """Against numerical derivatives of the mixture's density with outliers; all components are matched."""
    rng = np.random.default_rng(0)
    mixture = make_mixture(4)
    pose, points = se3_exp(0.1 * rng.normal(size=6)), mixture.sample(30, rng) + 0.05 * rng.normal(size=(30, 3))

    def loss(twist: FloatArray) -> float:
        moved = points @ (pose @ se3_exp(twist))[:3, :3].T + (pose @ se3_exp(twist))[:3, 3]
        return -float(np.log(0.9 * np.exp(mixture.log_density(moved)) + 0.1 / mixture.volume_m3).sum())

    information, gradient = MixtureTarget(mixture)._normal_equations(points, pose)
    np.testing.assert_allclose(gradient, approx_fprime(np.zeros(6), loss, 1e-6), rtol=1e-3, atol=1e-2)
    assert np.linalg.eigvalsh(information)[0] > 0.0


def test_recording_without_depth_is_refused(truth: FloatArray, mixture: GaussianMixture) -> None:
    without_depth = RoomRecording(Room(), truth[:1], SMALL_CAMERA, has_depth=False)
    with pytest.raises(SettingError, match="refine_poses: needs depth, and the recording has none; leave it out"):
        refine_poses(without_depth, mixture, None, PRIOR, np.random.default_rng(0))
