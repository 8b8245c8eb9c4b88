"""Camera motion from tracked corners and depth of any source.

Corners of a reference frame are lifted with its depth and tracked from frame to frame; the camera's motion since
the reference is the perspective-n-point solution over the tracks. The reference is kept while enough of its
corners are seen, so that error grows with the number of references, not of frames. Where the depth is wrong by a
factor, so is the translation, by the same factor: rotation is not affected, and the filter estimates the factor.

Sources: Shi & Tomasi 1994 (corners); Bouguet 2000 (pyramidal Lucas-Kanade); Kalal et al. 2010 (forward-backward
check); Fischler & Bolles 1981 (RANSAC).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from monoloc.camera import Camera
from monoloc.depth_image import sample_depth
from monoloc.geometry import FloatArray, invert, make_pose, so3_exp


class OdometryConfig(BaseModel):
    """Settings of the visual odometry; pixels are of the tracking image, ``width`` wide.

    Attributes:
        width: width at which corners are tracked.
        corners: most corners lifted from a reference frame.
        min_distance_px: least distance between corners.
        window_px: Lucas-Kanade window.
        forward_backward_px: largest distance between a corner and its track there and back.
        reprojection_px: RANSAC's inlier threshold.
        min_inliers: fewer than this is a failure.
        keep_fraction: a new reference is taken when fewer of its corners are still inliers.
        depth_jump: corners within a pixel of a relative depth jump above this are not lifted: they sit on an
            occlusion edge.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: int = Field(320, ge=80)
    corners: int = Field(400, ge=20)
    min_distance_px: float = Field(6.0, gt=0.0)
    window_px: int = Field(15, ge=5)
    forward_backward_px: float = Field(0.7, gt=0.0)
    reprojection_px: float = Field(1.5, gt=0.0)
    min_inliers: int = Field(15, ge=6)
    keep_fraction: float = Field(0.75, gt=0.0, le=1.0)
    depth_jump: float = Field(0.15, gt=0.0)


@dataclass(frozen=True)
class Motion:
    """Motion of the camera between two frames.

    Attributes:
        T_previous_current: (4, 4), translation in units of the depth it was computed from.
        inliers: tracks that agree with it.
    """

    T_previous_current: FloatArray
    inliers: int


@dataclass(frozen=True)
class _Reference:
    """Corners of one frame: pixels there, points in its frame (N, 3), and where they are seen now."""

    points: FloatArray
    pixels_now: NDArray[np.float32]
    count: int


class VisualOdometry:
    """Frame-to-frame camera motion; call :meth:`step` with every frame in order."""

    def __init__(self, camera: Camera, config: OdometryConfig | None = None) -> None:
        self.config = config or OdometryConfig()
        width = min(self.config.width, camera.width)
        self._camera = camera.resized(width, round(camera.height * width / camera.width))
        self._equalise = cv2.createCLAHE(clipLimit=3.0, tileGridSize=(8, 8))
        self._gray: NDArray[np.uint8] | None = None
        self._depth: tuple[NDArray[np.float32], Camera] | None = None
        self._reference: _Reference | None = None
        self._T_reference_previous = np.eye(4)

    def step(self, color: NDArray[np.uint8], depth_m: NDArray[np.float32], depth_camera: Camera) -> Motion | None:
        """Motion since the previous frame; None for the first frame and where tracking fails.

        Args:
            color: (H, W, 3) uint8 RGB.
            depth_m: (h, w) depth of this frame, of any resolution; 0 where there is none.
            depth_camera: intrinsics of the depth image.
        """
        gray = self._tracking_image(color)
        motion = self._motion_to(gray)
        if motion is None and self._gray is not None:
            # The reference may be worn out; the previous frame makes a fresh one.
            self._start_reference()
            motion = self._motion_to(gray)
        self._gray, self._depth = gray, (depth_m, depth_camera)
        if motion is None or (
            self._reference is not None and motion.inliers < self.config.keep_fraction * self._reference.count
        ):
            self._reference = None
        return motion

    def _tracking_image(self, color: NDArray[np.uint8]) -> NDArray[np.uint8]:
        size = (self._camera.width, self._camera.height)
        gray = cv2.cvtColor(cv2.resize(color, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY)
        return np.asarray(self._equalise.apply(gray), dtype=np.uint8)

    def _start_reference(self) -> None:
        """Make the previous frame the reference."""
        self._reference = None
        if self._gray is None or self._depth is None:
            return
        corners: Any = cv2.goodFeaturesToTrack(
            self._gray, self.config.corners, qualityLevel=0.005, minDistance=self.config.min_distance_px
        )
        if corners is None or len(corners) == 0:
            return
        pixels = corners.reshape(-1, 2).astype(np.float32)
        depth = sample_depth(pixels, self._camera, *self._depth, relative=self.config.depth_jump)
        pixels, depth = pixels[depth > 0.0], depth[depth > 0.0]
        points = self._camera.rays(pixels) * depth[:, None]
        self._reference = _Reference(points, pixels, len(points))
        self._T_reference_previous = np.eye(4)

    def _motion_to(self, gray: NDArray[np.uint8]) -> Motion | None:
        """Track the reference's corners into ``gray`` and solve for the motion."""
        if self._reference is None:
            self._start_reference()
        reference = self._reference
        if reference is None or self._gray is None or len(reference.points) < self.config.min_inliers:
            return None
        tracked, kept = self._track(self._gray, gray, reference.pixels_now)
        points, pixels = reference.points[kept], tracked[kept]
        solution = self._solve(points, pixels)
        if solution is None:
            return None
        T_current_reference, inliers = solution
        T_reference_current = invert(T_current_reference)
        motion = Motion(invert(self._T_reference_previous) @ T_reference_current, len(inliers))
        self._reference = _Reference(points[inliers], pixels[inliers], reference.count)
        self._T_reference_previous = T_reference_current
        return motion

    def _track(
        self, before: NDArray[np.uint8], after: NDArray[np.uint8], pixels: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        window = (self.config.window_px, self.config.window_px)
        forward, found, _ = cv2.calcOpticalFlowPyrLK(before, after, pixels, pixels.copy(), winSize=window, maxLevel=3)
        back, found_back, _ = cv2.calcOpticalFlowPyrLK(
            after, before, forward, forward.copy(), winSize=window, maxLevel=3
        )
        distance = np.linalg.norm(back - pixels, axis=1)
        kept = (found[:, 0] == 1) & (found_back[:, 0] == 1) & (distance < self.config.forward_backward_px)
        return np.asarray(forward, dtype=np.float32), kept

    def _solve(self, points: FloatArray, pixels: NDArray[np.float32]) -> tuple[FloatArray, NDArray[np.int64]] | None:
        """T_current_reference and the inliers' indices, or None."""
        if len(points) < self.config.min_inliers:
            return None
        K, distortion = self._camera.matrix, np.asarray(self._camera.distortion)
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            points,
            pixels.astype(np.float64),
            K,
            distortion,
            iterationsCount=100,
            reprojectionError=self.config.reprojection_px,
            confidence=0.999,
            flags=cv2.SOLVEPNP_EPNP,
        )
        if not ok or inliers is None or len(inliers) < self.config.min_inliers:
            return None
        chosen = inliers.ravel().astype(np.int64)
        rotation, translation = cv2.solvePnPRefineLM(
            points[chosen], pixels[chosen].astype(np.float64), K, distortion, rotation, translation
        )
        pose = make_pose(so3_exp(rotation.ravel()), translation.ravel())
        return (pose, chosen) if np.all(np.isfinite(pose)) else None
