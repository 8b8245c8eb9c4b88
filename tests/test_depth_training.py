"""Losses, augmentation and training of the depth network."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from torch import Tensor

from depth_helpers import ROOM, SMALL_CAMERA, TINY, looking_around, small_recording
from monoloc.camera import Camera
from monoloc.datasets.base import Recording, Selection
from monoloc.depth.augment import AugmentConfig, View, random_exposure, random_view, whole_view
from monoloc.depth.checkpoint import load_network
from monoloc.depth.losses import depth_loss, gradient_loss, log_l1_loss, masked_mean
from monoloc.depth.network import DepthNetwork
from monoloc.depth.runtime import network_size
from monoloc.depth.train import EpochRecord, TrainConfig, _batches, _Frames, train_network, validate
from monoloc.errors import DataError, SettingError
from synthetic_room import RoomRecording

pytestmark = pytest.mark.usefixtures("one_thread")

NEUTRAL = AugmentConfig(
    zoom_max=1.0,
    roll_deg=0.0,
    aspect=0.0,
    mirror=False,
    exposure_stops=0.0,
    gamma=0.0,
    contrast=0.0,
    white_balance=0.0,
    noise=0.0,
    blur_px=0.0,
)


# --- Losses ---


def random_batch(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Log-depth predicted and true, (2, 1, 12, 16) float64, and where the truth is known."""
    generator = torch.Generator().manual_seed(seed)
    shape = (2, 1, 12, 16)
    predicted = torch.randn(shape, dtype=torch.float64, generator=generator)
    truth = torch.randn(shape, dtype=torch.float64, generator=generator)
    return predicted, truth, torch.rand(shape, generator=generator) < 0.7


def test_log_l1_is_the_mean_absolute_log_ratio() -> None:
    depth = torch.tensor([1.0, 2.0, 3.0, 4.0]).log().reshape(1, 1, 2, 2)
    other = torch.tensor([2.0, 1.0, 3.0, 99.0]).log().reshape(1, 1, 2, 2)
    valid = torch.tensor([True, True, True, False]).reshape(1, 1, 2, 2)
    assert float(log_l1_loss(depth, other, valid)) == pytest.approx(2.0 * np.log(2.0) / 3.0)


@given(st.floats(-3.0, 3.0), st.integers(0, 100))
@settings(max_examples=20)
def test_gradient_loss_ignores_scale_and_log_l1_measures_it(offset: float, seed: int) -> None:
    _, truth, valid = random_batch(seed)
    assert float(gradient_loss(truth + offset, truth, valid)) == pytest.approx(0.0, abs=1e-12)
    assert float(log_l1_loss(truth + offset, truth, valid)) == pytest.approx(abs(offset), abs=1e-12)


def test_gradient_loss_of_a_ramp() -> None:
    """An error of 0.1 a column differs by 0.1 s over s columns and by nothing over rows."""
    ramp = (0.1 * torch.arange(16.0)).expand(1, 1, 16, 16)
    zero, valid = torch.zeros_like(ramp), torch.ones_like(ramp, dtype=torch.bool)
    expected = 0.1 * (1 + 2 + 4 + 8) / 4
    assert float(gradient_loss(ramp, zero, valid)) == pytest.approx(expected, rel=1e-5)
    assert float(gradient_loss(ramp.mT, zero, valid)) == pytest.approx(expected, rel=1e-5)
    assert float(gradient_loss(ramp, zero, valid, steps=(2,))) == pytest.approx(0.2, rel=1e-5)


@pytest.mark.parametrize("loss", [log_l1_loss, gradient_loss])
def test_masked_pixels_have_no_influence(loss) -> None:
    predicted, truth, valid = random_batch()
    predicted.requires_grad_(True)
    value = loss(predicted, truth, valid)
    (gradient,) = torch.autograd.grad(value, predicted)
    changed = torch.where(valid, truth, torch.full_like(truth, 1e6))
    also_changed = torch.where(valid, predicted.detach(), torch.full_like(truth, -1e3)).requires_grad_(True)
    other = loss(also_changed, changed, valid)
    (other_gradient,) = torch.autograd.grad(other, also_changed)
    torch.testing.assert_close(other, value)
    torch.testing.assert_close(other_gradient, gradient)
    assert not gradient[~valid].any()
    assert gradient[valid].any()


def test_without_truth_there_is_neither_loss_nor_gradient() -> None:
    predicted = torch.zeros(1, 1, 8, 8, requires_grad=True)
    loss = depth_loss(predicted, torch.zeros(1, 1, 32, 32), 0.5)
    loss.backward()
    assert float(loss.detach()) == 0.0
    assert predicted.grad is not None and not predicted.grad.any()
    assert float(masked_mean(torch.ones(3), torch.zeros(3, dtype=torch.bool))) == 0.0


def test_depth_loss_knows_missing_depth_by_zero() -> None:
    depth_m = torch.full((1, 1, 16, 16), 3.0)
    log_predicted = torch.full((1, 1, 4, 4), float(np.log(6.0)))
    assert float(depth_loss(log_predicted, depth_m, 0.5)) == pytest.approx(np.log(2.0), rel=1e-5)
    depth_m[..., :8, :] = 0.0
    log_predicted[..., 0, :] = 50.0  # the row of the prediction farthest from any truth
    assert float(depth_loss(log_predicted, depth_m, 0.5)) == pytest.approx(np.log(2.0), rel=1e-5)


def test_depth_loss_has_the_right_gradient() -> None:
    generator = torch.Generator().manual_seed(0)
    depth_m = 1.0 + torch.rand(1, 1, 9, 10, dtype=torch.float64, generator=generator)
    depth_m[0, 0, 2:4, 3:6] = 0.0
    predicted = torch.randn(1, 1, 3, 4, dtype=torch.float64, generator=generator, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: depth_loss(x, depth_m, 0.5), predicted)


# --- Augmentation ---

FRAME = Camera(100, 75, 90.0, 87.0, 48.0, 39.0)
LEVELS = np.array([2.0, 3.0])  # of red and green, a pixel
SIZE = (64, 48)


def coordinate_frame() -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """A frame whose red and green are a pixel's column and row, and whose depth encodes both."""
    v, u = np.mgrid[0 : FRAME.height, 0 : FRAME.width]
    color = np.stack([2 * u, 3 * v, np.full_like(u, 255)], axis=-1).astype(np.uint8)
    return color, (1.0 + u + FRAME.width * v).astype(np.float32)


def check_view(view: View) -> float:
    """Colour and depth show the frame at ``linear @ p + offset``; returns the share of pixels inside the frame."""
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].reshape(2, -1)
    expected = np.stack([columns, rows], axis=1) @ view.linear.T + view.offset
    upper = np.array([FRAME.width, FRAME.height]) - 1
    depth = view.depth_m.ravel()
    seen = depth > 0.0
    clearly_inside = ((expected > -0.4) & (expected < upper + 0.4)).all(axis=1)
    clearly_outside = ((expected < -0.6) | (expected > upper + 0.6)).any(axis=1)
    assert seen[clearly_inside].all() and not seen[clearly_outside].any()
    by_depth = np.stack(np.divmod(depth[seen].astype(np.int64) - 1, FRAME.width)[::-1], axis=1)
    assert np.abs(by_depth - expected[seen]).max() <= 0.5 + 1 / 16  # nearest, up to OpenCV's fixed point
    # Colours are averages about the pixel, so the pixel's own footprint must lie inside too.
    reach = np.abs(view.linear).sum(axis=1)
    whole = ((expected > reach) & (expected < upper - reach)).all(axis=1)
    # Twice rounded to eight bits, halves upwards.
    by_color = view.color.reshape(-1, 3)[whole, :2] / LEVELS
    assert np.abs(by_color - expected[whole]).max() < 0.6
    assert np.abs((by_color - expected[whole]).mean(axis=0)).max() < 0.3
    return float(seen.mean())


@given(st.integers(0, 100_000))
@settings(max_examples=40)
def test_random_views_show_the_frame_where_they_say(seed: int) -> None:
    color, depth_m = coordinate_frame()
    config = AugmentConfig(roll_deg=40.0, zoom_min=0.8, zoom_max=2.5)
    view = random_view(color, depth_m, FRAME, SIZE, config, np.random.default_rng(seed))
    assert view.color.shape == (48, 64, 3) and view.color.dtype == np.uint8
    assert view.depth_m.shape == (48, 64) and view.depth_m.dtype == np.float32
    check_view(view)
    assert view.focal_px == pytest.approx(FRAME.focal_px / np.sqrt(abs(np.linalg.det(view.linear))))
    whole_focal_px = FRAME.resized(*SIZE).focal_px
    # The view's middle wanders as far as the magnification leaves room inside the frame.
    middle = view.linear @ ((np.array(SIZE) - 1.0) / 2.0) + view.offset
    room = max(0.0, 1.0 - whole_focal_px / view.focal_px) * np.array([FRAME.width, FRAME.height]) / 2.0
    assert (np.abs(middle - (np.array([FRAME.width, FRAME.height]) - 1.0) / 2.0) <= room + 1e-9).all()
    assert 0.8 * whole_focal_px * (1.0 - 1e-9) <= view.focal_px <= 2.5 * whole_focal_px


def test_whole_view_is_the_resized_camera() -> None:
    view = whole_view(*coordinate_frame(), FRAME, SIZE)
    assert check_view(view) == 1.0
    small = FRAME.resized(*SIZE)
    assert view.focal_px == pytest.approx(small.focal_px)
    pixels = np.array([[0.0, 0.0], [63.0, 0.0], [20.0, 40.0]])
    np.testing.assert_allclose(FRAME.rays(pixels @ view.linear.T + view.offset), small.rays(pixels), atol=1e-12)


def test_neutral_view_is_the_whole_view() -> None:
    frame = coordinate_frame()
    neutral = random_view(*frame, FRAME, SIZE, NEUTRAL, np.random.default_rng(0))
    whole = whole_view(*frame, FRAME, SIZE)
    np.testing.assert_allclose(neutral.linear, whole.linear)
    np.testing.assert_allclose(neutral.offset, whole.offset)
    np.testing.assert_array_equal(neutral.depth_m, whole.depth_m)


def test_half_of_the_views_are_mirrored_and_none_where_it_is_off() -> None:
    frame = coordinate_frame()
    rng = np.random.default_rng(0)
    for config, low, high in ((AugmentConfig(), 70, 130), (AugmentConfig(mirror=False), 0, 0)):
        views = [random_view(*frame, FRAME, SIZE, config, rng) for _ in range(200)]
        assert low <= sum(np.linalg.det(view.linear) < 0.0 for view in views) <= high


def test_a_mirrored_view_is_mirrored_left_to_right() -> None:
    frame = coordinate_frame()
    config = NEUTRAL.model_copy(update={"mirror": True})
    views = [random_view(*frame, FRAME, SIZE, config, np.random.default_rng(seed)) for seed in range(8)]
    mirrored = [view for view in views if np.linalg.det(view.linear) < 0.0]
    assert 0 < len(mirrored) < 8
    whole = whole_view(*frame, FRAME, SIZE)
    difference = mirrored[0].color[:, ::-1].astype(int) - whole.color
    assert np.abs(difference).max() <= 1


def test_views_have_no_depth_where_the_frame_has_none() -> None:
    color, depth_m = coordinate_frame()
    depth_m[20:45, 30:60] = 0.0
    view = random_view(color, depth_m, FRAME, SIZE, AugmentConfig(zoom_max=1.0), np.random.default_rng(3))
    rows, columns = np.nonzero(view.depth_m == 0.0)
    at = np.round(np.stack([columns, rows], axis=1) @ view.linear.T + view.offset)
    hole = ((at >= [29, 19]) & (at <= [60, 45])).all(axis=1)
    outside = ((at <= 0) | (at >= [99, 74])).any(axis=1)
    assert hole.any() and (hole | outside).all()
    assert set(np.unique(view.depth_m)) <= set(np.unique(depth_m))  # depths are never mixed across an edge


@given(st.integers(0, 100_000))
@settings(max_examples=20)
def test_exposure_is_of_the_same_form_and_repeats_with_its_seed(seed: int) -> None:
    color = np.random.default_rng(seed).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    before = color.copy()
    once, again = (random_exposure(color, AugmentConfig(), np.random.default_rng(seed)) for _ in range(2))
    assert once.shape == color.shape and once.dtype == np.uint8
    np.testing.assert_array_equal(once, again)
    np.testing.assert_array_equal(color, before)


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_neutral_exposure_changes_nothing(seed: int) -> None:
    color = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    np.testing.assert_array_equal(random_exposure(color, NEUTRAL, np.random.default_rng(seed)), color)


def test_exposure_keeps_the_order_of_brightness() -> None:
    """Light, gamma and contrast are curves: without noise and blur, what was brighter still is."""
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    config = AugmentConfig(noise=0.0, blur_px=0.0)
    means = []
    for seed in range(20):
        exposed = random_exposure(ramp, config, np.random.default_rng(seed)).astype(int)
        assert (np.diff(exposed, axis=1) >= 0).all()
        means.append(exposed.mean())
    assert np.std(means) > 15.0


# --- Training examples ---


class Wall(RoomRecording):
    """A wall of one depth that fills the image."""

    def __init__(self, frames: int, depth_m: float, camera: Camera = SMALL_CAMERA) -> None:
        super().__init__(ROOM, looking_around(frames), camera)
        self.depth_m = depth_m

    def depth(self, index: int) -> NDArray[np.float32]:
        return np.full((self.camera.height, self.camera.width), self.depth_m, dtype=np.float32)


class FourfoldDepth(RoomRecording):
    """A depth sensor that reads four times too far: an untrained network starts far off."""

    def depth(self, index: int) -> NDArray[np.float32]:
        return super().depth(index) * np.float32(4.0)


class Spoilt(RoomRecording):
    """The small recording with one frame's depth spoilt."""

    def __init__(self, frames: int, frame: int, where: tuple[slice | int, ...], value: float) -> None:
        super().__init__(ROOM, looking_around(frames), SMALL_CAMERA)
        self.spoilt, self.where, self.value = frame, where, value

    def depth(self, index: int) -> NDArray[np.float32]:
        depth_m = super().depth(index).copy()
        if index == self.spoilt:
            depth_m[self.where] = self.value
        return depth_m


def training_depth(config: TrainConfig, recording: Recording) -> Tensor:
    """Canonical depth of one epoch's examples."""
    size = network_size(recording.camera, config.network.focal_px)
    frames = _Frames(recording, size, config.augment.zoom_max)
    batches = list(_batches(frames, size, config, np.random.default_rng(0)))
    for images, depth in batches:
        assert images.shape == (config.batch_size, 3, size[1], size[0])
        assert depth.shape == (config.batch_size, 1, size[1], size[0])
    return torch.cat([depth for _, depth in batches])


def test_training_depth_is_canonical() -> None:
    wall = Wall(4, 3.0)
    whole_focal_px = SMALL_CAMERA.resized(*network_size(SMALL_CAMERA, TINY.focal_px)).focal_px
    plain = training_depth(TrainConfig(network=TINY, augment=NEUTRAL, batch_size=2), wall)
    np.testing.assert_allclose(plain.numpy(), 3.0 * TINY.focal_px / whole_focal_px, rtol=1e-6)
    # Magnified, the wall looks nearer to a camera that believes its focal length unchanged.
    zoom = NEUTRAL.model_copy(update={"zoom_max": 2.0})
    zoomed = training_depth(TrainConfig(network=TINY, augment=zoom, batch_size=2), wall) / plain[0, 0, 0, 0]
    assert 0.5 - 1e-5 <= float(zoomed.min()) < 0.9 and float(zoomed.max()) <= 1.0 + 1e-5


def test_an_epoch_leaves_out_what_fills_no_batch() -> None:
    assert len(training_depth(TrainConfig(network=TINY, batch_size=3), Wall(8, 2.0))) == 6


def constant_network(depth_m: float) -> DepthNetwork:
    torch.manual_seed(0)
    network = DepthNetwork(TINY)
    network.head.weight.data.zero_()
    network.head.bias.data.fill_(np.log(depth_m))
    return network


@pytest.mark.parametrize(
    "camera", [SMALL_CAMERA, replace(SMALL_CAMERA, fx=150.0, fy=150.0), SMALL_CAMERA.cropped(20, 0, 140, 110)]
)
def test_validation_is_metric_for_any_camera(camera: Camera) -> None:
    """A network that says two canonical metres is right where a wall stands at two metres times the ratio of foci."""
    ratio = camera.resized(*network_size(camera, TINY.focal_px)).focal_px / TINY.focal_px
    assert validate(constant_network(2.0), Wall(2, 2.0 * ratio, camera)) == pytest.approx((0.0, 1.0), abs=1e-5)
    absrel, delta1 = validate(constant_network(2.0), Wall(2, 1.0 * ratio, camera))
    assert absrel == pytest.approx(1.0, abs=1e-5)
    assert delta1 == 0.0


def test_validation_passes_over_frames_without_depth() -> None:
    recording = Spoilt(3, frame=1, where=(slice(None),), value=0.0)
    some = validate(constant_network(2.0), recording)
    others = validate(constant_network(2.0), Selection(recording, [0, 2]))
    assert some == pytest.approx(others)


# --- Training ---

SHORT = TrainConfig(network=TINY, epochs=4, batch_size=4, learning_rate=0.03, ema_decay=0.5)


def without_seconds(history: list[EpochRecord]) -> list[EpochRecord]:
    return [replace(record, seconds=0.0) for record in history]


def train_in_room(
    folder: Path, config: TrainConfig = SHORT, progress: Callable[[EpochRecord], None] | None = None
) -> list[EpochRecord]:
    training = FourfoldDepth(ROOM, looking_around(12), SMALL_CAMERA)
    return train_network(training, small_recording(2, seed=1), config, folder, progress=progress)


def test_training_learns_repeats_and_writes_what_it_learnt(tmp_path: Path) -> None:
    reported: list[EpochRecord] = []
    folder = tmp_path / "runs" / "a"
    history = train_in_room(folder, progress=reported.append)
    assert [record.epoch for record in history] == [0, 1, 2, 3]
    assert reported == history
    assert history[-1].train_loss < 0.75 * history[0].train_loss
    assert json.loads((folder / "history.json").read_text()) == [asdict(record) for record in history]
    network = load_network(folder / "network.safetensors")
    assert network.config == TINY
    assert validate(network, small_recording(2, seed=1)) == pytest.approx(
        (history[-1].absrel, history[-1].delta1), abs=1e-4
    )

    assert without_seconds(train_in_room(tmp_path / "b")) == without_seconds(history)
    other = train_in_room(tmp_path / "c", SHORT.model_copy(update={"seed": 1, "epochs": 1}))
    assert other[0].train_loss != history[0].train_loss


def test_training_starts_from_the_encoder_weights_it_is_given(tmp_path: Path) -> None:
    torch.manual_seed(5)
    state = DepthNetwork(TINY).encoder.state_dict()
    np.savez(tmp_path / "encoder.npz", **{name: tensor.numpy() for name, tensor in state.items()})
    config = SHORT.model_copy(update={"epochs": 1, "learning_rate": 1e-12, "ema_decay": 0.0})
    room = small_recording(4)
    train_network(room, room, config, tmp_path, encoder_weights=tmp_path / "encoder.npz")
    trained = load_network(tmp_path / "network.safetensors").encoder.state_dict()
    for name in ("features.0.0.weight", "features.17.conv.2.weight"):
        torch.testing.assert_close(trained[name], state[name])


def test_a_recording_without_depth(tmp_path: Path) -> None:
    blind, seeing = small_recording(4, has_depth=False), small_recording(4)
    for training, validation in ((blind, seeing), (seeing, blind)):
        with pytest.raises(DataError, match="room: has no depth; train on a recording with depth images"):
            train_network(training, validation, SHORT, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_fewer_frames_than_a_batch(tmp_path: Path) -> None:
    room = small_recording(3)
    with pytest.raises(SettingError, match="batch_size: 4 exceeds 3 frames; use more frames"):
        train_network(room, room, SHORT, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_depth_that_holds_nan_names_the_frame(tmp_path: Path) -> None:
    room = Spoilt(4, frame=2, where=(5, 7), value=np.nan)
    with pytest.raises(DataError, match="000002: depth holds NaN; mark missing depth with 0"):
        train_network(room, room, SHORT, tmp_path)


def test_a_learning_rate_that_diverges_is_named(tmp_path: Path) -> None:
    room = small_recording(8)
    config = SHORT.model_copy(update={"learning_rate": 1e36})
    with pytest.raises(SettingError, match=r"learning_rate: 1e\+36 made the loss infinite; lower it"):
        train_network(room, room, config, tmp_path)
    assert not list(tmp_path.glob(".*"))  # and nothing half-written
