"""Errors that last: what is stated of them near and away, and how it is measured."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monoloc.builder import trajectories as ways
from monoloc.builder.bias import fit_bias_model, measure_bias
from monoloc.bundle import fingerprint
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors
from monoloc.fusion.bias_model import BiasModel
from monoloc.geometry import FloatArray, se3_exp
from monoloc.localizer import Localizer
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.particles import scatter
from monoloc.progress import NoProgress
from monoloc.supervision.state import LikelihoodThresholds
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
    errors = BiasModel(sd_at_reference_m=near, sd_at_reference_rad=turned, sd_growth_m=growth, sd_growth_rad=twisting)
    expected = [np.hypot(near, growth * distance)] * 3 + [np.hypot(turned, twisting * distance)] * 3
    np.testing.assert_allclose(errors.widths(distance), expected, rtol=1e-12, atol=1e-15)


@given(there=sizes, back=sizes)
def test_correlations_of_two_steps_multiply(there: float, back: float) -> None:
    errors = BiasModel()
    assert errors.kept(0.0) == 1.0 and errors.kept(there) <= 1.0
    assert errors.kept(there + back) == pytest.approx(errors.kept(there) * errors.kept(back))


@pytest.mark.parametrize("seed", range(4))
def test_what_errors_were_drawn_from_is_found(seed: int) -> None:
    """Of 2000 errors each, the median's square is within some 5 % of the variance's, and the growth's within 10 %."""
    rng = np.random.default_rng(seed)
    drawn = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.01, sd_growth_m=0.1, sd_growth_rad=0.2)
    # The rehearsal's network is worse everywhere: by as much near as away.
    worse = drawn.model_copy(update={"sd_at_reference_m": 0.05, "sd_at_reference_rad": 0.03})
    distances = rng.uniform(0.2, 0.8, 2000)

    def errors(of: BiasModel, distances_m: FloatArray) -> PoseErrors:
        off = rng.normal(size=(len(distances_m), 6)) * [of.widths(distance) for distance in distances_m]
        return PoseErrors(np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1))

    here = np.zeros(2000)
    found = fit_bias_model(errors(drawn, here), errors(worse, here), errors(worse, distances), distances)
    assert (found.sd_at_reference_m, found.sd_at_reference_rad) == pytest.approx((0.03, 0.01), rel=0.05)
    # Averaged, as squares, with a growth of 0.1.
    assert (found.sd_growth_m, found.sd_growth_rad) == pytest.approx((0.1, np.sqrt(0.025)), rel=0.12)


def test_errors_grow_a_little_where_those_away_are_no_larger() -> None:
    near, away = PoseErrors(np.full(9, 0.1), np.full(9, 0.1)), PoseErrors(np.full(9, 0.08), np.full(9, 0.2))
    found = fit_bias_model(near, near, away, np.full(9, 0.5))
    assert found.sd_growth_m == pytest.approx(np.sqrt(0.5) * 0.1) and found.sd_growth_rad > found.sd_growth_m


@given(near=st.floats(0.01, 0.2), growth=st.floats(0.0, 1.0), distance=st.floats(0.0, 3.0))
def test_near_errors_have_a_share_of_the_variance_away(near: float, growth: float, distance: float) -> None:
    share = BiasModel(sd_at_reference_m=near, sd_at_reference_rad=0.01, sd_growth_m=growth).reference_variance_share(
        distance
    )
    expected = near**2 / (near**2 + (growth * distance) ** 2)
    np.testing.assert_allclose(share, [expected] * 3 + [1.0] * 3, atol=1e-12)


def test_where_errors_have_no_width_the_share_is_all() -> None:
    np.testing.assert_array_equal(BiasModel().reference_variance_share(1.0), np.ones(6))
    assert BiasModel(sd_growth_m=0.1).reference_variance_share(1.0)[0] == 0.0


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
    return make_localizer(
        mixture, LikelihoodThresholds(low=-9.0, lost=-99.0), particles, viewpoints, rng, config, depth
    )


@pytest.mark.slow
def test_the_camera_stays_where_depth_errs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Passing through four frames would show a part of what their leaning depth makes of the pose in the end."""
    monkeypatch.setattr(ways, "_FORGOTTEN", 24)
    monkeypatch.setattr(ways, "_LONG", 24)  # the walk is long enough
    recording, mixture = RoomRecording(Room(), make_path(24)), room_mixture(Room())
    region = np.arange(14, 18)
    final, rehearsed = _Leaning(recording, set()), _Leaning(recording, {*region.tolist()})
    final_at, rehearsed_at = (partial(starts_at, mixture, recording.poses, depth) for depth in (final, rehearsed))
    alone, _ = measure_bias(final_at, rehearsed_at, recording, [], False, NoProgress())
    assert final.asked == list(range(24)) and not rehearsed.asked
    assert alone.sd_growth_m == alone.sd_growth_rad == 0.0
    found, _ = measure_bias(final_at, rehearsed_at, recording, [region], True, NoProgress())
    walk = list(range(24))
    assert final.asked == [*walk, *walk[::-1], *walk, *walk[::-1]] and rehearsed.asked[:24] == list(range(24))
    assert rehearsed.asked[24:34] == [14, 15, 16, 17, 16, 15, 14, 15, 16, 17] and len(rehearsed.asked) >= 24 + 28
    assert found.sd_at_reference_m < 0.03 and alone.sd_at_reference_m < 0.03
    # A quarter of the depth across a metre of it turns a wall by some 14 degrees.
    assert found.sd_growth_rad > 0.1
    one_frame, _ = measure_bias(final_at, rehearsed_at, recording, [np.array([20])], True, NoProgress())
    assert np.isfinite([one_frame.sd_growth_m, one_frame.sd_growth_rad]).all()


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
    found, viewpoints = measure_bias(
        lambda _: _Forgetful(poses, visited), lambda _: _Forgetful(poses, visited), recording, [], False, NoProgress()
    )
    # The median of the lengths of Gaussian errors, each axis with this deviation, is the decimetre.
    assert found.sd_at_reference_m == pytest.approx(0.1 / np.sqrt(CHI2_MEDIAN_3), rel=0.1)
    assert len({index // walked for index in visited}) >= min(places, 15)
    assert len(visited) <= 20 * 70
    assert not viewpoints.there.any() and not viewpoints.back.any()


class _Erring:
    """A localizer that is off along x by what the place says, and along y by where it comes from."""

    def __init__(self, poses: FloatArray, off_m: FloatArray) -> None:
        self._poses, self._off_m = poses, off_m
        self._last = 0

    def step(self, color: np.ndarray, elapsed_s: float) -> SimpleNamespace:
        index = int(color[0, 0, 0])
        is_ahead, self._last = index > self._last, index
        pose = self._poses[index] @ se3_exp([self._off_m[index], 0.05 if is_ahead else -0.05, 0.0, 0.0, 0.0, 0.0])
        return SimpleNamespace(located=SimpleNamespace(pose=pose))


@pytest.mark.parametrize(
    ("frames", "regions", "is_tuned"),
    [
        (200, [[90, 91]], True),
        (30, [[20, 21]], True),
        (29, [[20, 21]], True),
        (200, [], False),
        (200, [[90, 91]], False),
    ],
)
def test_what_is_of_the_place_is_known_at_each_viewpoint_and_no_width(
    frames: int, regions: list[list[int]], is_tuned: bool
) -> None:
    """On a long walk, after tuning: a short one, or an untuned network's, is only known to be so wide."""
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 2, 3] = np.linspace(0.0, 4.0, frames)
    off_m = 0.1 * np.sin(np.linspace(0.0, 9.0, frames))
    recording, held_out = _Bare(poses), [np.array(region) for region in regions]
    localizer = _Erring(poses, off_m)
    found, viewpoints = measure_bias(
        lambda _: localizer, lambda _: localizer, recording, held_out, is_tuned, NoProgress()
    )
    is_known = frames >= 30 and is_tuned
    np.testing.assert_array_equal(viewpoints.poses, poses)
    for passed, sideways_m in ((viewpoints.there, 0.05), (viewpoints.back, -0.05)):
        np.testing.assert_allclose(passed[:, 0], off_m if is_known else 0.0, atol=1e-12)
        np.testing.assert_allclose(passed[1:-1, 1], sideways_m if is_known else 0.0, atol=1e-12)
        assert not passed[:, 2:].any()
    np.testing.assert_allclose(viewpoints.common_bias[:, 0], off_m if is_known else 0.0, atol=1e-12)
    # Where the walk turns, what is of the way is the same twice.
    np.testing.assert_allclose(viewpoints.common_bias[:, 1], 0.0, atol=1e-3)
    # What goes with the way is not known of another.
    lengths = np.full(frames, 0.05) if is_known else np.hypot(0.05, off_m)
    assert found.sd_at_reference_m == pytest.approx(np.median(lengths) / np.sqrt(CHI2_MEDIAN_3), rel=0.05)


@given(st.lists(st.integers(1, 60), min_size=1, max_size=60))
def test_long_walks_are_followed_before_frames_that_stand_alone(lengths: list[int]) -> None:
    poses = np.tile(np.eye(4), (sum(lengths), 1, 1))
    poses[:, 2, 3] = np.repeat(5.0 * np.arange(len(lengths)), lengths)
    walks = ways.recording_segments(0.1 * np.arange(len(poses)), poses)
    assert [int(walk[0]) for walk in walks] == sorted(int(walk[0]) for walk in walks)
    long, followed = sum(length >= 30 for length in lengths), sum(len(walk) >= 30 for walk in walks)
    assert followed == long or (long > 20 and followed > 10)
    assert min(len(lengths), 10) <= len(walks) <= 20


@pytest.mark.slow
@pytest.mark.parametrize("pause_s", [20.0, 0.1])
def test_walks_are_followed_one_by_one(monkeypatch: pytest.MonkeyPatch, pause_s: float) -> None:
    """A pause, or a place elsewhere in the next frame, is no way that a camera was followed over."""
    monkeypatch.setattr(ways, "_FORGOTTEN", 12)
    monkeypatch.setattr(ways, "_LONG", 12)
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
    other_at = partial(starts_at, mixture, poses, other)
    found, _ = measure_bias(final_at, other_at, recording, [region], True, NoProgress())
    np.testing.assert_array_equal(started, poses[[11, 23]])  # each is gone back on first
    assert found.sd_at_reference_m < 0.03 and found.sd_at_reference_rad < 0.02
    assert other.asked[24:28] == [4, 5, 4, 5] and other.asked[-2:] == [16, 17]
