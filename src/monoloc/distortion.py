"""Lens distortion: image coordinates at z = 1 of a ray, to and from those that the lens makes of it.

All three models are OpenCV's (https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html and
https://docs.opencv.org/4.x/db/d58/group__calib3d__fisheye.html), and so is the order of their coefficients. With
r^2 = x^2 + y^2 each moves a point (x, y) to ``radial(r^2) * (x, y)``, and the first two add a tangential term:

- *brown*: a polynomial in r^2 (Brown 1971).
- *rational*: a quotient of two, for lenses up to about 120 degrees.
- *fisheye*: a polynomial in the angle to the optical axis (Kannala and Brandt 2006), for wider lenses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from monoloc.geometry import FloatArray

DistortionModel = Literal["brown", "rational", "fisheye"]
COEFFICIENTS: dict[DistortionModel, tuple[str, ...]] = {
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
MODELS: tuple[DistortionModel, ...] = get_args(DistortionModel)
WIDEST_RAD = np.deg2rad(85.0)
"""Largest angle between a pixel's ray and the optical axis: depth is along the axis, and vanishes at 90 degrees."""

_TABLE_RAD = np.deg2rad(87.0)  # beyond WIDEST_RAD, so that pixels just outside the image have rays of their own
_TABLE_POINTS = 513
_GRID_POINTS = 17  # along a side, at which the distortion is inverted as a check
_ROUND_TRIP_TOLERANCE = 1e-9  # largest error of undistorting and distorting again, at z = 1
_TINY = 1e-18  # replaces r^2 = 0 in quotients


@dataclass(frozen=True)
class Lens:
    """A model and its coefficients, as many as :data:`COEFFICIENTS` names."""

    model: DistortionModel
    coefficients: tuple[float, ...]

    @property
    def is_distorted(self) -> bool:
        """Whether the lens differs from a pinhole; a fisheye lens does with coefficients of zero, too."""
        return self.model == "fisheye" or any(self.coefficients)

    def distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Map coordinates (...) each of a ray at z = 1 to those in the image, in focal lengths."""
        r2 = x * x + y * y
        return self._distorted(x, y, r2, self._radial(r2))

    def _distorted(
        self, x: FloatArray, y: FloatArray, r2: FloatArray, radial: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        if self.model == "fisheye":
            return x * radial, y * radial
        p1, p2 = self.coefficients[2:4]
        dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return x * radial + dx, y * radial + dy

    def undistort(self, distorted: FloatArray) -> FloatArray:
        """Invert :meth:`distort`, (..., 2), by Newton's method from the inverse of the radial part.

        Coordinates beyond the first fold of the radial part, or beyond 87 degrees, are first moved to that radius.
        """
        if not self.is_distorted:
            return distorted
        radii, angles = _radial_inverse(self)
        radius = np.hypot(distorted[..., 0], distorted[..., 1])
        scale = np.minimum(1.0, radii[-1] / np.maximum(radius, _TINY))
        distorted = distorted * scale[..., None]
        radius = radius * scale
        start = np.tan(np.interp(radius, radii, angles)) / np.maximum(radius, _TINY)
        x, y = distorted[..., 0] * start, distorted[..., 1] * start
        for _ in range(20):
            r2 = x * x + y * y
            radial = self._radial(r2)
            J_xx, J_xy, J_yy = self._jacobian(x, y, radial, self._slope(r2, radial))
            predicted_x, predicted_y = self._distorted(x, y, r2, radial)
            dx, dy = distorted[..., 0] - predicted_x, distorted[..., 1] - predicted_y
            determinant = J_xx * J_yy - J_xy * J_xy
            step_x, step_y = (J_yy * dx - J_xy * dy) / determinant, (J_xx * dy - J_xy * dx) / determinant
            x, y = x + step_x, y + step_y
            if max(np.max(np.abs(step_x), initial=0.0), np.max(np.abs(step_y), initial=0.0)) < 1e-12:
                break
        return np.stack([x, y], axis=-1)

    def jacobian(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Entries xx, xy and yy, (...) each, of the Jacobian of :meth:`distort`, which is symmetric in all models."""
        r2 = x * x + y * y
        radial = self._radial(r2)
        return self._jacobian(x, y, radial, self._slope(r2, radial))

    def _jacobian(
        self, x: FloatArray, y: FloatArray, radial: FloatArray, slope: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        J_xx, J_xy, J_yy = radial + slope * x * x, slope * x * y, radial + slope * y * y
        if self.model == "fisheye":
            return J_xx, J_xy, J_yy
        p1, p2 = self.coefficients[2:4]
        return (
            J_xx + 2.0 * p1 * y + 6.0 * p2 * x,
            J_xy + 2.0 * (p1 * x + p2 * y),
            J_yy + 6.0 * p1 * y + 2.0 * p2 * x,
        )

    def _radial(self, r2: FloatArray) -> FloatArray:
        if self.model == "fisheye":
            r = np.sqrt(np.maximum(r2, _TINY))
            angle = np.arctan(r)
            return np.asarray(angle / r * _polynomial(self.coefficients, angle * angle))
        k1, k2, _, _, k3, *quotient = self.coefficients
        value = _polynomial((k1, k2, k3), r2)
        return value / _polynomial(quotient, r2) if any(quotient) else value

    def _slope(self, r2: FloatArray, radial: FloatArray) -> FloatArray:
        """Twice the derivative of the radial part, which is given, with respect to r^2."""
        if self.model == "fisheye":
            r2 = np.maximum(r2, _TINY)
            angle2 = np.arctan(np.sqrt(r2)) ** 2
            odd = [(2 * power + 3) * k for power, k in enumerate(self.coefficients)]
            growth = _polynomial(odd, angle2) / (1.0 + r2)  # of the distorted radius with r
            return np.asarray((growth - radial) / r2)
        k1, k2, _, _, k3, *quotient = self.coefficients
        slope = 2.0 * _polynomial_slope((k1, k2, k3), r2)
        if not any(quotient):
            return slope
        below = _polynomial(quotient, r2)
        return (slope - 2.0 * radial * _polynomial_slope(quotient, r2)) / below


def _polynomial(coefficients: tuple[float, ...] | list[float], s: FloatArray) -> FloatArray:
    """``1 + c1 s + c2 s^2 + ...``"""
    value = np.zeros_like(s)
    for coefficient in reversed(coefficients):
        value = s * (coefficient + value)
    return np.asarray(1.0 + value)


def _polynomial_slope(coefficients: tuple[float, ...] | list[float], s: FloatArray) -> FloatArray:
    """Derivative of :func:`_polynomial`."""
    value = np.zeros_like(s)
    for power, coefficient in reversed(list(enumerate(coefficients, start=1))):
        value = power * coefficient + s * value
    return np.asarray(value)


@lru_cache(maxsize=64)
def _radial_inverse(lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Table of the inverse of the radial part up to its first fold: distorted radii, increasing, and angles, rad."""
    angles = np.linspace(0.0, _TABLE_RAD, _TABLE_POINTS)
    r = np.tan(angles)
    with np.errstate(all="ignore"):
        radii = r * lens._radial(r * r)
        rises = np.append(np.diff(radii) > 0.0, False)
    end = int(np.argmin(rises)) + 1
    radii, angles = radii[:end], angles[:end]
    for array in (radii, angles):
        array.flags.writeable = False
    return radii, angles


def widest_radius(lens: Lens) -> float:
    """Radius in the image, in focal lengths, that a ray at :data:`WIDEST_RAD` reaches; infinite if the lens folds."""
    radii, angles = _radial_inverse(lens)
    return float(np.interp(WIDEST_RAD, angles, radii, right=np.inf))


@lru_cache(maxsize=256)
def is_one_to_one(lens: Lens, left: float, right: float, top: float, bottom: float) -> bool:
    """Whether one ray, and no other, belongs to each point of a rectangle of distorted coordinates, to the centre."""
    columns = np.linspace(min(left, 0.0), max(right, 0.0), _GRID_POINTS)
    rows = np.linspace(min(top, 0.0), max(bottom, 0.0), _GRID_POINTS)
    points = np.stack(np.meshgrid(columns, rows), axis=-1)
    with np.errstate(all="ignore"):
        undistorted = lens.undistort(points)
        x, y = undistorted[..., 0], undistorted[..., 1]
        J_xx, J_xy, J_yy = lens.jacobian(x, y)
        residual = np.abs(np.stack(lens.distort(x, y), axis=-1) - points).max()
        # Both eigenvalues are positive, as at the centre, up to the first fold.
        return bool(
            residual < _ROUND_TRIP_TOLERANCE and np.all(J_xx + J_yy > 0.0) and np.all(J_xx * J_yy - J_xy**2 > 0.0)
        )
