"""Training views of the network and the map: the build frames, and views synthesised from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from monoloc.adapt.warp import ColoredPoints, forward_warp, halved, points_of
from monoloc.camera import Camera
from monoloc.depth.spec import network_size
from monoloc.geometry import FloatArray, pose_distance_m, se3_exp
from monoloc.image_size import resize_image
from monoloc.io.recording import Recording

DepthImages = Callable[[int], NDArray[np.float32]]

_SHIFT_SD_M, _TURN_SD_RAD = 0.2, np.deg2rad(6.0)  # of a synthesised view's pose relative to its source frame
_SOURCES = 3  # frames a synthesised view is warped from: its source frame and those nearest to the view
_WHOLE_SHARE = 0.2  # share of real frames in the training draws, however many views are synthesised
_LEAST_SEEN, _TRIES = 0.7, 5  # share of its source frame's coverage that a view must reach; poses tried for it
_CLOUDS_KEPT = 200  # of about 2 MB each; views are made in frame order and need the clouds of neighbouring frames


@dataclass(frozen=True)
class Views:
    """V views of one camera, with pose and depth.

    Attributes:
        colors: (V, H, W, 3) uint8 RGB at the network's size; a quarter of the memory of the float32 network input.
        depth_m: (V, 1, H / 2, W / 2) depth supervision, metres, 0 where there is none; twice the resolution of the
            prediction.
        log_focal_ratio: log of the focal ratio, to be added to the network's log-depth.
        rays_world: (V, h * w, 3) ray directions of the output pixels with camera z = 1, world frame.
        poses: (V, 4, 4) ``T_world_camera``.
        frame: (V,) index of the frame that each view shows.
        whole: (V,) true for the frame itself, false for a synthesised view.
    """

    colors: NDArray[np.uint8]
    depth_m: Tensor
    log_focal_ratio: float
    rays_world: Tensor
    poses: Tensor
    frame: Tensor
    whole: Tensor

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def origins(self) -> Tensor:
        """(V, 3) camera centres, world frame."""
        return self.poses[:, :3, 3]

    @property
    def rays(self) -> FloatArray:
        """(h, w, 3) ray directions of the output pixels with z = 1, camera frame; the same for all views."""
        height, width = self.output_depth_m.shape[-2:]
        return (self.rays_world[0] @ self.poses[0, :3, :3]).reshape(height, width, 3).numpy()

    @property
    def output_depth_m(self) -> Tensor:
        """(V, 1, h, w) depth supervision at the output's resolution, metres, 0 where there is none."""
        # One pixel of each 2 x 2 block, next to the centre of the output pixel.
        return self.depth_m[..., 1::2, 1::2]

    def odds(self, left_out: Sequence[int] | NDArray[np.int64] = ()) -> Tensor:
        """(V,) probability of drawing each view in training, 0 for those of some frames; they sum to one."""
        drawn = ~torch.isin(self.frame, torch.as_tensor(np.asarray(left_out, dtype=np.int64)))
        whole, synthesised = drawn & self.whole, drawn & ~self.whole
        if not synthesised.any():
            return whole / whole.sum()
        return whole * (_WHOLE_SHARE / whole.sum()) + synthesised * ((1.0 - _WHOLE_SHARE) / synthesised.sum())

    def of_frames(self, frames: Sequence[int] | NDArray[np.int64], only_whole: bool = False) -> Views:
        """Select the views of certain frames; with ``only_whole``, without synthesised views."""
        chosen = torch.isin(self.frame, torch.as_tensor(np.asarray(frames)))
        return self[torch.nonzero(chosen & self.whole if only_whole else chosen).ravel()]

    def __getitem__(self, index: Tensor) -> Views:
        return Views(
            self.colors[index.numpy()],
            self.depth_m[index],
            self.log_focal_ratio,
            self.rays_world[index],
            self.poses[index],
            self.frame[index],
            self.whole[index],
        )


def make_views(
    recording: Recording,
    depth_of: DepthImages,
    focal_px: float,
    synthesised: int,
    held_out: NDArray[np.int64],
    rng: np.random.Generator,
    progress: Callable[[int], None] | None = None,
) -> Views:
    """Make the network's view of every frame, and views synthesised nearby, spread evenly over the frames.

    Args:
        recording: posed frames.
        depth_of: returns the depth supervision of frame i, (H, W) metres, 0 where there is none: sensor depth or
            depth rendered from the map.
        focal_px: the network's canonical focal length.
        synthesised: total number of synthesised views.
        held_out: frames that must not appear in views synthesised from other frames.
        rng: draws the poses of the synthesised views.
        progress: called with the number of frames read, then with that number plus the number of frames whose
            synthesised views are done.
    """
    poses = recording.poses
    assert poses is not None
    camera = recording.camera.resized(*network_size(recording.camera, focal_px))
    fine = camera.resized(2 * camera.width, 2 * camera.height)
    coarse = camera.resized(camera.width // 2, camera.height // 2)
    fine_rays = fine.pixel_rays()
    sources: list[tuple[NDArray[np.uint8], NDArray[np.float32]]] = []
    images, depths, view_poses, frame, whole = [], [], [], [], []
    for index in range(len(recording)):
        color, depth = recording.color(index), depth_of(index)
        images.append(resize_image(color, (camera.width, camera.height)))
        depths.append(_sampled(depth, coarse))
        view_poses.append(poses[index])
        frame.append(index)
        whole.append(True)
        if synthesised:
            small = resize_image(color, (fine.width, fine.height))
            sources.append((small, _sampled(depth, fine)))
        if progress is not None:
            progress(index + 1)

    @lru_cache(_CLOUDS_KEPT)
    def cloud_of(index: int) -> ColoredPoints:
        return points_of(*sources[index], fine_rays, poses[index])

    usable = np.setdiff1d(np.arange(len(recording)), held_out)
    shares = np.diff(np.arange(len(recording) + 1) * synthesised // len(recording))
    for index, share in enumerate(shares if synthesised else ()):
        for _ in range(share):
            image, depth, pose = _synthesise(index, poses, cloud_of, usable, camera, rng)
            images.append(image)
            depths.append(halved(depth))
            view_poses.append(pose)
            frame.append(index)
            whole.append(False)
        if progress is not None:
            progress(len(recording) + index + 1)
    stacked = np.stack(view_poses)
    return Views(
        colors=np.stack(images),
        depth_m=torch.from_numpy(np.stack(depths))[:, None],
        log_focal_ratio=float(np.log(camera.focal_px / focal_px)),
        rays_world=torch.from_numpy(_output_rays(camera) @ stacked[:, :3, :3].transpose(0, 2, 1)),
        poses=torch.from_numpy(stacked),
        frame=torch.tensor(frame),
        whole=torch.tensor(whole),
    )


def _synthesise(
    index: int,
    poses: FloatArray,
    cloud_of: Callable[[int], ColoredPoints],
    usable: NDArray[np.int64],
    camera: Camera,
    rng: np.random.Generator,
) -> tuple[NDArray[np.uint8], NDArray[np.float32], FloatArray]:
    """Synthesise a view near a frame, from that frame and the usable frames nearest to the view.

    The random displacement shrinks until enough of the view has depth.

    Returns:
        Colour, depth in metres, and ``T_world_camera``.
    """
    others = usable[usable != index]
    enough = _LEAST_SEEN * len(cloud_of(index).points) / (4 * camera.width * camera.height)
    for attempt in range(_TRIES):
        spread = 1.0 - attempt / _TRIES
        sd = spread * np.repeat([_SHIFT_SD_M, _TURN_SD_RAD], 3)
        pose = poses[index] @ se3_exp(rng.normal(scale=sd))
        nearest = others[np.argsort(pose_distance_m(pose, poses[others]))[: _SOURCES - 1]]
        color, depth = forward_warp([cloud_of(int(i)) for i in (index, *nearest)], pose, camera)
        if np.mean(depth > 0.0) >= enough:
            break
    return color, depth, pose


def _sampled(depth_m: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    size = (camera.width, camera.height)
    return np.asarray(cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.float32)


def _output_rays(camera: Camera) -> FloatArray:
    """Rays of the network's output pixels (a quarter of the input's size), camera frame: (h * w, 3)."""
    v, u = np.mgrid[0 : camera.height // 4, 0 : camera.width // 4].reshape(2, -1)
    return camera.rays(4.0 * np.stack([u, v], axis=1) + 1.5)
