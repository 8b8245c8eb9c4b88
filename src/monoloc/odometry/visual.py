"""Visual odometry: camera motion and depth of corners, from tracked corners and depth of any source.

Corners are back-projected with the depth of the keyframe in which they appear, and tracked from frame to frame. The
camera's pose is the perspective-n-point solution for the tracks. Bundle adjustment of the last keyframes
(:mod:`monoloc.odometry.window`) corrects the shape of the depth by parallax. The scale follows the depth source,
averaged over some seconds. If that scale is wrong by a factor, so is the translation; the filter estimates this
factor.

Sources: Shi & Tomasi 1994 (corners); Fischler & Bolles 1981 (RANSAC); Forster et al. 2014 and Loo et al. 2019 (depth
filters of corners, initialised with a network's prediction).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.contrast import equaliser, has_contrast
from monoloc.depth.depth_image import sample_depth, where_known
from monoloc.geometry import FloatArray, invert, se3_exp, se3_log, transform
from monoloc.image_size import gray_image
from monoloc.odometry.camera_pose import solve_pose
from monoloc.odometry.corner_tracking import find_corners, follow_corners
from monoloc.odometry.image_rotation import ImageRotation
from monoloc.odometry.motion import Motion
from monoloc.odometry.odometry_config import OdometryConfig
from monoloc.odometry.window import Window, adjust

# By which the expected motion may be longer or shorter than the last one, since stamps of arrival come in bursts; and
# the logarithm of a change that does not count.
_MOST_PACE, _STEADY = 4.0, 0.1


@dataclass(frozen=True)
class _Tracks:
    """N tracked corners; r is the frame of the window's first keyframe.

    Attributes:
        window: keyframes that observed the corners.
        pixels: (N, 2) positions in the latest frame.
        log_depth_sd: (N,) standard deviation of log-depth.
        keyframe_pixels: (N, 2) positions in the last keyframe.
        keyframe_count: number of corners in the last keyframe.
    """

    window: Window
    pixels: NDArray[np.float32]
    log_depth_sd: FloatArray
    keyframe_pixels: NDArray[np.float32]
    keyframe_count: int

    @property
    def points(self) -> FloatArray:
        """(N, 3) corners in r."""
        return self.window.points

    def select(self, chosen: NDArray[Any]) -> _Tracks:
        return replace(
            self,
            window=self.window.select(chosen),
            pixels=self.pixels[chosen],
            log_depth_sd=self.log_depth_sd[chosen],
            keyframe_pixels=self.keyframe_pixels[chosen],
        )


class _Found(NamedTuple):
    """``T_r_current`` (4, 4), the share of its covariance (6, 6) that this frame adds, and the corners that agree."""

    pose: FloatArray
    covariance: FloatArray
    tracks: _Tracks


@dataclass(frozen=True)
class _Followed:
    """An equalised grey image (h, w), None without contrast, and the result of following the corners into it.

    Attributes:
        found: None on failure.
        turn: then, the rotation by which the whole image fits the previous one; None where it does not.
        elapsed_s: since the previous image; None where that is not known.
    """

    gray: NDArray[np.uint8] | None
    elapsed_s: float | None
    found: _Found | None = None
    turn: Motion | None = None


class VisualOdometry:
    """Frame-to-frame visual odometry; call :meth:`step` for each frame in order."""

    def __init__(self, camera: Camera, config: OdometryConfig | None = None) -> None:
        self.config = config or OdometryConfig()
        width = min(self.config.width, camera.width)
        self._camera = camera.resized(width, round(camera.height * width / camera.width))
        self._equalise = equaliser()
        self._image_rotation = ImageRotation(self._camera)
        self._gray: NDArray[np.uint8] | None = None
        self._T_r_previous = np.eye(4)
        self._last_motion = np.eye(4)  # T_previous_current of the frame before, which is expected to go on
        self._last_elapsed_s: float | None = None  # of that motion
        self._tracks: _Tracks | None = None
        self._followed: tuple[NDArray[np.uint8], _Followed] | None = None  # an image, as soon as it is followed

    def follow(
        self,
        color: NDArray[np.uint8],
        R_previous_current: FloatArray | None = None,
        elapsed_s: float | None = None,
    ) -> None:
        """Track the corners into the next image, which needs no depth of it; :meth:`step` then goes on from there.

        Nothing of it remains if no step follows, as when the image's depth fails.

        Args:
            color, R_previous_current: as :meth:`step`.
            elapsed_s: since the previous image, by which the expected motion is longer or shorter than the last one.
        """
        gray = gray_image(color, (self._camera.width, self._camera.height))
        if not has_contrast(gray):
            self._followed = color, _Followed(None, elapsed_s)
            return
        gray = np.asarray(self._equalise.apply(gray), dtype=np.uint8)
        expected = self._expected_motion(R_previous_current, elapsed_s)
        found, turn = self._follow(gray, expected), None
        if found is None and R_previous_current is None and self._gray is not None:
            turn = self._image_rotation.between(self._gray, gray)
            if turn is not None:
                found = self._follow(gray, self._expected_motion(turn.T_previous_current[:3, :3], elapsed_s))
        self._followed = color, _Followed(gray, elapsed_s, found, turn)

    def step(
        self,
        color: NDArray[np.uint8],
        depth_m: NDArray[np.float32],
        depth_camera: Camera,
        R_previous_current: FloatArray | None = None,
    ) -> Motion | None:
        """Motion since the previous frame; None for the first frame and in the dark.

        Where too few corners can be followed, only the rotation is known, and only if the images can be aligned as a
        whole and no other sensor measured it; else the motion is None too.

        Args:
            color: (H, W, 3) uint8 RGB.
            depth_m: (h, w) depth of this frame at any resolution, metres; 0 where it is unknown.
            depth_camera: intrinsics of the depth image.
            R_previous_current: rotation since the previous frame by another sensor, (3, 3), which says where to look
                for the corners; None expects the motion to go on.
        """
        if self._followed is None or self._followed[0] is not color:
            self.follow(color, R_previous_current)
        assert self._followed is not None
        followed = self._followed[1]
        gray, found, turn = followed.gray, followed.found, followed.turn
        self._followed, self._last_elapsed_s = None, followed.elapsed_s
        if gray is None:
            self._tracks, self._gray = None, None
            return None
        if found is None:
            self._tracks, self._T_r_previous, self._last_motion = None, np.eye(4), np.eye(4)
            self._add_keyframe(gray, np.eye(4), depth_m, depth_camera)
            self._gray = gray
            return turn
        T_r_current, covariance, self._tracks = found
        # In frame r before the adjustment, which invalidates the previous pose.
        T_previous_current = invert(self._T_r_previous) @ T_r_current
        inliers = len(self._tracks.points)
        if depth_m.any() and self._needs_keyframe():  # it waits for depth
            T_r_current = self._add_keyframe(gray, T_r_current, depth_m, depth_camera)
        self._gray, self._T_r_previous, self._last_motion = gray, T_r_current, T_previous_current.copy()
        points = transform(invert(T_r_current), self._tracks.points)
        log_depth_sd = self._tracks.log_depth_sd.copy()  # the result is the caller's to write in
        return Motion(T_previous_current, inliers, points, log_depth_sd, view_covariance=covariance)

    def _follow(self, gray: NDArray[np.uint8], expected: FloatArray) -> _Found | None:
        """Track the corners into ``gray`` and solve for its ``T_r_camera``; with the tracks but for outliers.

        Args:
            expected: ``T_previous_current``, (4, 4).
        """
        if self._tracks is None or self._gray is None or len(self._tracks.points) < self.config.min_inliers:
            return None
        near = self._expected_pixels(self._tracks, expected)
        pixels, tracked = follow_corners(self._gray, gray, self._tracks.pixels, near, self.config)
        tracks = replace(self._tracks, pixels=pixels).select(tracked)
        solution = solve_pose(tracks.points, tracks.pixels, self._camera, self.config)
        if solution is None:
            return None
        T_r_current, covariance, inliers = solution
        # Errors are those of the keyframes' corners: they change, and so add up, as corners move, not by the frame.
        moved_px = np.median(np.linalg.norm(pixels - self._tracks.pixels, axis=1)[tracked])
        share = min(1.0, float(moved_px) / self.config.keyframe_motion_px)
        return _Found(T_r_current, share * covariance, tracks.select(inliers))

    def _expected_motion(self, R_previous_current: FloatArray | None, elapsed_s: float | None) -> FloatArray:
        """``T_previous_current`` (4, 4) if the camera goes on as before, or turns as another sensor says."""
        expected = self._last_motion.copy()
        if elapsed_s and self._last_elapsed_s:
            pace = float(np.clip(elapsed_s / self._last_elapsed_s, 1.0 / _MOST_PACE, _MOST_PACE))
            if abs(np.log(pace)) > _STEADY:
                expected = se3_exp(pace * se3_log(expected))
        if R_previous_current is not None:
            expected[:3, :3] = R_previous_current
        return expected

    def _expected_pixels(self, tracks: _Tracks, expected_motion: FloatArray) -> NDArray[np.float32]:
        """Where the corners are, (N, 2), after a motion ``T_previous_current``, (4, 4)."""
        local = transform(invert(self._T_r_previous @ expected_motion), tracks.points)
        expected = np.where(self._camera.in_sight(local)[:, None], self._camera.project(local), tracks.pixels)
        return np.asarray(expected, dtype=np.float32)

    def _needs_keyframe(self) -> bool:
        tracks = self._tracks
        assert tracks is not None
        moved = np.median(np.linalg.norm(tracks.pixels - tracks.keyframe_pixels, axis=1))
        is_worn = len(tracks.points) < self.config.keyframe_share * tracks.keyframe_count
        return bool(moved > self.config.keyframe_motion_px) or is_worn

    def _add_keyframe(
        self, gray: NDArray[np.uint8], T_r_camera: FloatArray, depth_m: NDArray[np.float32], depth_camera: Camera
    ) -> FloatArray:
        """Add the current frame to the window, adjust the window, and return the adjusted pose ``T_r_camera``."""
        config, camera = self.config, self._camera
        known = self._tracks
        window = Window.empty() if known is None else known.window
        pixels = np.zeros((0, 2), dtype=np.float32) if known is None else known.pixels
        fresh = self._new_corners(gray, pixels, where_known(depth_m, depth_camera, camera))
        log_depth = self._log_depth(np.concatenate([pixels, fresh]), depth_m, depth_camera)
        # Rescale predicted depth to the window, except for a small share that follows the depth source.
        z = transform(invert(T_r_camera), window.points)[:, 2]
        ratio = np.log(np.maximum(z, 1e-3)) - log_depth[: len(pixels)]
        if np.isfinite(ratio).any():
            log_depth += config.scale_memory * np.nanmedian(ratio)
        used = np.isfinite(log_depth) | (np.arange(len(log_depth)) < len(pixels))
        fresh, log_depth = fresh[used[len(pixels) :]], log_depth[used]
        tracked = np.concatenate([pixels, fresh])
        rays = camera.rays(tracked)[:, :2]
        lifted = np.column_stack([rays, np.ones(len(rays))]) * np.exp(log_depth)[:, None]
        new_points = transform(T_r_camera, lifted[len(pixels) :])
        window = window.with_keyframe(T_r_camera, new_points, rays, log_depth, config.keyframes)
        information = np.zeros((len(tracked), 3, 3))
        if len(window.poses) > 1 and len(tracked):
            ray_sd = config.corner_sd_px / camera.focal_px
            poses, points, information = adjust(window, ray_sd, config.log_depth_sd, iterations=3)
            window = replace(window, poses=poses, points=points)
        T_r_adjusted = window.poses[-1]
        sd = _log_depth_sd(T_r_adjusted, window.points, information, config.log_depth_sd)
        tracks = _Tracks(window, tracked, sd, keyframe_pixels=tracked, keyframe_count=len(tracked))
        in_front = transform(invert(T_r_adjusted), window.points)[:, 2] > 0.05
        self._tracks = tracks.select(in_front)
        return np.asarray(T_r_adjusted)

    def _log_depth(
        self, pixels: NDArray[np.float32], depth_m: NDArray[np.float32], depth_camera: Camera
    ) -> FloatArray:
        """Logarithm of the depth at pixels of the tracking image, (N, 2) -> (N,); NaN where it is unknown."""
        depth = sample_depth(pixels, self._camera, depth_m, depth_camera, self.config.depth_jump)
        with np.errstate(divide="ignore"):
            return np.where(depth > 0.0, np.log(depth), np.nan)

    def _new_corners(
        self, gray: NDArray[np.uint8], known: NDArray[np.float32], has_depth: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Detect corners (N, 2) that keep the minimum distance to the known ones, up to the maximum number.

        Args:
            has_depth: (h, w), whether a corner may be there.
        """
        wanted = self.config.corners - len(known)
        if wanted <= 0:
            return np.zeros((0, 2), dtype=np.float32)
        free = np.where(has_depth, np.uint8(255), np.uint8(0))
        for x, y in known:
            cv2.circle(free, (int(x), int(y)), int(self.config.min_distance_px), 0, -1)
        return find_corners(gray, wanted, self.config, free)


def _log_depth_sd(T_r_camera: FloatArray, points: FloatArray, information: FloatArray, prior_sd: float) -> FloatArray:
    """Standard deviation of each point's log-depth in a camera, (N,), at most that of the prediction."""
    local = transform(invert(T_r_camera), points)
    direction = local / np.maximum(np.linalg.norm(local, axis=1), 1e-6)[:, None] @ T_r_camera[:3, :3].T
    # Moving a point along its ray by t changes log-depth by t / range.
    along = np.einsum("ni,nij,nj->n", direction, information, direction) * np.sum(local**2, axis=1)
    return np.asarray(1.0 / np.sqrt(along + 1.0 / prior_sd**2))
