"""Depth of a frame by a plane sweep: the depth at which the neighbouring frames show the same texture.

Images are warped by planes parallel to the image, evenly spaced in inverse depth, and compared by zero-normalised
cross-correlation (ZNCC), which does not depend on brightness. Occlusion hides a surface from some neighbours, so the
better half of them decides.

Sources: Collins, *A space-sweep approach to true multi-image matching* (CVPR 1996); Kang, Szeliski and Chai,
*Handling occlusions in dense multi-view stereo* (CVPR 2001).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert

_PLANES = 64
_WINDOW_PX = 7
_NOISE_VARIANCE = 4.0  # of grey levels, so that the noise of an empty wall does not correlate
_OUTSIDE = -1e4  # grey level beyond the border; a window that holds some of it says nothing
_NEARER, _FARTHER = 0.8, 1.25  # than the nearest and the farthest point that is known

Image = NDArray[np.float32]


def sweep_depth(
    images: Sequence[Image],
    poses: FloatArray,
    camera: Camera,
    frame: int,
    neighbours: Sequence[int],
    known_depth: FloatArray,
) -> tuple[Image, Image]:
    """Depth of one frame and its correlation, (H, W) each.

    Args:
        images: grey images (H, W) float32 of the pinhole ``camera``, one for each pose.
        poses: ``T_world_camera``, (F, 4, 4).
        frame: index of the frame.
        neighbours: indices of the frames to compare it with, at least one.
        known_depth: of some points in the frame, (M,): the sweep goes a little beyond them on both sides.

    Returns:
        Depth in the unit of the poses, and the ZNCC at it, from -1 to 1.
    """
    nearest, farthest = np.percentile(known_depth, [1.0, 99.0])
    inverse_depth = np.linspace(1.0 / (_FARTHER * farthest), 1.0 / (_NEARER * nearest), _PLANES)
    patches = _Patches(images[frame])
    motions = [invert(poses[other]) @ poses[frame] for other in neighbours]
    better_half = (len(neighbours) + 1) // 2
    scores = np.empty((_PLANES, camera.height, camera.width), dtype=np.float32)
    K, K_inverse = camera.matrix, np.linalg.inv(camera.matrix)
    for plane, inverse in enumerate(inverse_depth):
        each = []
        for other, T_other_frame in zip(neighbours, motions, strict=True):
            # For a point with this depth z: x_other = R x + t = (R + t [0, 0, 1 / z]) x.
            to_other = T_other_frame[:3, :3] + np.outer(T_other_frame[:3, 3], [0.0, 0.0, inverse])
            each.append(patches.correlation(_warped(images[other], K @ to_other @ K_inverse)))
        scores[plane] = np.sort(np.array(each), axis=0)[-better_half:].mean(axis=0)
    best = scores.argmax(axis=0)
    step = float(inverse_depth[1] - inverse_depth[0])
    refined = inverse_depth[best] + step * _peak_offset(scores, best)
    return (1.0 / refined).astype(np.float32), scores.max(axis=0)


def _warped(image: Image, homography: FloatArray) -> Image:
    """The image as another camera sees the plane; ``homography`` maps that camera's pixels to the image's."""
    height, width = image.shape
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(image, homography, (width, height), flags=flags, borderValue=_OUTSIDE)
    return np.asarray(warped, dtype=np.float32)


def _mean(image: Image) -> Image:
    return np.asarray(cv2.blur(image, (_WINDOW_PX, _WINDOW_PX)), dtype=np.float32)


class _Patches:
    """The windows around all pixels of an image."""

    def __init__(self, image: Image) -> None:
        self._image, self._mean = image, _mean(image)
        self._variance = _mean(image * image) - self._mean**2 + np.float32(_NOISE_VARIANCE)

    def correlation(self, other: Image) -> Image:
        """ZNCC of the windows of another image, (H, W); -1 where they reach beyond its border."""
        mean = _mean(other)
        variance = np.maximum(_mean(other * other) - mean**2, 0.0) + np.float32(_NOISE_VARIANCE)
        correlation = (_mean(self._image * other) - self._mean * mean) / np.sqrt(self._variance * variance)
        return np.where(mean < 0.0, np.float32(-1.0), correlation)


def _peak_offset(scores: Image, best: NDArray[np.int64]) -> FloatArray:
    """Where the parabola through the best plane and its neighbours peaks, in planes from the best, (H, W)."""
    middle = np.clip(best, 1, len(scores) - 2)
    rows, columns = np.indices(best.shape)
    before, at, after = (scores[middle + step, rows, columns].astype(np.float64) for step in (-1, 0, 1))
    curvature = before - 2.0 * at + after
    offset = 0.5 * (before - after) / np.minimum(curvature, -1e-6)
    return np.where((best == middle) & (curvature < -1e-6), np.clip(offset, -0.5, 0.5), 0.0)
