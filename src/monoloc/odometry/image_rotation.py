"""The camera's rotation between two images, where no corners can be followed.

In a fast turn the images are blurred, and corners are lost. At a quarter of the size the blur is a few pixels, and
the whole image can still be aligned with the previous one (Klein and Murray, *Improving the agility of keyframe-based
SLAM*, 2008): a shift and a turn of the image, by its correlation (Evangelidis and Psarakis 2008).
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray
from monoloc.image_size import resize_image
from monoloc.odometry.motion import Motion

_WIDTH = 80  # of the images that are aligned
_GRID_PX = 8  # distance of the rays by which the rotation is found
# Of the aligned images. Between neighbouring frames of a walk, three blurred ones skipped, it was 0.92 and more;
# between images of different rooms, of opposite walls and of mirrored rooms 0.88 and less.
_LEAST_CORRELATION = 0.9
_MOST_TURN_RAD = 0.35  # beyond it, too little of the image is in both
# Standard deviation per axis. The motion of the camera's centre also shifts the image, by what depends on the depth:
# at walking speed, 7.5 frames a second and 1 to 2 m it was 0.8 to 1.0 degrees in all (median).
_SD_RAD = 0.015
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 1e-4)
_BLUR_PX = 5  # window of the smoothing before the alignment


class ImageRotation:
    """Measures how a camera turned between two of its images.

    Args:
        camera: of the images.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera.resized(_WIDTH, max(1, round(camera.height * _WIDTH / camera.width)))

    @cached_property
    def _window(self) -> NDArray[np.float32]:
        return np.asarray(cv2.createHanningWindow((self._camera.width, self._camera.height), cv2.CV_32F), np.float32)

    @cached_property
    def _grid(self) -> FloatArray:
        """Pixels (N, 2) all over the image."""
        width, height = self._camera.width, self._camera.height
        u, v = np.meshgrid(*(np.arange(_GRID_PX // 2, side, _GRID_PX) for side in (width, height)))
        return np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)

    def between(self, before: NDArray[np.uint8], after: NDArray[np.uint8]) -> Motion | None:
        """Rotation from one grey image (H, W) uint8 to the next; None where they cannot be aligned."""
        size = self._camera.width, self._camera.height
        warp = self._aligned(resize_image(before, size), resize_image(after, size))
        if warp is None:
            return None
        rays_before = _directions(self._camera.rays(self._grid))
        rays_after = _directions(self._camera.rays(self._grid @ warp[:, :2].T + warp[:, 2]))
        R_before_after = _rotation(rays_before, rays_after)
        cosine = 0.5 * (float(np.trace(R_before_after)) - 1.0)
        return Motion.rotation(R_before_after, _SD_RAD) if cosine > np.cos(_MOST_TURN_RAD) else None

    def _aligned(self, before: NDArray[np.uint8], after: NDArray[np.uint8]) -> FloatArray | None:
        """The (2, 3) map of pixels before to pixels after, a turn and a shift; None where the images do not fit."""
        shift, _ = cv2.phaseCorrelate(before.astype(np.float32), after.astype(np.float32), self._window)
        everywhere = np.full(before.shape, 255, dtype=np.uint8)
        for u, v in (shift, (0.0, 0.0)):
            start = np.array([[1.0, 0.0, u], [0.0, 1.0, v]], dtype=np.float32)
            try:
                correlation, warp = cv2.findTransformECC(
                    before, after, start, cv2.MOTION_EUCLIDEAN, _CRITERIA, everywhere, _BLUR_PX
                )
            except cv2.error:  # it did not converge
                continue
            if correlation >= _LEAST_CORRELATION:
                return np.asarray(warp, dtype=np.float64)
        return None


def _directions(rays: FloatArray) -> FloatArray:
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _rotation(before: FloatArray, after: FloatArray) -> FloatArray:
    """``R_before_after`` that turns directions (N, 3) best into others (Kabsch 1976)."""
    U, _, Vt = np.linalg.svd(before.T @ after)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)
