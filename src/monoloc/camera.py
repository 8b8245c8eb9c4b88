"""The pinhole camera, with optional Brown distortion.

Axes as in OpenCV: x right, y down, z forward. The centre of the top-left pixel is (0, 0), so an image
of width w spans -0.5 .. w - 0.5. Depth is z, not range.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.errors import SettingError
from monoloc.geometry import FloatArray

_MIN_DEPTH_M = 0.1  # nearer points are not visible
_BORDER_RAYS = 9  # along a side; the widest of them bound the field of view
_GRID_POINTS = 17  # along a side, at which the distortion is inverted as a check
_ROUND_TRIP_TOLERANCE = 1e-9  # largest error of undistorting and distorting again, at z = 1


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera at one image size.

    Attributes:
        width, height: image size, pixels.
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels, pixel centres at integers.
        distortion: Brown coefficients (k1, k2, p1, p2, k3) in OpenCV's order; all zero for a pinhole.

    Raises:
        SettingError: a size or focal length is not positive and finite, the principal point is outside the image, or
            the distortion is not five finite numbers or not invertible over the image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise SettingError(
                "camera.width/height", f"is {self.width}x{self.height}", "give the image size in pixels"
            )
        if not all(np.isfinite(f) and f > 0.0 for f in (self.fx, self.fy)):
            raise SettingError("camera.fx/fy", f"is ({self.fx}, {self.fy})", "focal lengths are positive pixels")
        if not (-0.5 <= self.cx <= self.width - 0.5 and -0.5 <= self.cy <= self.height - 0.5):
            raise SettingError(
                "camera.cx/cy",
                f"({self.cx}, {self.cy}) lies outside the {self.width}x{self.height} image",
                "check that the intrinsics belong to this image size",
            )
        if len(self.distortion) != 5 or not np.all(np.isfinite(self.distortion)):
            raise SettingError("camera.distortion", f"is {self.distortion}", "give k1, k2, p1, p2, k3")
        if self.is_distorted and not self._is_one_to_one():
            raise SettingError(
                "camera.distortion",
                f"{self.distortion} folds the image onto itself",
                "give k1, k2, p1, p2, k3 as they were measured with these focal lengths",
            )

    def _is_one_to_one(self) -> bool:
        """Whether the distortion maps one ray, and no other, to each pixel."""
        ends = ((-0.5, self.width - 0.5, self.cx, self.fx), (-0.5, self.height - 0.5, self.cy, self.fy))
        x, y = (((first - middle) / f, (last - middle) / f) for first, last, middle, f in ends)
        return _is_one_to_one(tuple(self.distortion), *x, *y)

    @property
    def matrix(self) -> FloatArray:
        """Intrinsic matrix K, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def focal_px(self) -> float:
        """Geometric mean of the two focal lengths, pixels."""
        return float(np.sqrt(self.fx * self.fy))

    @property
    def is_distorted(self) -> bool:
        return any(self.distortion)

    def resized(self, width: int, height: int) -> Camera:
        """Camera of the same image resampled to width x height; the borders of the two images coincide."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=min((self.cx + 0.5) * sx, float(width)) - 0.5,  # stays inside the image despite rounding
            cy=min((self.cy + 0.5) * sy, float(height)) - 0.5,
        )

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """Camera of the window whose top-left pixel is (left, top)."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def flipped(self) -> Camera:
        """Camera of the image mirrored left to right."""
        k1, k2, p1, p2, k3 = self.distortion
        return replace(self, cx=self.width - 1 - self.cx, distortion=(k1, k2, p1, -p2, k3))

    def project(self, points_camera: ArrayLike) -> FloatArray:
        """Project points in the camera's frame: (..., 3) m -> (..., 2) px; NaN for points with z <= 0."""
        points = np.asarray(points_camera, dtype=np.float64)
        z = np.where(points[..., 2] > 0.0, points[..., 2], np.nan)
        x, y = self._distort(points[..., 0] / z, points[..., 1] / z)
        return np.stack([x * self.fx + self.cx, y * self.fy + self.cy], axis=-1)

    def in_sight(self, points_camera: FloatArray) -> NDArray[np.bool_]:
        """Whether points in the camera's frame are within the field of view, (N, 3) m -> (N,).

        The field of view extends one pixel beyond the image. Test points before :meth:`project`: the distortion
        polynomial folds points far outside the field of view back into the image.
        """
        least_m, most_x, most_y = self.sight()
        x, y, z = points_camera.T
        return np.asarray((z > least_m) & (np.abs(x) < most_x * z) & (np.abs(y) < most_y * z))

    def sight(self) -> tuple[float, float, float]:
        """Bounds of :meth:`in_sight`: smallest depth in metres, and largest abs(x) and abs(y) at z = 1."""
        columns, rows = (np.linspace(-1.0, size, _BORDER_RAYS) for size in (self.width, self.height))
        most = np.abs(self.rays(np.stack(np.meshgrid(columns, rows), axis=-1))).max(axis=(0, 1))
        return _MIN_DEPTH_M, float(most[0]), float(most[1])

    def rays(self, pixels: ArrayLike) -> FloatArray:
        """Ray directions with z = 1 of pixels, (..., 2) px -> (..., 3): ``depth * ray`` is the point."""
        uv = np.asarray(pixels, dtype=np.float64)
        distorted = (uv - np.array([self.cx, self.cy])) / np.array([self.fx, self.fy])
        normalised = self._undistort(distorted)
        return np.concatenate([normalised, np.ones((*normalised.shape[:-1], 1))], axis=-1)

    def pixel_rays(self) -> FloatArray:
        """Rays of every pixel, (height, width, 3)."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return self.rays(np.stack([u, v], axis=-1))

    def back_project(self, depth_m: ArrayLike) -> FloatArray:
        """Back-project a depth image into the camera's frame: (height, width) m -> (height, width, 3) m.

        Raises:
            ValueError: the depth image and the camera differ in size.
        """
        depth = np.asarray(depth_m, dtype=np.float64)
        if depth.shape != (self.height, self.width):
            raise ValueError(f"depth must have shape ({self.height}, {self.width}), got {depth.shape}")
        return depth[..., None] * self.pixel_rays()

    def _distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return _distort(self.distortion, x, y) if self.is_distorted else (x, y)

    def _undistort(self, distorted: FloatArray) -> FloatArray:
        return _undistort(self.distortion, distorted) if self.is_distorted else distorted


Distortion = tuple[float, float, float, float, float]


def _distort(distortion: Distortion, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Map undistorted to distorted image coordinates at z = 1, (...) each (Brown 1971, as in OpenCV)."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return x * radial + dx, y * radial + dy


def _jacobian(distortion: Distortion, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Entries xx, xy and yy, (...) each, of the symmetric Jacobian of :func:`_distort`."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    J_xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    J_xy = slope * x * y + 2.0 * (p1 * x + p2 * y)
    J_yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return J_xx, J_xy, J_yy


def _undistort(distortion: Distortion, distorted: FloatArray) -> FloatArray:
    """Invert :func:`_distort` by Newton's method."""
    x, y = distorted[..., 0], distorted[..., 1]
    for _ in range(20):
        J_xx, J_xy, J_yy = _jacobian(distortion, x, y)
        predicted_x, predicted_y = _distort(distortion, x, y)
        dx, dy = distorted[..., 0] - predicted_x, distorted[..., 1] - predicted_y
        determinant = J_xx * J_yy - J_xy * J_xy
        step_x, step_y = (J_yy * dx - J_xy * dy) / determinant, (J_xx * dy - J_xy * dx) / determinant
        x, y = x + step_x, y + step_y
        if max(np.max(np.abs(step_x), initial=0.0), np.max(np.abs(step_y), initial=0.0)) < 1e-12:
            break
    return np.stack([x, y], axis=-1)


@lru_cache(maxsize=256)
def _is_one_to_one(distortion: Distortion, left: float, right: float, top: float, bottom: float) -> bool:
    """Whether the inverse exists throughout a rectangle of distorted coordinates that contains (0, 0)."""
    grid = np.meshgrid(np.linspace(left, right, _GRID_POINTS), np.linspace(top, bottom, _GRID_POINTS))
    points = np.stack(grid, axis=-1)
    with np.errstate(all="ignore"):
        undistorted = _undistort(distortion, points)
        x, y = undistorted[..., 0], undistorted[..., 1]
        J_xx, J_xy, J_yy = _jacobian(distortion, x, y)
        residual = np.abs(np.stack(_distort(distortion, x, y), axis=-1) - points).max()
        # Both eigenvalues are positive, as at the centre, up to the first fold.
        return bool(
            residual < _ROUND_TRIP_TOLERANCE and np.all(J_xx + J_yy > 0.0) and np.all(J_xx * J_yy - J_xy**2 > 0.0)
        )
