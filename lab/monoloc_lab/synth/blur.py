"""Motion blur of a view by the motion of the camera during the exposure."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, se3_exp, se3_log, transform

_LEAST_PX = 0.3  # smaller motion does not blur
_MOST_SAMPLES = 32
_FAR_M = 1e3  # depth of pixels without a surface


def velocities(poses: FloatArray, timestamps_s: FloatArray) -> FloatArray:
    """Twists per second in the camera frame, (N, 6), by central differences of ``T_world_camera`` (N, 4, 4)."""
    after = np.minimum(np.arange(len(poses)) + 1, len(poses) - 1)
    before = np.maximum(np.arange(len(poses)) - 1, 0)
    elapsed_s = timestamps_s[after] - timestamps_s[before]
    elapsed_s[elapsed_s <= 0.0] = np.inf  # a single pose does not move
    return np.asarray(se3_log(invert(poses[before]) @ poses[after]) / elapsed_s[:, None])


def motion_blurred(
    light: NDArray[np.float32],
    depth_m: NDArray[np.float32],
    camera: Camera,
    velocity: FloatArray,
    exposure_s: float,
) -> NDArray[np.float32]:
    """Mean of the views during the exposure, whose middle is the pose of the given view.

    Other views are warped from the given one by its depth, which is exact except next to depth edges.

    Args:
        light: (H, W, 3) float32, linear; depth_m: (H, W), 0 where there is none.
        velocity: twist per second in the camera frame, (6,).

    Returns:
        (H, W, 3) float32; ``light`` itself if nothing moves by a third of a pixel.
    """
    depth = np.where(depth_m > 0.0, depth_m, np.float32(_FAR_M))
    points = camera.pixel_rays() * depth[..., None]
    still = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)

    def seen(time_s: float) -> NDArray[np.float32]:
        """Pixel coordinates in the given view of what each pixel sees at a time, (H, W, 2)."""
        moved = transform(se3_exp(velocity * time_s), points.reshape(-1, 3))
        pixels = camera.project(moved).reshape(camera.height, camera.width, 2)
        behind = moved[:, 2].reshape(depth.shape) <= 0.0
        return np.where(behind[..., None], still, pixels).astype(np.float32)

    length_px = float(np.linalg.norm(seen(0.5 * exposure_s) - seen(-0.5 * exposure_s), axis=-1).max())
    if length_px < _LEAST_PX:
        return light
    count = int(min(_MOST_SAMPLES, np.ceil(2.0 * length_px) + 1))
    times_s = ((np.arange(count) + 0.5) / count - 0.5) * exposure_s
    total = np.zeros_like(light)
    for time_s in times_s:
        u, v = np.moveaxis(seen(float(time_s)), -1, 0)
        total += cv2.remap(light, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return total / np.float32(count)
