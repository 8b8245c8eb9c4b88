"""What the network and the map are tuned on: views of the build frames, their frozen features cached."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from monoloc.camera import Camera
from monoloc.datasets.base import Recording
from monoloc.depth.augment import AugmentConfig, View, random_exposure, random_view, whole_view
from monoloc.depth.network import DepthNetwork
from monoloc.depth.runtime import network_size
from monoloc.depth.train import network_input

VIEW_AUGMENT = AugmentConfig(mirror=False, roll_deg=10.0, zoom_max=1.4, aspect=0.05, exposure_stops=0.7)

DepthImages = Callable[[int], NDArray[np.float32]]


@dataclass(frozen=True)
class Views:
    """V views of posed frames.

    Attributes:
        taps: the encoder's feature maps, one (V, C, h, w) tensor a stage.
        depth_m: (V, 1, H, W) supervision at the network's input size, 0 where there is none.
        log_focal_ratio: (V,) to be added to the network's log-depth.
        rays_world: (V, h * w, 3) directions of the output's pixels with camera z = 1.
        origins: (V, 3) camera centres, world frame.
        frame: (V,) index of the frame each view shows; ``whole`` (V,) whether it shows it as at run time.
    """

    taps: list[Tensor]
    depth_m: Tensor
    log_focal_ratio: Tensor
    rays_world: Tensor
    origins: Tensor
    frame: Tensor
    whole: Tensor

    def __len__(self) -> int:
        return len(self.frame)

    def of_frames(self, frames: Sequence[int] | NDArray[np.int64], only_whole: bool = False) -> Views:
        """The views that show certain frames."""
        chosen = torch.isin(self.frame, torch.as_tensor(np.asarray(frames)))
        return self[torch.nonzero(chosen & self.whole if only_whole else chosen).ravel()]

    def __getitem__(self, index: Tensor) -> Views:
        return Views(
            [tap[index].contiguous(memory_format=torch.channels_last) for tap in self.taps],
            self.depth_m[index],
            self.log_focal_ratio[index],
            self.rays_world[index],
            self.origins[index],
            self.frame[index],
            self.whole[index],
        )


@torch.no_grad()
def make_views(
    recording: Recording,
    depth_of: DepthImages,
    network: DepthNetwork,
    extra_views: int,
    rng: np.random.Generator,
    progress: Callable[[int], None] | None = None,
) -> Views:
    """The whole view of every frame and ``extra_views`` random ones, through the frozen encoder.

    Args:
        recording: posed frames.
        depth_of: supervision of frame i, (H, W) metres, 0 where there is none: sensor depth or the map's.
    """
    assert recording.poses is not None
    network.eval()
    size = network_size(recording.camera, network.config.focal_px)
    small = recording.camera.resized(size[0] * 2, size[1] * 2)  # enough for the views' largest zoom
    taps: list[list[Tensor]] = []
    depth, ratio, rays, origins, frame, whole = [], [], [], [], [], []
    for index in range(len(recording)):
        color = np.asarray(
            cv2.resize(recording.color(index), (small.width, small.height), interpolation=cv2.INTER_AREA),
            np.uint8,
        )
        target = cv2.resize(depth_of(index), (small.width, small.height), interpolation=cv2.INTER_NEAREST_EXACT)
        views = list(_views_of(color, np.asarray(target, np.float32), small, size, extra_views, rng))
        taps.append(network.encoder(network_input([view.color for view in views])))
        for view in views:
            depth.append(view.depth_m)
            ratio.append(np.log(view.focal_px / network.config.focal_px))
            rays.append(_view_rays(view, small) @ recording.poses[index][:3, :3].T)
        origins += [recording.poses[index][:3, 3]] * len(views)
        frame += [index] * len(views)
        whole += [True] + [False] * extra_views
        if progress is not None:
            progress(index + 1)
    return Views(
        taps=[torch.cat(stage) for stage in zip(*taps, strict=True)],
        depth_m=torch.from_numpy(np.stack(depth))[:, None],
        log_focal_ratio=torch.tensor(ratio, dtype=torch.float32),
        rays_world=torch.from_numpy(np.stack(rays)),
        origins=torch.from_numpy(np.stack(origins)),
        frame=torch.tensor(frame),
        whole=torch.tensor(whole),
    )


def _views_of(
    color: NDArray[np.uint8],
    depth_m: NDArray[np.float32],
    camera: Camera,
    size: tuple[int, int],
    extra_views: int,
    rng: np.random.Generator,
) -> Iterator[View]:
    yield whole_view(color, depth_m, camera, size)
    for _ in range(extra_views):
        view = random_view(color, depth_m, camera, size, VIEW_AUGMENT, rng)
        exposed = random_exposure(view.color, VIEW_AUGMENT, rng)
        yield View(exposed, view.depth_m, view.linear, view.offset, view.focal_px)


def _view_rays(view: View, camera: Camera) -> NDArray[np.float64]:
    """Rays of the network's output pixels, a quarter of the view's size, in the camera's frame: (h * w, 3)."""
    height, width = view.depth_m.shape
    v, u = np.mgrid[0 : height // 4, 0 : width // 4].reshape(2, -1)
    pixels = 4.0 * np.stack([u, v], axis=1) + 1.5
    return camera.rays(pixels @ view.linear.T + view.offset)
