"""Pixels that stand still while the camera moves: parts of the drone, drops on the lens, text drawn over the image.

They show nothing of the room. Where the camera has moved between two images, each pixel of the second is predicted
from the first in two ways: as a part of the room, which has shifted, and as something that stands still. Where the
two differ, the second image decides between them, and this evidence adds up over a flight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.camera import Camera
from monoloc.depth.depth_image import sample_depth
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray, invert, transform
from monoloc.image_size import gray_image
from monoloc.odometry.motion import Motion

_WIDTH, _GRID_WIDTH = 160, 20  # px: of the compared images, and of the grid on which the room's shift is computed
_LEAST_SHIFT_PX = 4.0  # median over the image, between two compared images
# Grey levels are relative to their mean over a square, since exposure changes, and a lamp on the drone lights the
# same part of every image. The mean counts as no darker than a level at which noise would look like texture.
_LIGHT_PX, _MEAN, _DARK = 51, 100.0, 16.0
_NOISE = 6.0  # grey levels; two predictions differ if they are twice as far apart
_LEAST_MOVED = 0.25  # of these pixels, those that shift as the room does; else the motion is wrong
_AROUND_PX, _LEAST_DECIDED = 5, 0.2  # square over which evidence is averaged, and share of it that must be decided
_MOST_NATS, _STANDS_NATS = 8.0, 3.0  # evidence at most, and from which on a pixel stands still
_GAP_PX, _MARGIN_PX = 5, 3  # of the squares that close gaps, and that widen what stands still
_LEAST_SHARE, _MOST_SHARE = 0.03, 0.7  # of the image: less does not matter, and if it were more, little would be left
_GROWN = 0.02  # of the image
_NO_JUMP = 1e3  # depth is interpolated across edges, too


@dataclass(frozen=True)
class _Compared:
    """The image that the next one is compared with.

    Attributes:
        gray: (h, w), relative to the light around.
        landmark_pose: ``T_world_camera`` by landmarks, (4, 4), or None.
        T_compared_current: motion since by odometry, (4, 4); None where it is unknown.
    """

    gray: NDArray[np.float32]
    landmark_pose: FloatArray | None
    T_compared_current: FloatArray | None

    def moved(self, motion: Motion | None) -> _Compared:
        T = self.T_compared_current
        return replace(
            self, T_compared_current=None if T is None or motion is None else T @ motion.T_previous_current
        )

    def motions_to(self, landmark_pose: FloatArray | None) -> list[FloatArray]:
        """The motion by odometry, and by landmarks, which is less exact; as far as they are known."""
        motions = [] if self.T_compared_current is None else [self.T_compared_current]
        if self.landmark_pose is not None and landmark_pose is not None:
            motions.append(invert(self.landmark_pose) @ landmark_pose)
        return motions


@dataclass(frozen=True)
class StandingMask:
    """What stands still in a camera's images.

    Attributes:
        camera: of the images.
        mask: (h, w) bool, in a small image.
    """

    camera: Camera
    mask: NDArray[np.bool_]

    def stands(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """Whether pixels (N, 2) of the camera's image stand still, (N,)."""
        height, width = self.mask.shape
        places = (pixels + 0.5) * np.array([width / self.camera.width, height / self.camera.height])
        x, y = np.clip(places, 0.0, np.array([width - 1.0, height - 1.0])).astype(np.int64).T
        return np.asarray(self.mask[y, x])

    def hides(self, points: ArrayLike, pose: FloatArray) -> NDArray[np.bool_]:
        """Whether points (N, 3) of the world are behind what stands still, seen from a ``T_world_camera``, (N,)."""
        pixels = self.camera.project(transform(invert(pose), points))
        # A camera that flies past a point has it behind itself.
        is_ahead = np.asarray(np.isfinite(pixels).all(axis=1))
        return np.asarray(is_ahead & self.stands(np.where(is_ahead[:, None], pixels, 0.0)))

    def without(self, depth: DepthPrediction) -> DepthPrediction:
        """A depth image that has no depth where pixels stand still."""
        if not self.mask.any():
            return depth
        is_hidden = self.stands(_pixels_of(self.camera, depth.camera)).reshape(depth.depth_m.shape)
        return replace(depth, depth_m=np.where(is_hidden, np.float32(0.0), depth.depth_m))


@lru_cache(maxsize=2)
def _pixels_of(camera: Camera, depth_camera: Camera) -> FloatArray:
    """Where a camera sees each pixel of a depth image, (h * w, 2)."""
    return camera.project(depth_camera.pixel_rays().reshape(-1, 3))


class StandingPixels:
    """Follows the evidence that pixels of one camera stand still; call :meth:`update` after every frame.

    Attributes:
        found: what stands still. Nothing where it is less than 3 % of the image, or more than 70 %.
        share: of the image that it is, 0..1.
        has_grown: whether the last frame added more than 2 % of the image to it.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera.of_width(min(_WIDTH, camera.width))
        grid = self._camera.of_width(min(_GRID_WIDTH, camera.width))
        self._grid_shape = grid.height, grid.width
        self._rays = grid.pixel_rays().reshape(-1, 3)
        self._grid_px = self._camera.project(self._rays).astype(np.float32)  # (N, 2)
        self._nats = np.zeros((self._camera.height, self._camera.width), dtype=np.float32)
        self._last: _Compared | None = None
        self.found = StandingMask(camera, np.zeros(self._nats.shape, dtype=np.bool_))
        self.has_grown, self.share, self._largest_share = False, 0.0, 0.0

    def reset(self) -> None:
        """Do not compare the next image with the last one; what stands still stays known."""
        self._last = None

    def update(
        self,
        color: NDArray[np.uint8],
        motion: Motion | None,
        depth: DepthPrediction | None,
        landmark_pose: FloatArray | None,
    ) -> None:
        """Take in a frame.

        Args:
            color: (H, W, 3) uint8 RGB, of the camera.
            motion: since the previous frame; None where it is unknown.
            depth: of the frame; without it, only the motion is taken in.
            landmark_pose: ``T_world_camera``, (4, 4), by the landmarks in the image, or None. Between two of them,
                it gives the motion where odometry shows none, as where most corners stand still.
        """
        self.has_grown = False
        last = self._last = None if self._last is None else self._last.moved(motion)
        if depth is None:
            return
        motions = [] if last is None else last.motions_to(landmark_pose)
        points = self._points(depth) if motions else np.zeros((0, 3))
        sources_px = [self._source_px(T_compared_current, points) for T_compared_current in motions]
        is_far = [self._is_far(each) for each in sources_px]
        # Where landmark poses show that the camera stands still, odometry follows somebody who walks past.
        if motions and not is_far[-1]:
            return
        gray = self._relative(color)
        if last is not None and motions:
            self._compare(gray, last.gray, sources_px[is_far.index(True)])
        self._last = _Compared(gray, landmark_pose, np.eye(4))

    def _relative(self, color: NDArray[np.uint8]) -> NDArray[np.float32]:
        gray = gray_image(color, (self._camera.width, self._camera.height)).astype(np.float32)
        light = cv2.blur(gray, (_LIGHT_PX, _LIGHT_PX))
        return np.asarray(_MEAN * gray / np.maximum(light, _DARK), dtype=np.float32)

    def _points(self, depth: DepthPrediction) -> FloatArray:
        """What the grid shows of the room, (N, 3), in the camera's frame."""
        depth_m = sample_depth(self._grid_px, self._camera, depth.depth_m, depth.camera, _NO_JUMP)
        is_known = depth_m > 0.0
        depth_m = np.where(is_known, depth_m, np.median(depth_m[is_known]) if is_known.any() else 1.0)
        return np.asarray(self._rays * depth_m[:, None])

    def _source_px(self, T_compared_current: FloatArray, points: FloatArray) -> FloatArray:
        """Where the compared image showed points (N, 3), (N, 2); far outside if nowhere."""
        local = transform(T_compared_current, points)
        return np.where(self._camera.in_sight(local)[:, None], self._camera.project(local), -1e4)

    def _is_far(self, source_px: FloatArray) -> bool:
        return float(np.median(np.linalg.norm(source_px - self._grid_px, axis=1))) >= _LEAST_SHIFT_PX

    def _compare(self, now: NDArray[np.float32], before: NDArray[np.float32], source_px: FloatArray) -> None:
        """Add the evidence of two images (h, w)."""
        size, around = (self._camera.width, self._camera.height), (_AROUND_PX, _AROUND_PX)
        source = source_px.astype(np.float32).reshape(*self._grid_shape, 2)
        x, y = np.moveaxis(cv2.resize(source, size, interpolation=cv2.INTER_LINEAR), 2, 0)
        is_inside = (x >= 0.0) & (y >= 0.0) & (x <= size[0] - 1.0) & (y <= size[1] - 1.0)
        shifted = cv2.remap(before, x, y, cv2.INTER_LINEAR)
        is_decided = is_inside & (np.abs(shifted - before) > 2.0 * _NOISE)
        nats = np.clip((np.abs(now - shifted) - np.abs(now - before)) / _NOISE, -1.0, 1.0) * is_decided
        if np.count_nonzero(nats < 0.0) < _LEAST_MOVED * np.count_nonzero(is_decided):
            return
        share = cv2.blur(is_decided.astype(np.float32), around)
        self._nats += cv2.blur(nats.astype(np.float32), around) / np.maximum(share, _LEAST_DECIDED)
        np.clip(self._nats, -_MOST_NATS, _MOST_NATS, out=self._nats)
        self._mark()

    def _mark(self) -> None:
        found = self._nats > _STANDS_NATS
        stands: NDArray[Any] = found.astype(np.uint8)
        stands = cv2.morphologyEx(stands, cv2.MORPH_CLOSE, np.ones((_GAP_PX, _GAP_PX), np.uint8))
        mask = cv2.dilate(stands, np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)) > 0
        mask = mask & (found.mean() >= _LEAST_SHARE) & (mask.mean() <= _MOST_SHARE)
        self.found, self.share = replace(self.found, mask=mask), float(mask.mean())
        self.has_grown = self.share > self._largest_share + _GROWN
        if self.has_grown:
            self._largest_share = self.share
