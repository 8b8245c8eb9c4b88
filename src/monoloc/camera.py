"""The camera: a pinhole, with optional distortion of one of OpenCV's three models.

Axes as in OpenCV: x right, y down, z forward. The centre of the top-left pixel is (0, 0), so an image
of width w spans -0.5 .. w - 0.5. Depth is z, not range.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.distortion import COEFFICIENTS, MODELS, WIDEST_RAD, DistortionModel, Lens, is_one_to_one, widest_radius
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray

# In an image of so many pixels a side, a focal length below so many is stated as a share of the image.
_LEAST_PX, _LEAST_FOCAL_PX = 32, 4.0
_MOST_PX = 1 << 15
_MIN_DEPTH_M = 0.1  # nearer points are not visible
_BORDER_RAYS = 9  # along a side; the widest of them bound the field of view


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera at one image size.

    Attributes:
        width, height: image size, pixels.
        fx, fy: focal lengths, pixels: the magnification at the principal point, whatever the distortion model.
        cx, cy: principal point, pixels, pixel centres at integers.
        distortion: coefficients in OpenCV's order (:data:`monoloc.distortion.COEFFICIENTS`). *brown* has five, of
            which k3 may be left out, *rational* eight and *fisheye* four; if none are given, all are zero. The row or
            column that OpenCV's calibration returns is accepted too, if all that follow a rational lens's eight are
            zero.
        distortion_model: model of the coefficients. Five zeros of *brown* are a pinhole.
        is_window: whether the image is part of a larger one, so that the principal point may be outside. In any other
            image, a principal point outside means that the intrinsics belong to another image size.

    Raises:
        SettingError: a number is given as text, true or false, a size or focal length is not positive and finite, the
            principal point is outside, coefficients are not finite or not as many as the model has, or the distortion
            is not invertible over the image or sees more than 85 degrees off the optical axis.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    distortion_model: DistortionModel = "brown"
    is_window: bool = False

    def __post_init__(self) -> None:
        for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion"):
            values = np.ravel(np.array(getattr(self, name), object))
            # Python's True is an int, which is 1.
            if any(isinstance(value, bool | np.bool_) for value in values):
                raise SettingError(f"camera.{name}", "is true or false, not a number", "give numbers")
            if not all(isinstance(value, Real) and _fits_float(value) for value in values):
                raise SettingError(f"camera.{name}", "is not a number, or not below 1e308", "give numbers")
        if self.width < 1 or self.height < 1:
            raise SettingError(
                "camera.width/height", f"is {self.width}x{self.height}", "give the image size in pixels"
            )
        if max(self.width, self.height) > _MOST_PX:
            raise SettingError(
                "camera.width/height",
                f"is {self.width}x{self.height}",
                f"give images of at most {_MOST_PX} pixels a side",
            )
        self._check_focal_lengths()
        may_be_outside = self.is_window and np.isfinite(self.cx) and np.isfinite(self.cy)
        if not may_be_outside and not _is_inside(self.cx, self.cy, self.width, self.height):
            raise SettingError(
                "camera.cx/cy",
                f"({self.cx}, {self.cy}) lies outside the {self.width}x{self.height} image",
                "check that the intrinsics belong to this image size",
            )
        object.__setattr__(self, "distortion", self._whole_distortion())
        self._become_plain()
        if self.is_distorted:
            self._check_lens()

    def _check_focal_lengths(self) -> None:
        if not all(np.isfinite(f) and f > 0.0 for f in (self.fx, self.fy)):
            raise SettingError("camera.fx/fy", f"is ({self.fx}, {self.fy})", "focal lengths are positive pixels")
        if min(self.fx, self.fy) < _LEAST_FOCAL_PX and min(self.width, self.height) >= _LEAST_PX:
            problem = f"is ({self.fx:g}, {self.fy:g}) for images of {self.width}x{self.height}"
            raise SettingError("camera.fx/fy", problem, "give them in pixels, not as shares of the image")

    def _become_plain(self) -> None:
        """Hold Python's numbers: those of NumPy have another text, which neither files nor other libraries read."""
        for name in ("width", "height"):
            object.__setattr__(self, name, int(getattr(self, name)))
        for name in ("fx", "fy", "cx", "cy"):
            object.__setattr__(self, name, float(getattr(self, name)))

    def _whole_distortion(self) -> tuple[float, ...]:
        """The coefficients, as many as the model has."""
        if self.distortion_model not in MODELS:
            problem = f"is {self.distortion_model!r}"
            raise SettingError("camera.distortion_model", problem, f"choose from {', '.join(MODELS)}")
        names, given = COEFFICIENTS[self.distortion_model], tuple(map(float, np.ravel(self.distortion)))
        if self.distortion_model == "rational" and len(given) > len(names):
            given = self._without_further_terms(given, names)
        whole = given
        if not given or (self.distortion_model == "brown" and len(given) == 4):
            whole = given + (0.0,) * (len(names) - len(given))
        if len(whole) != len(names) or not np.all(np.isfinite(whole)):
            raise SettingError("camera.distortion", f"is {given}", f"give {', '.join(names)}")
        return whole

    @staticmethod
    def _without_further_terms(given: tuple[float, ...], names: tuple[str, ...]) -> tuple[float, ...]:
        """The coefficients of a rational lens without the zeros that OpenCV writes for terms it did not calibrate."""
        if any(given[len(names) :]):
            problem = f"has {given[len(names) :]} after {names[-1]}, of a thin prism or a tilted sensor"
            raise SettingError("camera.distortion", problem, f"calibrate with {', '.join(names)} alone")
        return given[: len(names)]

    def _check_lens(self) -> None:
        """Check that the distortion maps one ray, and no other, to each pixel."""
        ends = ((-0.5, self.width - 0.5, self.cx, self.fx), (-0.5, self.height - 0.5, self.cy, self.fy))
        x, y = (((first - middle) / f, (last - middle) / f) for first, last, middle, f in ends)
        reach = widest_radius(self._lens)
        if np.hypot(max(-x[0], x[1]), max(-y[0], y[1])) > reach:
            degrees = np.rad2deg(WIDEST_RAD)
            raise SettingError(
                "camera.distortion",
                f"shows more than {degrees:.0f} degrees off the optical axis in the corners of the image",
                f"crop the images to within {reach * min(self.fx, self.fy):.0f} pixels of (cx, cy)",
            )
        if not is_one_to_one(self._lens, *x, *y):
            names = ", ".join(COEFFICIENTS[self.distortion_model])
            raise SettingError(
                "camera.distortion",
                f"{self.distortion} folds the image onto itself",
                f"give {names} as they were measured with these focal lengths, or correct fx, fy, "
                f"which are ({self.fx:g}, {self.fy:g}) for images of {self.width}x{self.height}",
            )

    @property
    def _lens(self) -> Lens:
        return Lens(self.distortion_model, self.distortion)

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
        """Whether the camera differs from a pinhole."""
        return self._lens.is_distorted

    def of_width(self, width: int) -> Camera:
        """Camera of the same image resampled to a width, with the height that keeps its proportions."""
        return self.resized(width, max(1, round(width * self.height / self.width)))

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
        return self._window(width, height, self.fx, self.fy, self.cx - left, self.cy - top)

    def sampled(self, first: int, step: int) -> Camera:
        """Camera of every ``step``-th column and row from number ``first`` on, which are kept, not averaged."""
        width, height = (len(range(first, size, step)) for size in (self.width, self.height))
        fx, fy, cx, cy = (value / step for value in (self.fx, self.fy, self.cx - first, self.cy - first))
        return self._window(width, height, fx, fy, cx, cy)

    def _window(self, width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> Camera:
        is_window = self.is_window or not _is_inside(cx, cy, width, height)
        return replace(self, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, is_window=is_window)

    def flipped(self) -> Camera:
        """Camera of the image mirrored left to right."""
        names = COEFFICIENTS[self.distortion_model]
        mirrored = tuple(-k if name == "p2" else k for name, k in zip(names, self.distortion, strict=True))
        return replace(self, cx=self.width - 1 - self.cx, distortion=mirrored)

    def turned(self, quarter_turns: int) -> Camera:
        """Camera of the image turned counter-clockwise by quarter turns, as :func:`numpy.rot90` turns it."""
        camera = self
        for _ in range(quarter_turns % 4):
            camera = camera._turned_once()
        return camera

    def _turned_once(self) -> Camera:
        # The new x axis is the old y axis, the new y axis points against the old x axis.
        old = dict(zip(COEFFICIENTS[self.distortion_model], self.distortion, strict=True))
        new = {**old, "p1": -old["p2"], "p2": old["p1"]} if "p1" in old else old
        return replace(
            self,
            width=self.height,
            height=self.width,
            fx=self.fy,
            fy=self.fx,
            cx=self.cy,
            cy=self.width - 1 - self.cx,
            distortion=tuple(new.values()),
        )

    def project(self, points_camera: ArrayLike) -> FloatArray:
        """Project points in the camera's frame: (..., 3) m -> (..., 2) px; NaN for points with z <= 0."""
        points = np.asarray(points_camera, dtype=np.float64)
        z = np.where(points[..., 2] > 0.0, points[..., 2], np.nan)
        x, y = self._distort(points[..., 0] / z, points[..., 1] / z)
        return np.stack([x * self.fx + self.cx, y * self.fy + self.cy], axis=-1)

    def in_sight(self, points_camera: FloatArray, radius_m: float = 0.0) -> NDArray[np.bool_]:
        """Whether points in the camera's frame are within the field of view, (N, 3) m -> (N,).

        The field of view extends one pixel beyond the image. Test points before :meth:`project`: the distortion
        polynomial folds points far outside the field of view back into the image.

        Args:
            points_camera: points in the camera's frame, metres.
            radius_m: radius of spheres around the points. The result is then true for every sphere that reaches into
                the field of view, and for some that pass its edges.
        """
        least_m, *bounds = self.sight
        x, y, z = points_camera.T
        is_within = z > least_m - radius_m
        for off_axis, most in zip((np.abs(x), np.abs(y), np.sqrt(x * x + y * y)), bounds, strict=True):
            is_within &= off_axis < most * z + radius_m * math.hypot(1.0, most)
        return np.asarray(is_within)

    def in_view(self, points_camera: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Which points in the camera's frame, (N, 3) m, are in the image, or at most one pixel beyond it.

        The field of view of :meth:`in_sight` is larger: it is as wide to the left as to the right, whether or not the
        principal point is in the middle, and as wide everywhere as a distorted image is in its corners.

        Returns:
            Their indices, (M,), and pixels, (M, 2).
        """
        seen = np.flatnonzero(self.in_sight(points_camera))
        pixels = self.project(points_camera[seen])
        is_within = self.contains(pixels)
        return seen[is_within], pixels[is_within]

    def contains(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """Whether pixels (N, 2) are in the image, or at most one pixel beyond it, (N,)."""
        return np.asarray(np.all((pixels >= -1.0) & (pixels <= [self.width, self.height]), axis=1))

    @cached_property
    def sight(self) -> tuple[float, float, float, float]:
        """Bounds of :meth:`in_sight`: smallest depth, metres, and largest abs(x), abs(y) and hypot(x, y) at z = 1."""
        columns, rows = (np.linspace(-1.0, size, _BORDER_RAYS) for size in (self.width, self.height))
        x, y, _ = np.moveaxis(self.rays(np.stack(np.meshgrid(columns, rows), axis=-1)), -1, 0)
        return _MIN_DEPTH_M, float(np.abs(x).max()), float(np.abs(y).max()), float(np.hypot(x, y).max())

    def rays(self, pixels: ArrayLike) -> FloatArray:
        """Ray directions with z = 1 of pixels, (..., 2) px -> (..., 3): ``depth * ray`` is the point."""
        uv = np.asarray(pixels, dtype=np.float64)
        distorted = (uv - np.array([self.cx, self.cy])) / np.array([self.fx, self.fy])
        normalised = self._lens.undistort(distorted)
        return np.concatenate([normalised, np.ones((*normalised.shape[:-1], 1))], axis=-1)

    def ray_spread(self, rays: FloatArray) -> FloatArray:
        """Change of a ray's x per pixel in x and of its y per pixel in y, (N, 2), at rays (N, 2) with z = 1."""
        if not self.is_distorted:
            return np.tile([1.0 / self.fx, 1.0 / self.fy], (len(rays), 1))
        J_xx, J_xy, J_yy = self._lens.jacobian(*rays.T)
        determinant = J_xx * J_yy - J_xy * J_xy
        spread: FloatArray = np.stack([J_yy / self.fx, J_xx / self.fy], axis=1) / determinant[:, None]
        return spread

    def for_pnp(self, pixels: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixels (N, 2), intrinsic matrix (3, 3) and coefficients as OpenCV's perspective-n-point solvers take them.

        The solvers have no fisheye model. A fisheye's pixels become coordinates at z = 1, in units of the median span
        of a pixel there.
        """
        uv = np.asarray(pixels, dtype=np.float64)
        if self.distortion_model != "fisheye" or len(uv) == 0:
            return uv, self.matrix, np.asarray(self.distortion)
        rays = self.rays(uv)[:, :2]
        J_xx, J_xy, J_yy = self._lens.jacobian(*rays.T)
        scale = self.focal_px * float(np.median(np.sqrt(J_xx * J_yy - J_xy * J_xy)))
        return rays * scale, np.diag([scale, scale, 1.0]), np.zeros(5)

    def pixel_rays(self) -> FloatArray:
        """Rays of every pixel, (height, width, 3); read-only, since those of a few cameras are cached."""
        return _pixel_rays(self)

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
        return self._lens.distort(x, y) if self.is_distorted else (x, y)


def _fits_float(value: object) -> bool:
    """Whether a number is not a whole one of so many digits that no float holds it."""
    return not isinstance(value, int) or abs(value) < 2**1023


def _is_inside(cx: float, cy: float, width: int, height: int) -> bool:
    return -0.5 <= cx <= width - 0.5 and -0.5 <= cy <= height - 0.5


@lru_cache(2)
def _pixel_rays(camera: Camera) -> FloatArray:
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.rays(np.stack([u, v], axis=-1))
    rays.flags.writeable = False
    return rays
