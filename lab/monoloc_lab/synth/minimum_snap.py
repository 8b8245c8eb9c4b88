"""Minimum-snap splines through waypoints, which a quadrotor can follow.

Mellinger and Kumar, *Minimum snap trajectory generation and control for quadrotors* (ICRA 2011). A piecewise
polynomial of degree 7 that rests at both ends minimises the integral of the squared fourth derivative exactly when
its first six derivatives are continuous at the waypoints, which is a square linear system.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import FloatArray

_COEFFICIENTS = 8
_AT_REST = 3  # derivatives that vanish at both ends: velocity, acceleration, jerk


@dataclass(frozen=True)
class Spline:
    """S segments in D dimensions.

    Attributes:
        durations_s: (S,).
        coefficients: (S, 8, D), of the powers of the time in the segment divided by its duration.
    """

    durations_s: FloatArray
    coefficients: FloatArray

    @property
    def duration_s(self) -> float:
        return float(self.durations_s.sum())

    def __call__(self, times_s: ArrayLike, derivative: int = 0) -> FloatArray:
        """Values or derivatives at (N,) times within the spline: (N, D)."""
        t = np.asarray(times_s, dtype=np.float64)
        starts = np.concatenate([[0.0], np.cumsum(self.durations_s)])
        segment = np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(self.durations_s) - 1)
        duration = self.durations_s[segment]
        rows = _powers((t - starts[segment]) / duration, derivative)
        return np.asarray(np.einsum("np,npd->nd", rows, self.coefficients[segment]) / duration[:, None] ** derivative)

    def slowed(self, factor: float) -> Spline:
        """The same path in ``factor`` times the time."""
        return replace(self, durations_s=self.durations_s * factor)


def concatenated(splines: Sequence[Spline]) -> Spline:
    """Splines one after another; each is at rest at both ends and starts where the previous one ends."""
    return Spline(
        np.concatenate([spline.durations_s for spline in splines]),
        np.concatenate([spline.coefficients for spline in splines]),
    )


def minimum_snap(waypoints: ArrayLike, durations_s: ArrayLike) -> Spline:
    """The spline through (S + 1, D) waypoints with (S,) times between them, at rest at both ends."""
    points = np.asarray(waypoints, dtype=np.float64)
    durations = np.asarray(durations_s, dtype=np.float64)
    segments = len(durations)
    if points.ndim != 2 or len(points) != segments + 1:
        raise ValueError(f"waypoints must have shape ({segments + 1}, D), got {points.shape}")
    size = segments * _COEFFICIENTS
    system, right = np.zeros((size, size)), np.zeros((size, points.shape[1]))
    row = 0
    for s in range(segments):
        for end in (0, 1):
            system[row, _block(s)] = _powers(np.array([float(end)]), 0)[0]
            right[row] = points[s + end]
            row += 1
    for derivative in range(1, _AT_REST + 1):
        for s, rest in ((0, 0.0), (segments - 1, 1.0)):
            system[row, _block(s)] = _powers(np.array([rest]), derivative)[0]
            row += 1
    for s in range(segments - 1):
        for derivative in range(1, 2 * _AT_REST + 1):
            # Scaled by the first duration; otherwise the rows would differ by orders of magnitude.
            ratio = (durations[s] / durations[s + 1]) ** derivative
            system[row, _block(s)] = _powers(np.ones(1), derivative)[0]
            system[row, _block(s + 1)] = -ratio * _powers(np.zeros(1), derivative)[0]
            row += 1
    solution = np.asarray(np.linalg.solve(system, right), dtype=np.float64)
    return Spline(durations, solution.reshape(segments, _COEFFICIENTS, -1))


def _block(segment: int) -> slice:
    return slice(segment * _COEFFICIENTS, (segment + 1) * _COEFFICIENTS)


def _powers(x: FloatArray, derivative: int) -> FloatArray:
    """(N,) -> (N, 8): derivatives of 1, x, ..., x^7."""
    rows = np.zeros((len(x), _COEFFICIENTS))
    for power in range(derivative, _COEFFICIENTS):
        factor = float(np.prod(np.arange(power - derivative + 1, power + 1)))
        rows[:, power] = factor * x ** (power - derivative)
    return rows
