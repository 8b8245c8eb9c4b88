"""Batches to train on and frames to validate on: canonical depth, order, workers, metrics."""

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

from depth_helpers import NEUTRAL_AUGMENT, ROOM, SMALL_CAMERA, TINY, looking_around, small_recording
from monoloc.camera import Camera
from monoloc.depth.spec import image_tensor, network_size
from monoloc.depth.training.augment import AugmentConfig
from monoloc.depth.training.examples import TrainingFrames, ValidationFrames
from monoloc.depth.training.network import DepthNetwork
from monoloc.errors import DataError
from monoloc.io.recording import Recording, Selection
from synthetic_room import RoomRecording

pytestmark = pytest.mark.usefixtures("one_thread")


class Wall(RoomRecording):
    """A wall of one depth that fills the image."""

    def __init__(self, frames: int, depth_m: float, camera: Camera = SMALL_CAMERA) -> None:
        super().__init__(ROOM, looking_around(frames), camera)
        self.depth_m = depth_m

    def depth(self, index: int) -> NDArray[np.float32]:
        return np.full((self.camera.height, self.camera.width), self.depth_m, dtype=np.float32)


class WithDepthAt(RoomRecording):
    """The small recording, with a given depth at some pixels of one frame."""

    def __init__(self, frames: int, frame: int, where: tuple[slice | int, ...], value: float) -> None:
        super().__init__(ROOM, looking_around(frames), SMALL_CAMERA)
        self.frame, self.where, self.value = frame, where, value

    def depth(self, index: int) -> NDArray[np.float32]:
        depth_m = super().depth(index).copy()
        if index == self.frame:
            depth_m[self.where] = self.value
        return depth_m


class Numbered(RoomRecording):
    """The room, its frames' depth replaced by their numbers."""

    def depth(self, index: int) -> NDArray[np.float32]:
        return np.full((self.camera.height, self.camera.width), 1.0 + index, dtype=np.float32)


def frames_of(recording: Recording, augment: AugmentConfig = NEUTRAL_AUGMENT) -> TrainingFrames:
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
    zoom = NEUTRAL_AUGMENT.model_copy(update={"zoom_max": 2.0})
    zoomed = epoch_depth(frames_of(wall, zoom), 2) / plain[0, 0, 0, 0]
    assert 0.5 - 1e-5 <= float(zoomed.min()) < 0.9 and float(zoomed.max()) <= 1.0 + 1e-5


def test_epoch_leaves_out_frames_that_fill_no_batch() -> None:
    frames = frames_of(Wall(8, 2.0))
    assert len(frames) == 8
    assert len(epoch_depth(frames, 3)) == 6


def test_epoch_shows_every_frame_once_in_a_new_order() -> None:
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
@settings(max_examples=5)
def test_workers_divide_the_batches_of_one_worker(
    room_frames: TrainingFrames, seed: int, epoch: int, workers: int
) -> None:
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


def test_every_epoch_draws_new_views(room_frames: TrainingFrames) -> None:
    first, same, next_epoch, other_seed = (
        torch.cat([images for images, _ in room_frames.epoch(seed, epoch, 3)])
        for seed, epoch in ((0, 0), (0, 0), (0, 1), (1, 0))
    )
    torch.testing.assert_close(first, same, rtol=0.0, atol=0.0)
    for other in (next_epoch, other_seed):
        # Not only in another order: no image is there twice.
        assert float((first[:, None] - other[None]).abs().mean((2, 3, 4)).min()) > 0.01


def test_epoch_can_be_closed_early(room_frames: TrainingFrames) -> None:
    batches = room_frames.epoch(0, 0, 2)
    next(batches)
    batches.close()  # type: ignore[attr-defined]
    assert len(list(room_frames.epoch(0, 0, 2))) == 4


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_depth_that_holds_nan_names_the_frame(value: float) -> None:
    room = WithDepthAt(4, frame=2, where=(5, 7), value=value)
    with pytest.raises(DataError, match="000002: depth holds NaN; mark missing depth with 0"):
        frames_of(room)


def test_frames_read_are_counted() -> None:
    done: list[int] = []
    TrainingFrames([small_recording(3)], TINY.focal_px, NEUTRAL_AUGMENT, done.append)
    assert done == [1, 2, 3]


def validate(network: DepthNetwork, recording: Recording) -> tuple[float, float]:
    return ValidationFrames(recording, TINY.focal_px).evaluate(network, torch.device("cpu"))


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
    """A canonical depth of 2 m is right where a wall stands at 2 m times the ratio of focal lengths."""
    ratio = camera.resized(*network_size(camera, TINY.focal_px)).focal_px / TINY.focal_px
    assert validate(constant_network(2.0), Wall(2, 2.0 * ratio, camera)) == pytest.approx((0.0, 1.0), abs=1e-5)
    absrel, delta1 = validate(constant_network(2.0), Wall(2, 1.0 * ratio, camera))
    assert absrel == pytest.approx(1.0, abs=1e-5)
    assert delta1 == 0.0


def test_validation_skips_frames_without_depth() -> None:
    recording = WithDepthAt(3, frame=1, where=(slice(None),), value=0.0)
    some = validate(constant_network(2.0), recording)
    others = validate(constant_network(2.0), Selection(recording, [0, 2]))
    assert some == pytest.approx(others)


def test_recording_without_depth_cannot_validate() -> None:
    with pytest.raises(DataError, match="room: has no frame with depth to validate on; choose other frames"):
        ValidationFrames(Wall(2, 0.0), TINY.focal_px)


@pytest.mark.parametrize("factor", [0.25, 1.0])
def test_validation_sees_what_the_runtime_sees(factor: float) -> None:
    """Also where images are smaller than the network's input."""
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


def test_validation_metrics_are_means_over_images() -> None:
    """More images than one batch, of walls at increasing distances, for a network that predicts one metre."""
    focal_px = SMALL_CAMERA.resized(*network_size(SMALL_CAMERA, TINY.focal_px)).focal_px
    recording = Numbered(ROOM, np.repeat(looking_around(1), 30, axis=0), SMALL_CAMERA)
    absrel, delta1 = validate(constant_network(TINY.focal_px / focal_px), recording)
    assert absrel == pytest.approx(float(np.mean(1.0 - 1.0 / np.arange(1, 31))), abs=1e-5)
    assert delta1 == pytest.approx(1.0 / 30.0)
