"""Errors that last: what is stated of them near and away, and how it is measured."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from monoloc.adapt import lasting
from monoloc.adapt.lasting import lasting_errors, mean_error, measure_lasting
from monoloc.bundle import fingerprint
from monoloc.depth.runtime import DepthPrediction, DepthPredictor
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors
from monoloc.filter.estimate import Estimate
from monoloc.filter.health import HealthyRange
from monoloc.filter.lasting import LastingErrors
from monoloc.filter.particles import scatter
from monoloc.geometry import FloatArray, make_pose, se3_exp
from monoloc.localizer import Localizer
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from synthetic_room import (
    CAMERA,
    SETTINGS,
    Room,
    RoomRecording,
    depth_from_blue,
    make_localizer,
    make_path,
    room_mixture,
)

sizes = st.floats(0.0, 1.0)


@given(near=sizes, turned=sizes, growth=sizes, twisting=sizes, distance=st.floats(0.0, 5.0))
def test_variances_of_near_and_away_add(
    near: float, turned: float, growth: float, twisting: float, distance: float
) -> None:
    errors = LastingErrors(near_sd_m=near, near_sd_rad=turned, growth_m=growth, growth_rad=twisting)
    expected = [np.hypot(near, growth * distance)] * 3 + [np.hypot(turned, twisting * distance)] * 3
    np.testing.assert_allclose(errors.widths(distance), expected, rtol=1e-12, atol=1e-15)


@given(there=sizes, back=sizes)
def test_correlations_of_two_steps_multiply(there: float, back: float) -> None:
    errors = LastingErrors()
    assert errors.kept(0.0) == 1.0 and errors.kept(there) <= 1.0
    assert errors.kept(there + back) == pytest.approx(errors.kept(there) * errors.kept(back))


@pytest.mark.parametrize("seed", range(4))
def test_what_errors_were_drawn_from_is_found(seed: int) -> None:
    """Of 2000 errors each, the median's square is within some 5 % of the variance's, and the growth's within 10 %."""
    rng = np.random.default_rng(seed)
    drawn = LastingErrors(near_sd_m=0.03, near_sd_rad=0.01, growth_m=0.1, growth_rad=0.2)
    # The rehearsal's network is worse everywhere: by as much near as away.
    worse = drawn.model_copy(update={"near_sd_m": 0.05, "near_sd_rad": 0.03})
    distances = rng.uniform(0.2, 0.8, 2000)

    def errors(of: LastingErrors, distances_m: FloatArray) -> PoseErrors:
        off = rng.normal(size=(len(distances_m), 6)) * [of.widths(distance) for distance in distances_m]
        return PoseErrors(np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1))

    here = np.zeros(2000)
    found = lasting_errors(errors(drawn, here), errors(worse, here), errors(worse, distances), distances)
    assert (found.near_sd_m, found.near_sd_rad) == pytest.approx((0.03, 0.01), rel=0.05)
    # Averaged, as squares, with a growth of 0.1.
    assert (found.growth_m, found.growth_rad) == pytest.approx((0.1, np.sqrt(0.025)), rel=0.12)


def test_errors_grow_a_little_where_those_away_are_no_larger() -> None:
    near, away = PoseErrors(np.full(9, 0.1), np.full(9, 0.1)), PoseErrors(np.full(9, 0.08), np.full(9, 0.2))
    found = lasting_errors(near, near, away, np.full(9, 0.5))
    assert found.growth_m == pytest.approx(np.sqrt(0.5) * 0.1) and found.growth_rad > found.growth_m


twists = st.tuples(*[st.floats(-0.1, 0.1)] * 6)


@given(mean=twists, at=twists)
def test_what_errors_are_in_the_mean_is_taken_off(mean: tuple[float, ...], at: tuple[float, ...]) -> None:
    pose, covariance = se3_exp(10.0 * np.array(at)), np.eye(6)
    told = LastingErrors(mean=mean).without_mean(Estimate(pose @ se3_exp(mean), covariance, 0.3), 0.0)
    np.testing.assert_allclose(told.pose, pose, atol=1e-12)
    assert told.covariance is covariance and told.log_scale == 0.3


@given(near=st.floats(0.01, 0.2), growth=st.floats(0.0, 1.0), distance=st.floats(0.0, 3.0))
def test_away_the_mean_counts_by_its_share_of_the_variance(near: float, growth: float, distance: float) -> None:
    errors = LastingErrors(mean=(0.0, -0.02, 0.0, 0.0, 0.0, 0.0), near_sd_m=near, near_sd_rad=0.01, growth_m=growth)
    told = errors.without_mean(Estimate(np.eye(4), np.eye(6), 0.0), distance)
    share = near**2 / (near**2 + (growth * distance) ** 2)
    np.testing.assert_allclose(told.pose[:3, 3], [0.0, 0.02 * share, 0.0], atol=1e-12)


def test_without_a_mean_a_pose_stays_what_it_is() -> None:
    pose = se3_exp([0.3, 0.1, -0.2, 0.4, 0.2, 0.1])
    np.testing.assert_array_equal(LastingErrors().without_mean(Estimate(pose, np.eye(6), 0.0), 1.0).pose, pose)


@pytest.mark.parametrize("mean", [(np.nan, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0, np.inf), (0.1, 0.2, 0.3)])
def test_a_mean_is_six_finite_numbers(mean: tuple[float, ...]) -> None:
    with pytest.raises(ValidationError, match="mean"):
        LastingErrors(mean=mean)


def way_of(length_m: float, frames: int = 400) -> FloatArray:
    """A straight way along x, turned somehow."""
    positions = np.zeros((frames, 3))
    positions[:, 0] = np.linspace(0.0, length_m, frames)
    turned = make_pose(se3_exp([0.0, 0.0, 0.0, 0.4, -1.0, 0.3])[:3, :3], np.array([1.0, 2.0, 3.0]))
    return np.asarray(turned @ make_pose(np.tile(np.eye(3), (frames, 1, 1)), positions))


def drawn_errors(way: FloatArray, length_m: float, sd: float, rng: np.random.Generator) -> FloatArray:
    """Twists (N, 6) that are forgotten within a third of a metre."""
    kept = np.exp(-length_m / len(way) / 0.3)
    errors = sd * rng.normal(size=(len(way), 6))
    for index in range(1, len(way)):
        errors[index] = kept * errors[index - 1] + np.sqrt(1.0 - kept**2) * errors[index]
    return errors


MEAN = np.array([0.0, -0.02, 0.0, -0.012, 0.0, 0.0])


def test_the_mean_of_errors_on_a_long_way_is_found() -> None:
    """Of 30 m: 2 cm and 0.7 degrees under errors of 2 cm an axis are sure, and what is chance is mostly not there."""
    way, rng = way_of(30.0), np.random.default_rng(0)
    drawn = [MEAN + drawn_errors(way, 30.0, 0.02, rng) for _ in range(30)]
    found = np.stack([mean_error(way @ se3_exp(errors), way) for errors in drawn])
    is_there, plain = MEAN != 0.0, np.stack([errors.mean(axis=0) for errors in drawn])
    # A mean over some 50 independent errors is off by 3 mm.
    np.testing.assert_allclose(found[:, is_there], np.tile(MEAN[is_there], (30, 1)), atol=0.01)
    assert np.mean(found[:, ~is_there] ** 2) < 0.6 * np.mean(plain[:, ~is_there] ** 2)


@given(seed=st.integers(0, 100), length_m=st.floats(4.5, 20.0))
def test_no_more_than_the_mean_is_taken_off(seed: int, length_m: float) -> None:
    rng = np.random.default_rng(seed)
    way = way_of(length_m, 60)
    errors = 0.5 * MEAN + drawn_errors(way, length_m, 0.02, rng)
    found = mean_error(way @ se3_exp(errors), way)
    pieces = np.stack([piece.mean(axis=0) for piece in np.array_split(errors, int(length_m))])
    # The cuts of the way are those of the frames, but for a frame.
    assert np.all(np.abs(found) <= np.abs(pieces.mean(axis=0)) + 0.005)


def test_a_short_way_tells_no_mean() -> None:
    way = way_of(3.9)
    found = mean_error(way @ se3_exp(MEAN), way)
    np.testing.assert_array_equal(found, np.zeros(6))
    np.testing.assert_allclose(mean_error(way_of(4.1) @ se3_exp(MEAN), way_of(4.1)), MEAN, atol=1e-9)


def test_the_way_between_two_walks_is_none() -> None:
    """Two walks of a metre and a half, ten metres apart, are three metres and a half at most."""
    way = np.concatenate([way_of(1.5, 50), way_of(1.5, 50)])
    way[50:, 0, 3] += 10.0
    np.testing.assert_array_equal(mean_error(way @ se3_exp(MEAN), way), np.zeros(6))


class _Leaning:
    """The room's depth, leaning in one region as if by an error that its viewpoints share."""

    def __init__(self, recording: RoomRecording, leaning: set[int]) -> None:
        self._index = {fingerprint(recording.color(index)): index for index in range(len(recording))}
        self._leaning = leaning
        self._exact = DepthPredictor(depth_from_blue(), CAMERA)
        self.asked: list[int] = []

    def __call__(self, color: np.ndarray) -> DepthPrediction:
        index = self._index[fingerprint(color)]
        self.asked.append(index)
        depth = self._exact(color)
        if index not in self._leaning:
            return depth
        across = depth.camera.pixel_rays()[..., 0].astype(np.float32)
        return DepthPrediction(depth.depth_m * np.exp(0.25 * across), depth.camera)


def starts_at(mixture: GaussianMixture, viewpoints: FloatArray, depth: _Leaning, pose: FloatArray) -> Localizer:
    config = SETTINGS.model_copy(update={"level": None})
    rng = np.random.default_rng(0)
    particles = scatter(pose, config.particles, 0.02, 0.01, config.log_scale_sd, rng)
    return make_localizer(mixture, HealthyRange(low=-9.0, lost=-99.0), particles, viewpoints, rng, config, depth)


@pytest.mark.slow
def test_the_camera_stays_where_depth_errs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Passing through four frames would show a part of what their leaning depth makes of the pose in the end."""
    monkeypatch.setattr(lasting, "_STAY", 24)  # the walk is long enough
    recording, mixture = RoomRecording(Room(), make_path(24)), room_mixture(Room())
    region = np.arange(14, 18)
    final, rehearsed = _Leaning(recording, set()), _Leaning(recording, {*region.tolist()})
    final_at, rehearsed_at = (partial(starts_at, mixture, recording.poses, depth) for depth in (final, rehearsed))
    alone = measure_lasting(final_at, rehearsed_at, recording, [], NoProgress())
    assert final.asked == list(range(24)) and not rehearsed.asked
    assert alone.growth_m == alone.growth_rad == 0.0
    found = measure_lasting(final_at, rehearsed_at, recording, [region], NoProgress())
    assert final.asked == 2 * list(range(24)) and rehearsed.asked[:24] == list(range(24))
    assert rehearsed.asked[24:34] == [14, 15, 16, 17, 16, 15, 14, 15, 16, 17] and len(rehearsed.asked) >= 24 + 28
    assert found.near_sd_m == alone.near_sd_m < 0.03
    # A quarter of the depth across a metre of it turns a wall by some 14 degrees.
    assert found.growth_rad > 0.1
    one_frame = measure_lasting(final_at, rehearsed_at, recording, [np.array([20])], NoProgress())
    assert np.isfinite([one_frame.growth_m, one_frame.growth_rad]).all()


class _Forgetful:
    """A localizer that comes to be a decimetre off, along x, ten frames after a true start."""

    def __init__(self, poses: FloatArray, visited: list[int]) -> None:
        self._poses, self._visited = poses, visited
        self._steps = 0

    def step(self, color: np.ndarray, elapsed_s: float) -> SimpleNamespace:
        index = int(color[0, 0, 0])
        self._visited.append(index)
        pose = self._poses[index].copy()
        pose[0, 3] += 0.1 * min(1.0, self._steps / 10.0)
        self._steps += 1
        return SimpleNamespace(located=SimpleNamespace(pose=pose))


class _Bare:
    """A recording whose images show the numbers of their frames."""

    def __init__(self, poses: FloatArray) -> None:
        self.poses, self.timestamps_s = poses, 0.1 * np.arange(len(poses))

    def __len__(self) -> int:
        return len(self.poses)

    def color(self, index: int) -> np.ndarray:
        return np.full((1, 1, 3), index, dtype=np.uint8)


@pytest.mark.parametrize(("places", "walked"), [(1, 200), (3, 6), (30, 1)])
def test_walks_are_long_enough_to_forget_their_start(places: int, walked: int) -> None:
    """Of few frames, far from one another, the error is what it comes to, not what it is beside a true start."""
    poses = np.tile(np.eye(4), (places * walked, 1, 1))
    poses[:, 2, 3] = np.repeat(5.0 * np.arange(places), walked)
    recording = _Bare(poses)
    visited: list[int] = []
    found = measure_lasting(
        lambda _: _Forgetful(poses, visited), lambda _: _Forgetful(poses, visited), recording, [], NoProgress()
    )
    # The median of the lengths of Gaussian errors, each axis with this deviation, is the decimetre.
    assert found.near_sd_m == pytest.approx(0.1 / np.sqrt(CHI2_MEDIAN_3), rel=0.1)
    assert len({index // walked for index in visited}) >= min(places, 15)
    assert len(visited) <= 20 * 70


@pytest.mark.parametrize(
    ("length_m", "regions", "expected"), [(6.0, [[90, 91]], 0.1), (1.5, [[90, 91]], 0.0), (6.0, [], 0.0)]
)
def test_what_a_walk_is_off_by_in_the_mean_is_no_width(
    length_m: float, regions: list[list[int]], expected: float
) -> None:
    """A decimetre everywhere along six metres; along one and a half, or untuned, it is that place's."""
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, 2, 3] = np.linspace(0.0, length_m, 200)
    recording, held_out = _Bare(poses), [np.array(region) for region in regions]
    found = measure_lasting(
        lambda _: _Forgetful(poses, []), lambda _: _Forgetful(poses, []), recording, held_out, NoProgress()
    )
    assert found.mean[0] == pytest.approx(expected, abs=0.02) and not any(found.mean[1:])
    assert found.near_sd_m == pytest.approx((0.1 - found.mean[0]) / np.sqrt(CHI2_MEDIAN_3), abs=0.003)


@pytest.mark.slow
@pytest.mark.parametrize("pause_s", [20.0, 0.1])
def test_walks_are_followed_one_by_one(monkeypatch: pytest.MonkeyPatch, pause_s: float) -> None:
    """A pause, or a place elsewhere in the next frame, is no way that a camera was followed over."""
    monkeypatch.setattr(lasting, "_STAY", 12)
    poses = np.concatenate([make_path(12), make_path(12, start_s=5.0 if pause_s > 1.0 else 2.5)])
    recording, mixture = RoomRecording(Room(), poses), room_mixture(Room())
    recording.timestamps_s = recording.timestamps_s + pause_s * (np.arange(24) >= 12)
    depth, other = _Leaning(recording, set()), _Leaning(recording, set())
    started: list[FloatArray] = []

    def final_at(pose: FloatArray) -> Localizer:
        started.append(pose)
        return starts_at(mixture, poses, depth, pose)

    # A region of two passes through one place: the camera stays in the one, then in the other.
    region = np.array([4, 5, 16, 17])
    found = measure_lasting(final_at, partial(starts_at, mixture, poses, other), recording, [region], NoProgress())
    np.testing.assert_array_equal(started, poses[[0, 12]])
    assert found.near_sd_m < 0.03 and found.near_sd_rad < 0.02
    assert other.asked[24:28] == [4, 5, 4, 5] and other.asked[-2:] == [16, 17]
