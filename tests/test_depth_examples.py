"""What a depth network is trained and judged on: views of frames, their exposure, and batches of them."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from torch import Tensor

from depth_helpers import ROOM, SMALL_CAMERA, TINY, looking_around, small_recording
from monoloc.camera import Camera
from monoloc.depth.spec import image_tensor, network_size
from monoloc.depth.training.augment import (
    AugmentConfig,
    Exposure,
    View,
    expose,
    random_exposure,
    random_view,
    whole_view,
)
from monoloc.depth.training.examples import TrainingFrames, ValidationFrames
from monoloc.depth.training.network import DepthNetwork
from monoloc.errors import DataError
from monoloc.io.recording import Recording, Selection
from synthetic_room import RoomRecording

pytestmark = pytest.mark.usefixtures("one_thread")

MANY_ELECTRONS = 1e14
PERFECT = Exposure(electrons=MANY_ELECTRONS, read_noise=0.0)
NEUTRAL = AugmentConfig(
    zoom_max=1.0,
    roll_deg=0.0,
    aspect=0.0,
    mirror=False,
    exposure_stops=0.0,
    gamma=0.0,
    contrast=0.0,
    white_balance=0.0,
    saturation=0.0,
    dim_share=0.0,
    electrons_min=MANY_ELECTRONS,
    read_noise=0.0,
    blur_px=0.0,
)


# --- Views ---

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


# --- Exposure ---


def linear(color: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Light on the sensor, 0..1, of an image with the display's curve."""
    return (color / 255.0) ** 2.2


def grey(level: int, height: int = 200, width: int = 200) -> NDArray[np.uint8]:
    return np.full((height, width, 3), level, dtype=np.uint8)


RAMP = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_neutral_exposure_by_a_perfect_sensor_changes_nothing(seed: int) -> None:
    color = np.random.default_rng(seed).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    rng = np.random.default_rng(seed)
    np.testing.assert_array_equal(expose(color, PERFECT, rng), color)
    np.testing.assert_array_equal(random_exposure(color, NEUTRAL, rng), color)


def test_neutral_exposure_by_a_good_camera_is_hardly_seen() -> None:
    exposed = expose(RAMP.repeat(50, axis=0), Exposure(), np.random.default_rng(0)).astype(int)
    difference = np.abs(exposed - RAMP)[:, 40:]
    assert difference.mean() < 1.0 and difference.max() <= 8


@pytest.mark.parametrize("stops", [-4.0, -1.0, 0.5, 1.0])
def test_a_stop_is_a_factor_of_two_in_light(stops: float) -> None:
    exposed = expose(RAMP, replace(PERFECT, stops=stops), np.random.default_rng(0))
    expected = 255.0 * np.minimum(1.0, 2.0**stops * linear(RAMP)) ** (1.0 / 2.2)
    assert np.abs(exposed - expected).max() <= 0.5 + 1e-3


def test_balance_is_a_gain_of_each_channel() -> None:
    exposed = expose(RAMP, replace(PERFECT, balance=(0.5, 1.0, 0.8)), np.random.default_rng(0))
    expected = 255.0 * (linear(RAMP) * [0.5, 1.0, 0.8]) ** (1.0 / 2.2)
    assert np.abs(exposed - expected).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("electrons", [300.0, 3000.0])
@pytest.mark.parametrize("read_noise", [0.0, 10.0])
@pytest.mark.parametrize("level", [90, 150])
def test_noise_is_that_of_counted_electrons(level: int, electrons: float, read_noise: float) -> None:
    """Poisson's variance, a mean of N electrons, and the sensor's own; the display's curve is undone.

    Both grey levels are more than four standard deviations from black and white, and noise is more than a level, so
    that rounding adds only its twelfth. A variance of 120,000 values is known to 0.4 %.
    """
    exposed = expose(grey(level), Exposure(electrons=electrons, read_noise=read_noise), np.random.default_rng(0))
    light = float(linear(grey(level, 1, 1)).mean())
    expected = (light * electrons + read_noise**2) / electrons**2
    rounding = (2.2 * light / level) ** 2 / 12.0
    assert linear(exposed).var() == pytest.approx(expected + rounding, rel=0.025)
    assert linear(exposed).mean() == pytest.approx(light, abs=5.0 * np.sqrt(expected / exposed.size) + 1e-4)


def test_noise_differs_from_pixel_to_pixel_and_from_channel_to_channel() -> None:
    exposed = expose(grey(128), Exposure(electrons=300.0), np.random.default_rng(0)) - 128.0
    channels = np.corrcoef(exposed.reshape(-1, 3).T)[~np.eye(3, dtype=bool)]
    neighbours = np.corrcoef(exposed[:, :-1].ravel(), exposed[:, 1:].ravel())[0, 1]
    assert np.abs(channels).max() < 0.03 and abs(neighbours) < 0.03


def test_the_dark_is_noisier_to_look_at() -> None:
    """Brightened on the display, as the eye sees it: the same sensor, four stops less light."""
    sensor = Exposure(electrons=1000.0)
    spread = []
    for stops in (0.0, -4.0):
        exposed = linear(expose(grey(128), replace(sensor, stops=stops), np.random.default_rng(0)))
        spread.append(exposed.std() / exposed.mean())
    assert spread[1] > 4.0 * spread[0]  # counting alone makes four times; the sensor's own noise adds to it


def test_blur_keeps_light_and_takes_detail() -> None:
    color = np.random.default_rng(0).integers(0, 200, (60, 80, 3), dtype=np.uint8)
    blurred = expose(color, replace(PERFECT, blur_px=1.5), np.random.default_rng(0))
    assert linear(blurred).mean() == pytest.approx(linear(color).mean(), rel=0.02)
    assert linear(blurred).std() < 0.4 * linear(color).std()


def test_saturation_contrast_and_gamma_are_of_the_displayed_image() -> None:
    color = np.random.default_rng(0).integers(60, 190, (20, 30, 3), dtype=np.uint8)
    shown, rng = color / 255.0, np.random.default_rng(0)
    mean = shown.mean(axis=2, keepdims=True)
    for exposure, expected in (
        (replace(PERFECT, saturation=0.0), mean + 0.0 * shown),
        (replace(PERFECT, saturation=0.6), mean + 0.6 * (shown - mean)),
        (replace(PERFECT, contrast=1.2), 0.5 + 1.2 * (shown - 0.5)),
        (replace(PERFECT, gamma=0.7), shown**0.7),
    ):
        assert np.abs(expose(color, exposure, rng) / 255.0 - expected).max() <= 0.5 / 255.0 + 1e-4


@given(st.integers(0, 100_000))
@settings(max_examples=20)
def test_exposure_is_of_the_same_form_and_repeats_with_its_seed(seed: int) -> None:
    color = np.random.default_rng(seed).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    before = color.copy()
    once, again = (random_exposure(color, AugmentConfig(), np.random.default_rng(seed)) for _ in range(2))
    assert once.shape == color.shape and once.dtype == np.uint8
    np.testing.assert_array_equal(once, again)
    np.testing.assert_array_equal(color, before)


def test_exposure_keeps_the_order_of_brightness() -> None:
    """Light, gamma and contrast are curves: without noise, blur and saturation, what was brighter still is."""
    config = AugmentConfig(electrons_min=MANY_ELECTRONS, read_noise=0.0, blur_px=0.0, saturation=0.0)
    means = []
    for seed in range(20):
        exposed = random_exposure(RAMP, config, np.random.default_rng(seed)).astype(int)
        assert (np.diff(exposed, axis=1) >= 0).all()
        means.append(exposed.mean())
    assert np.std(means) > 15.0


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_so_many_views_are_dimmed_by_so_many_stops_at_most(share: float) -> None:
    config = NEUTRAL.model_copy(update={"dim_share": share, "dim_stops": 3.0})
    rng = np.random.default_rng(0)
    light = [linear(random_exposure(grey(200, 1, 1), config, rng)).mean() for _ in range(500)]
    stops = np.log2(np.array(light) / linear(grey(200, 1, 1)).mean())
    dimmed = stops < -0.02
    # Four standard errors of a share of 500; one that draws close to no stops at all does not count.
    assert dimmed.mean() == pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / 500) + 0.02)
    assert stops.max() <= 0.02
    if share > 0.0:
        assert -3.05 <= stops.min() < -2.5
        assert stops[dimmed].mean() == pytest.approx(-1.5, abs=0.3)


def test_exposure_varies_by_no_more_than_it_is_told() -> None:
    config = NEUTRAL.model_copy(update={"exposure_stops": 0.8})
    rng = np.random.default_rng(0)
    light = [linear(random_exposure(grey(120, 1, 1), config, rng)).mean() for _ in range(300)]
    stops = np.log2(np.array(light) / linear(grey(120, 1, 1)).mean())
    assert -0.82 <= stops.min() < -0.7 and 0.7 < stops.max() <= 0.82


# --- Training examples ---


class Wall(RoomRecording):
    """A wall of one depth that fills the image."""

    def __init__(self, frames: int, depth_m: float, camera: Camera = SMALL_CAMERA) -> None:
        super().__init__(ROOM, looking_around(frames), camera)
        self.depth_m = depth_m

    def depth(self, index: int) -> NDArray[np.float32]:
        return np.full((self.camera.height, self.camera.width), self.depth_m, dtype=np.float32)


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


def frames_of(recording: Recording, augment: AugmentConfig = NEUTRAL) -> TrainingFrames:
    return TrainingFrames([recording], TINY.focal_px, augment, lambda done: None)


def epoch_depth(frames: TrainingFrames, batch_size: int) -> Tensor:
    """Canonical depth of one epoch's examples."""
    batches = list(frames.epoch(0, 0, batch_size))
    for images, depth in batches:
        assert images.shape == (batch_size, 3, 64, 96)
        assert images.dtype == torch.float32 and images.is_contiguous(memory_format=torch.channels_last)
        assert depth.shape == (batch_size, 1, 64, 96)
    return torch.cat([depth for _, depth in batches])


def test_training_depth_is_canonical() -> None:
    wall = Wall(4, 3.0)
    whole_focal_px = SMALL_CAMERA.resized(*network_size(SMALL_CAMERA, TINY.focal_px)).focal_px
    plain = epoch_depth(frames_of(wall), 2)
    np.testing.assert_allclose(plain.numpy(), 3.0 * TINY.focal_px / whole_focal_px, rtol=1e-6)
    # Magnified, the wall looks nearer to a camera that believes its focal length unchanged.
    zoom = NEUTRAL.model_copy(update={"zoom_max": 2.0})
    zoomed = epoch_depth(frames_of(wall, zoom), 2) / plain[0, 0, 0, 0]
    assert 0.5 - 1e-5 <= float(zoomed.min()) < 0.9 and float(zoomed.max()) <= 1.0 + 1e-5


def test_an_epoch_leaves_out_what_fills_no_batch() -> None:
    frames = frames_of(Wall(8, 2.0))
    assert len(frames) == 8
    assert len(epoch_depth(frames, 3)) == 6


class Numbered(RoomRecording):
    """The room, its frames' depth replaced by their numbers."""

    def depth(self, index: int) -> NDArray[np.float32]:
        return np.full((self.camera.height, self.camera.width), 1.0 + index, dtype=np.float32)


def test_an_epoch_shows_every_frame_once_in_another_order_every_time() -> None:
    frames = frames_of(Numbered(ROOM, looking_around(12), SMALL_CAMERA))
    ratio = SMALL_CAMERA.resized(96, 64).focal_px / TINY.focal_px
    orders = []
    for seed, epoch in ((0, 0), (0, 1), (1, 0)):
        depth = torch.cat([depth for _, depth in frames.epoch(seed, epoch, 4)])
        orders.append(list(np.round(depth[:, 0, 0, 0].numpy() * ratio).astype(int)))
        assert sorted(orders[-1]) == list(range(1, 13))
    assert orders[0] != orders[1] != orders[2] != orders[0]


@pytest.fixture(scope="module")
def room_frames() -> TrainingFrames:
    return frames_of(small_recording(9), AugmentConfig())


@given(st.integers(0, 1000), st.integers(0, 50), st.integers(1, 4))
@settings(max_examples=8)
def test_workers_share_the_batches_of_one(room_frames: TrainingFrames, seed: int, epoch: int, workers: int) -> None:
    alone = list(room_frames.epoch(seed, epoch, 4))
    assert len(alone) == 2
    shares = [list(room_frames.epoch(seed, epoch, 4, rank, workers)) for rank in range(workers)]
    for number, whole in enumerate(alone):
        for rank, share in enumerate(shares):
            for ours, theirs in zip(share[number], whole, strict=True):
                torch.testing.assert_close(ours, theirs[rank::workers], rtol=0.0, atol=0.0)


def test_batches_do_not_depend_on_the_number_of_processors(
    room_frames: TrainingFrames, monkeypatch: pytest.MonkeyPatch
) -> None:
    epochs = []
    for processors in (1, 16, None):
        monkeypatch.setattr(os, "cpu_count", lambda processors=processors: processors)
        epochs.append(list(room_frames.epoch(3, 5, 4)))
    for other in epochs[1:]:
        for ours, theirs in zip(other, epochs[0], strict=True):
            torch.testing.assert_close(ours, theirs, rtol=0.0, atol=0.0)


def test_every_epoch_draws_anew(room_frames: TrainingFrames) -> None:
    first, same, next_epoch, other_seed = (
        torch.cat([images for images, _ in room_frames.epoch(seed, epoch, 3)])
        for seed, epoch in ((0, 0), (0, 0), (0, 1), (1, 0))
    )
    torch.testing.assert_close(first, same, rtol=0.0, atol=0.0)
    for other in (next_epoch, other_seed):
        # Not only in another order: no image is there twice.
        assert float((first[:, None] - other[None]).abs().mean((2, 3, 4)).min()) > 0.01


def test_an_epoch_can_be_left_before_its_end(room_frames: TrainingFrames) -> None:
    batches = room_frames.epoch(0, 0, 2)
    next(batches)
    batches.close()  # type: ignore[attr-defined]
    assert len(list(room_frames.epoch(0, 0, 2))) == 4


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_depth_that_holds_nan_names_the_frame(value: float) -> None:
    room = Spoilt(4, frame=2, where=(5, 7), value=value)
    with pytest.raises(DataError, match="000002: depth holds NaN; mark missing depth with 0"):
        frames_of(room)


def test_frames_read_are_counted() -> None:
    done: list[int] = []
    TrainingFrames([small_recording(3)], TINY.focal_px, NEUTRAL, done.append)
    assert done == [1, 2, 3]


# --- Validation ---


def validate(network: DepthNetwork, recording: Recording) -> tuple[float, float]:
    return ValidationFrames(recording, TINY.focal_px).judge(network, torch.device("cpu"))


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


def test_no_frame_to_validate_on() -> None:
    with pytest.raises(DataError, match="room: has no frame with depth to validate on; choose other frames"):
        ValidationFrames(Wall(2, 0.0), TINY.focal_px)


@pytest.mark.parametrize("factor", [0.25, 0.8, 1.0])
def test_validation_sees_what_the_runtime_would(factor: float) -> None:
    """Where images are smaller than the network's input, too."""
    camera = SMALL_CAMERA.resized(round(192 * factor), round(128 * factor))
    recording = small_recording(2, camera=camera)
    given: list[Tensor] = []

    class Listening(DepthNetwork):
        def forward(self, images: Tensor) -> Tensor:
            given.append(images)
            return super().forward(images)

    validate(Listening(TINY), recording)
    size = camera.resized(*network_size(camera, TINY.focal_px))
    expected = np.concatenate([image_tensor(recording.color(index), size) for index in range(2)])
    np.testing.assert_allclose(torch.cat(given).numpy(), expected, atol=1e-6)


def test_judging_is_the_mean_over_images_of_their_errors() -> None:
    """More images than are judged at once, of walls ever farther away, by a network that says one metre."""
    focal_px = SMALL_CAMERA.resized(*network_size(SMALL_CAMERA, TINY.focal_px)).focal_px
    recording = Numbered(ROOM, np.repeat(looking_around(1), 30, axis=0), SMALL_CAMERA)
    absrel, delta1 = validate(constant_network(TINY.focal_px / focal_px), recording)
    assert absrel == pytest.approx(float(np.mean(1.0 - 1.0 / np.arange(1, 31))), abs=1e-5)
    assert delta1 == pytest.approx(1.0 / 30.0)
