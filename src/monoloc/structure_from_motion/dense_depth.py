"""Dense depth of all frames of a model, without what their neighbours contradict."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.recording import Recording
from monoloc.progress import Progress
from monoloc.structure_from_motion.plane_sweep import Image, sweep_depth
from monoloc.structure_from_motion.sparse_model import SparseModel
from monoloc.structure_from_motion.view_selection import neighbours_of

_WIDTH = 160  # of the depth images
_NEIGHBOURS = 6
_LEAST_KNOWN = 10  # points of a frame that bound its depth
_AGREEMENT = 0.04  # relative difference of depth in two frames, below which they agree
_LEAST_AGREEING = 2  # frames
_LEAST_CORRELATION = 0.5


def dense_depth(recording: Recording, model: SparseModel, progress: Progress) -> list[NDArray[np.float32]]:
    """Depth of each of the model's frames: (h, w) registered to the model's camera at 160 pixels' width.

    It is in the unit of the model, and 0 where it is unknown: where there is no texture, and where fewer than two
    neighbouring frames found the same surface.

    Raises:
        DataError: a frame cannot be read.
    """
    small = small_camera(model.camera)
    pinhole = Camera(small.width, small.height, small.fx, small.fy, small.cx, small.cy, is_window=small.is_window)
    neighbours = neighbours_of(model, _NEIGHBOURS)
    with progress.task("depth", len(model.frames)) as step:
        images = [_pinhole_image(recording.color(int(index)), model.camera, pinhole) for index in model.frames]
        depths = []
        for frame in range(len(model.frames)):
            depths.append(_depth_of(frame, images, model, pinhole, neighbours[frame]))
            step(frame + 1)
    rays = pinhole.pixel_rays()
    consistent = [
        np.where(_agreeing(frame, depths, model.poses, rays, pinhole, neighbours[frame]), depths[frame], 0.0)
        for frame in range(len(depths))
    ]
    to_small = _maps(small, pinhole)
    return [
        np.asarray(cv2.remap(depth.astype(np.float32), *to_small, cv2.INTER_NEAREST, borderValue=0.0), np.float32)
        for depth in consistent
    ]


def small_camera(camera: Camera) -> Camera:
    """The camera of the depth images."""
    width = min(_WIDTH, camera.width)
    return camera.resized(width, max(1, round(camera.height * width / camera.width)))


def _maps(camera: Camera, other: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pixel of another camera's image, of the same place, at each pixel of a camera, (h, w) each."""
    pixels = other.project(camera.pixel_rays()).astype(np.float32)
    return np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])


def _pinhole_image(color: NDArray[np.uint8], camera: Camera, pinhole: Camera) -> Image:
    """The image (H, W, 3) as a small camera without distortion sees it, (h, w) grey."""
    small = camera.resized(pinhole.width, pinhole.height)
    resized = cv2.resize(color, (small.width, small.height), interpolation=cv2.INTER_AREA)
    gray = cv2.cvtColor(resized, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.asarray(
        cv2.remap(gray, *_maps(pinhole, small), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32
    )


def _depth_of(
    frame: int, images: Sequence[Image], model: SparseModel, pinhole: Camera, neighbours: Sequence[int]
) -> Image:
    """Depth of a frame where its texture correlates, else 0, (h, w)."""
    known = model.depth(frame)
    if len(known) < _LEAST_KNOWN or len(neighbours) < _LEAST_AGREEING:
        return np.zeros_like(images[frame])
    depth, correlation = sweep_depth(images, model.poses, pinhole, frame, neighbours, known)
    return np.where(correlation >= _LEAST_CORRELATION, depth, np.float32(0.0))


def _agreeing(
    frame: int,
    depths: Sequence[Image],
    poses: FloatArray,
    rays: FloatArray,
    pinhole: Camera,
    neighbours: Sequence[int],
) -> NDArray[np.bool_]:
    """Pixels (h, w) of a frame whose surface at least two neighbours found in the same place."""
    points_world = transform(poses[frame], (depths[frame][..., None] * rays).reshape(-1, 3))
    count = np.zeros(len(points_world), dtype=np.int64)
    for other in neighbours:
        local = transform(invert(poses[other]), points_world)
        pixels = np.nan_to_num(pinhole.project(local), nan=-1e4).astype(np.float32)
        found = cv2.remap(
            depths[other],
            np.ascontiguousarray(pixels[:, 0]),
            np.ascontiguousarray(pixels[:, 1]),
            cv2.INTER_NEAREST,
            borderValue=0.0,
        ).ravel()
        count += np.abs(found - local[:, 2]) < _AGREEMENT * local[:, 2]
    agreeing = (count >= _LEAST_AGREEING).reshape(depths[frame].shape)
    return np.asarray(agreeing & (depths[frame] > 0.0))
