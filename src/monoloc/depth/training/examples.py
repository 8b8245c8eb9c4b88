"""Training and validation examples of a depth network, from frames with depth."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from monoloc.camera import Camera
from monoloc.depth.spec import network_size
from monoloc.depth.training.augment import AugmentConfig, random_exposure, random_view, whole_view
from monoloc.depth.training.network import DepthNetwork
from monoloc.errors import DataError
from monoloc.image_size import resize_image
from monoloc.io.recording import Recording

_BATCHES_AHEAD = 3


def network_input(images: list[NDArray[np.uint8]] | NDArray[np.uint8]) -> Tensor:
    """Convert images (H, W, 3) uint8 RGB of one size to (B, 3, H, W) in [-1, 1], channels last in memory."""
    batch = torch.from_numpy(np.asarray(images)).permute(0, 3, 1, 2)
    return (batch.float() / 127.5 - 1.0).contiguous(memory_format=torch.channels_last)


class TrainingFrames:
    """All frames of one or more recordings, in memory at no more than the resolution that views need.

    Args:
        recordings: at least one recording with depth; the first is of the kind that the network is for.
        focal_px: canonical focal length; it determines the size of the examples
            (:func:`monoloc.depth.spec.network_size`).
        augment: ranges of the random views.
        progress: called with the number of frames read.

    Raises:
        DataError: a frame cannot be read, its depth contains NaN, or the cameras' fields of view give examples of
            different sizes.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        focal_px: float,
        augment: AugmentConfig,
        progress: Callable[[int], None],
    ) -> None:
        self._size = network_size(recordings[0].camera, focal_px)
        self._focal_px = focal_px
        self._augment = augment
        self._first_count = len(recordings[0])
        self._frames: list[_Frame] = []
        for recording in recordings:
            size = network_size(recording.camera, focal_px)
            if size != self._size:
                problem = f"its views are {size[0]} x {size[1]}, those of {recordings[0].name} {self._size[0]} x "
                fix = "train on recordings of the same field of view"
                raise DataError(recording.name, f"{problem}{self._size[1]}", fix)
            for index in range(len(recording)):
                self._frames.append(self._read(recording, index))
                progress(len(self._frames))

    def _read(self, recording: Recording, index: int) -> _Frame:
        color, depth = recording.color(index), recording.depth(index)
        if not np.all(np.isfinite(depth)):
            raise DataError(recording.frame_names[index], "depth holds NaN", "mark missing depth with 0")
        full = recording.camera
        factor = min(1.0, self._augment.zoom_max * 1.25 * self._size[0] / full.width)
        camera = full.resized(round(full.width * factor), round(full.height * factor))
        shape = (camera.width, camera.height)
        return (
            resize_image(color, shape),
            np.asarray(cv2.resize(depth, shape, interpolation=cv2.INTER_NEAREST_EXACT), np.float32),
            camera,
        )

    def __len__(self) -> int:
        return len(self._frames)

    def epoch(self, seed: int, epoch: int, batch_size: int, rank: int = 0, workers: int = 1) -> Iterator[_Batch]:
        """Yield this worker's share of every batch of an epoch; threads prepare batches ahead of time.

        The examples depend only on seed and epoch, not on the number of workers or threads, so a resumed run sees the
        same examples as an uninterrupted one.
        """
        order = np.random.default_rng([seed, epoch]).permutation(len(self))
        starts = range(0, len(order) - batch_size + 1, batch_size)
        batches = [order[start : start + batch_size][rank::workers] for start in starts]
        with ThreadPoolExecutor(max(1, (os.cpu_count() or 1) // (2 * workers))) as pool:
            ahead: list[list[Future[_Example]]] = []
            for batch in batches:
                ahead.append([pool.submit(self._example, seed, epoch, int(index)) for index in batch])
                if len(ahead) > _BATCHES_AHEAD:
                    yield _stacked(ahead.pop(0))
            yield from (_stacked(futures) for futures in ahead)

    def whole(self, count: int) -> _Batch:
        """Return ``count`` evenly spaced frames of the first recording, as at run time, with canonical depth."""
        chosen = np.unique(np.linspace(0, self._first_count - 1, count).astype(int))
        views = [
            whole_view(color, depth, camera, self._size) for color, depth, camera in (self._frames[i] for i in chosen)
        ]
        depths = [view.depth_m * np.float32(self._focal_px / view.focal_px) for view in views]
        return network_input([view.color for view in views]), torch.from_numpy(np.stack(depths))[:, None]

    def _example(self, seed: int, epoch: int, index: int) -> _Example:
        rng = np.random.default_rng([seed, epoch, index])
        view = random_view(*self._frames[index], self._size, self._augment, rng)
        color = random_exposure(view.color, self._augment, rng)
        return color, view.depth_m * np.float32(self._focal_px / view.focal_px)


_Frame = tuple[NDArray[np.uint8], NDArray[np.float32], Camera]
_Example = tuple[NDArray[np.uint8], NDArray[np.float32]]
_Batch = tuple[Tensor, Tensor]


def _stacked(futures: list[Future[_Example]]) -> _Batch:
    colors, depths = zip(*(future.result() for future in futures), strict=True)
    return network_input(list(colors)), torch.from_numpy(np.stack(depths))[:, None]


class ValidationFrames:
    """Frames for validation after every epoch: whole, without augmentation."""

    def __init__(self, recording: Recording, focal_px: float) -> None:
        width, height = network_size(recording.camera, focal_px)
        self._focal_ratio = recording.camera.resized(width, height).focal_px / focal_px
        colors, self._truths = [], []
        for index in range(len(recording)):
            truth = recording.depth(index)
            if (truth > 0.0).any():
                colors.append(resize_image(recording.color(index), (width, height)))
                self._truths.append(truth)
        if not colors:
            raise DataError(recording.name, "has no frame with depth to validate on", "choose other frames")
        self._images = network_input(colors)

    @torch.no_grad()
    def evaluate(self, network: DepthNetwork, device: torch.device) -> tuple[float, float]:
        """Return AbsRel and delta1 of the metric prediction without a scale fit, mean over images."""
        network.eval()
        log_depths = torch.cat([network(images.to(device)).float().cpu() for images in torch.split(self._images, 25)])
        absrel, delta1 = [], []
        for log_depth, truth in zip(log_depths[:, 0].numpy(), self._truths, strict=True):
            valid = truth > 0.0
            predicted = cv2.resize(np.exp(log_depth), truth.shape[::-1]) * self._focal_ratio
            ratio = predicted[valid] / truth[valid]
            absrel.append(np.mean(np.abs(ratio - 1.0)))
            delta1.append(np.mean(np.maximum(ratio, 1.0 / ratio) < 1.25))
        return float(np.mean(absrel)), float(np.mean(delta1))
