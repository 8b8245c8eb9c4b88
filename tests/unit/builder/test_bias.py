"""Measurement of the particles' bias, with localizers whose errors are given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.builder.bias import fit_bias_model, localizer_factory, measure_bias, measure_bias_at_reference
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors
from monoloc.fusion.bias_model import MOST_SD, BiasModel
from monoloc.geometry import FloatArray, se3_exp
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.relocalization.state_machine import Mode
from monoloc.step_budget import Level
from synthetic_room import FRAME_S, Room, RoomRecording, make_bundle, make_path

# --- The model ---


@pytest.mark.parametrize("seed", range(4))
def test_model_is_that_which_errors_were_drawn_from(seed: int) -> None:
    """Of 2000 errors, the square of the median has a standard deviation of 5 %, that of the growth 10 %."""
    rng = np.random.default_rng(seed)
    true = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.01, sd_growth_m=0.1, sd_growth_rad=0.2)
    # The hold-out network's errors are larger everywhere: by as much at the reference poses as away from them.
    hold_out = true.model_copy(update={"sd_at_reference_m": 0.05, "sd_at_reference_rad": 0.03})
    distances_m = rng.uniform(0.2, 0.8, 2000)

    def errors(model: BiasModel, distances_m: FloatArray) -> PoseErrors:
        twists = rng.normal(size=(len(distances_m), 6)) * [model.sds(distance) for distance in distances_m]
        return PoseErrors(np.linalg.norm(twists[:, :3], axis=1), np.linalg.norm(twists[:, 3:], axis=1))

    here = np.zeros(2000)
    model = fit_bias_model(errors(true, here), errors(hold_out, here), errors(hold_out, distances_m), distances_m)
    assert (model.sd_at_reference_m, model.sd_at_reference_rad) == pytest.approx((0.03, 0.01), rel=0.05)
    # The squares of the growth and of the prior's 0.1 are averaged.
    assert (model.sd_growth_m, model.sd_growth_rad) == pytest.approx((0.1, np.sqrt(0.025)), rel=0.12)


def test_prior_gives_some_growth_where_errors_away_are_no_larger() -> None:
    at_reference = PoseErrors(np.full(9, 0.1), np.full(9, 0.1))
    away = PoseErrors(np.full(9, 0.08), np.full(9, 0.2))
    model = fit_bias_model(at_reference, at_reference, away, np.full(9, 0.5))
    assert model.sd_growth_m == pytest.approx(np.sqrt(0.5) * 0.1) and model.sd_growth_rad > model.sd_growth_m


def test_prior_is_all_without_errors_away() -> None:
    at_reference, none = PoseErrors(np.full(9, 0.1), np.full(9, 0.1)), PoseErrors(np.zeros(0), np.zeros(0))
    model = fit_bias_model(at_reference, at_reference, none, np.zeros(0))
    assert model.sd_growth_m == model.sd_growth_rad == 0.1


def test_errors_of_any_size_give_a_model_that_a_bundle_may_state() -> None:
    """Eight metres off, beside the reference poses."""
    at_reference, wild = PoseErrors(np.full(9, 0.05), np.full(9, 0.02)), PoseErrors(np.full(9, 8.0), np.full(9, 3.0))
    model = fit_bias_model(at_reference, at_reference, wild, np.full(9, 0.01))
    assert model.sd_growth_m == model.sd_growth_rad == MOST_SD
    assert BiasModel.model_validate(model.model_dump()) == model


# --- The measurement ---


class _NumberedFrames:
    """A recording whose images show the numbers of their frames."""

    def __init__(self, poses: FloatArray) -> None:
        self.poses, self.timestamps_s = poses, 0.1 * np.arange(len(poses))

    def __len__(self) -> int:
        return len(self.poses)

    def color(self, index: int) -> NDArray[np.uint8]:
        return np.full((1, 1, 3), index, dtype=np.uint8)


class _FakeLocalizer:
    """Its pose is the true one times the exponential of an error: a twist by frame, previous frame and step."""

    def __init__(self, poses: FloatArray, error: Callable[[int, int, int], Any]) -> None:
        self._poses, self._error = poses, error
        self.frames: list[int] = []

    def step(self, color: NDArray[np.uint8], elapsed_s: float) -> SimpleNamespace:
        index, previous = int(color[0, 0, 0]), self.frames[-1] if self.frames else 0
        pose = self._poses[index] @ se3_exp(self._error(index, previous, len(self.frames)))
        self.frames.append(index)
        return SimpleNamespace(particle_estimate=SimpleNamespace(pose=pose))


@pytest.mark.parametrize(("places", "frames_each"), [(1, 200), (3, 6), (30, 1)])
def test_trajectories_are_long_enough_to_forget_their_start(places: int, frames_each: int) -> None:
    """Every localizer starts at the true pose and drifts to its error within ten frames; that error is measured."""
    poses = np.tile(np.eye(4), (places * frames_each, 1, 1))
    poses[:, 2, 3] = np.repeat(5.0 * np.arange(places), frames_each)
    made: list[_FakeLocalizer] = []

    def make(_: FloatArray) -> _FakeLocalizer:
        made.append(_FakeLocalizer(poses, lambda _i, _p, step: [0.1 * min(1.0, step / 10.0), 0, 0, 0, 0, 0]))
        return made[-1]

    model, reference_poses = measure_bias_at_reference(make, _NumberedFrames(poses), False, NoProgress())
    # The median length of Gaussian errors with this deviation an axis is a decimetre.
    assert model.sd_at_reference_m == pytest.approx(0.1 / np.sqrt(CHI2_MEDIAN_3), rel=0.1)
    frames = [index for localizer in made for index in localizer.frames]
    assert len({index // frames_each for index in frames}) >= min(places, 8)
    assert len(frames) <= max(200, 8 * 70)
    assert not reference_poses.forward_bias.any() and not reference_poses.backward_bias.any()


def test_single_frame_is_looked_at_until_the_start_is_forgotten() -> None:
    """A localizer leaves out an image that is the previous one, bit for bit, and would keep its true start."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 2, 3] = 5.0 * np.arange(3)
    images: list[NDArray[np.uint8]] = []
    is_look: list[bool] = []

    class Frames(_NumberedFrames):
        def color(self, index: int) -> NDArray[np.uint8]:
            return np.full((9, 9, 3), index, dtype=np.uint8)

    class Looker(_FakeLocalizer):
        def step(self, color: NDArray[np.uint8], elapsed_s: float) -> SimpleNamespace:
            if self.frames:
                is_look.append(elapsed_s > 0.0 and not np.array_equal(color, images[-1]))
            images.append(color)
            return super().step(np.full((1, 1, 3), np.median(color), dtype=np.uint8), elapsed_s)

    def make(_: FloatArray) -> _FakeLocalizer:
        return Looker(poses, lambda _i, _p, _s: np.zeros(6))

    measure_bias_at_reference(make, Frames(poses), False, NoProgress())
    assert len(is_look) == 3 * 60 and all(is_look)
    assert all(np.ptp(image.astype(np.int64)) <= 1 for image in images)  # it shows the same


@pytest.mark.parametrize(
    ("frames", "regions"), [(200, [[90, 91]]), (200, [[90]]), (30, [[20, 21]]), (29, [[20, 21]]), (200, [])]
)
def test_bias_of_the_place_is_known_and_has_no_deviation(frames: int, regions: list[list[int]]) -> None:
    """On a long segment; on a short one, or without held-out frames, it is only known how large it is."""
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 2, 3] = np.linspace(0.0, 4.0, frames)
    of_place_m = 0.1 * np.sin(np.linspace(0.0, 9.0, frames))
    of_direction_m = 0.05

    def error(index: int, previous: int, _: int) -> list[float]:
        return [of_place_m[index], np.copysign(of_direction_m, index - previous - 0.5), 0.0, 0.0, 0.0, 0.0]

    def make(_: FloatArray) -> _FakeLocalizer:
        return localizer

    localizer = _FakeLocalizer(poses, error)
    held_out = [np.array(region) for region in regions]
    model, reference_poses, check = measure_bias(make, make, _NumberedFrames(poses), held_out, NoProgress())
    is_known = frames >= 30 and len(regions) > 0
    assert (check is not None and check.helps) == is_known
    np.testing.assert_array_equal(reference_poses.poses, poses)
    for bias, sideways_m in (
        (reference_poses.forward_bias, of_direction_m),
        (reference_poses.backward_bias, -of_direction_m),
    ):
        np.testing.assert_allclose(bias[:, 0], of_place_m if is_known else 0.0, atol=1e-12)
        np.testing.assert_allclose(bias[1:-1, 1], sideways_m if is_known else 0.0, atol=1e-12)
        assert not bias[:, 2:].any()
    np.testing.assert_allclose(reference_poses.common_bias[:, 0], of_place_m if is_known else 0.0, atol=1e-12)
    # At the turning points, both directions have the same bias.
    np.testing.assert_allclose(reference_poses.common_bias[:, 1], 0.0, atol=1e-3)
    # The bias of the direction is not known for another direction.
    lengths = np.full(frames, of_direction_m) if is_known else np.hypot(of_direction_m, of_place_m)
    assert model.sd_at_reference_m == pytest.approx(np.median(lengths) / np.sqrt(CHI2_MEDIAN_3), rel=0.05)
    assert (model.sd_growth_m > 0.0) == bool(regions) and np.isfinite(model.sd_growth_m)


@pytest.mark.parametrize("seed", range(8))
def test_nothing_is_decided_where_no_segment_is_long_enough_to_know_a_bias_of(seed: int) -> None:
    """The errors before and after are the same but for rounding."""
    rng = np.random.default_rng(seed)
    poses, errors = se3_exp(0.1 * rng.normal(size=(12, 6))), 0.05 * rng.normal(size=(12, 6))

    def make(_: FloatArray) -> _FakeLocalizer:
        return _FakeLocalizer(poses, lambda index, _p, _s: errors[index])

    regions = [np.array([5]), np.array([9])]
    model, reference_poses, check = measure_bias(make, make, _NumberedFrames(poses), regions, NoProgress())
    assert check is None and not reference_poses.common_bias.any()
    assert model.sd_at_reference_m > 0.0


def test_bias_is_not_known_where_knowing_it_does_harm_on_held_out_frames() -> None:
    """There the hold-out localizer's bias is the opposite of that at the frames around."""
    poses = np.tile(np.eye(4), (200, 1, 1))
    poses[:, 2, 3] = np.linspace(0.0, 4.0, 200)
    held_out = np.arange(90, 94)

    def localizer(sign: float) -> Callable[[FloatArray], _FakeLocalizer]:
        def error(index: int, previous: int, _: int) -> list[float]:
            of_direction_m = np.copysign(0.02, index - previous - 0.5)
            return [sign * 0.1 if index in held_out else 0.1, of_direction_m, 0.0, 0.0, 0.0, 0.0]

        return lambda _: _FakeLocalizer(poses, error)

    model, reference_poses, check = measure_bias(
        localizer(1.0), localizer(-1.0), _NumberedFrames(poses), [held_out], NoProgress()
    )
    assert check is not None and not check.helps
    assert check.before_m == pytest.approx(np.hypot(0.1, 0.02)) and check.after_m > check.before_m + 0.01
    assert not reference_poses.forward_bias.any() and not reference_poses.backward_bias.any()
    assert model.sd_at_reference_m == pytest.approx(np.hypot(0.1, 0.02) / np.sqrt(CHI2_MEDIAN_3))


def test_measured_localizers_neither_relocalize_nor_use_known_bias(mixture: GaussianMixture) -> None:
    recording = RoomRecording(Room(), make_path(2))
    bundle = make_bundle(mixture, recording, range(2))
    assert len(bundle.reference_poses) == 2
    localizer = localizer_factory(bundle, seed=0)(recording.poses[0] @ se3_exp([9.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    steps = [localizer.step(recording.color(index), 20.0 * FRAME_S) for index in range(2)]
    assert all(step.mode is Mode.TRACKING and step.landmark_pose is None for step in steps)


def test_measured_localizers_keep_no_budget(mixture: GaussianMixture) -> None:
    recording = RoomRecording(Room(), make_path(1))
    bundle = make_bundle(mixture, recording, range(1))
    bundle = replace(bundle, settings=bundle.settings.model_copy(update={"budget_ms": 1e-6}))
    localizer = localizer_factory(bundle, seed=0)(recording.poses[0])
    levels = [localizer.step(recording.color(0), FRAME_S).level for _ in range(7)]
    assert levels == 7 * [Level.FULL]
