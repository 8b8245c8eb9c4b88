"""A box in a room, along the world's axes or turned about the vertical."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, so3_exp

_FORM = "X0,Y0,Z0,X1,Y1,Z1"

EDGES = tuple((a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1)
"""Pairs of corners of a box; corner n is at the upper end of axis i if bit i of n is set."""


@dataclass(frozen=True)
class Box:
    """A box; a :class:`monoloc.map.local_fit.Region`.

    Attributes:
        centre: (3,), world frame, metres.
        half: half of its edges, (3,), metres, each positive.
        R_world_box: its axes, (3, 3).
    """

    centre: FloatArray
    half: FloatArray
    R_world_box: FloatArray

    @classmethod
    def between(cls, lower: FloatArray, upper: FloatArray, down: FloatArray, yaw_rad: float = 0.0) -> Box:
        """Between two corners (3,) of a box along the world's axes, then turned about its centre.

        Args:
            down: (3,) unit vector, world frame; the turn is about the upward direction, right-handed.
            yaw_rad: of the turn.
        """
        return cls(0.5 * (lower + upper), 0.5 * (upper - lower), so3_exp(-yaw_rad * down))

    @property
    def reach_m(self) -> float:
        """Half of its diagonal."""
        return float(np.linalg.norm(self.half))

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether each of points (N, 3), world frame, is in the box, (N,)."""
        return np.asarray(np.all(np.abs((points - self.centre) @ self.R_world_box) <= self.half, axis=1))

    @property
    def corners(self) -> FloatArray:
        """Its corners, (8, 3), world frame, in the order of :data:`EDGES`."""
        signs = np.array([[(corner >> axis) & 1 for axis in range(3)] for corner in range(8)]) * 2.0 - 1.0
        return np.asarray(self.centre + (signs * self.half) @ self.R_world_box.T)


def parse_box(text: str) -> tuple[FloatArray, FloatArray]:
    """Two opposite corners (3,) each, the lower one first, from the six numbers of ``--box``.

    Raises:
        SettingError: they are not, or the box is flat.
    """
    values = parse_numbers(text, 6, _FORM, "--box")
    lower, upper = np.minimum(values[:3], values[3:]), np.maximum(values[:3], values[3:])
    if np.any(upper - lower <= 0.0):
        raise SettingError("--box", f"is {text!r}, a box without volume", f"give two opposite corners as {_FORM}")
    return lower, upper


def parse_numbers(text: str, count: int, form: str, option: str) -> FloatArray:
    """Numbers with commas between them, (count,).

    Raises:
        SettingError: they are not so many finite numbers.
    """
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise SettingError(option, f"is {text!r}", f"write {form} in metres")
    return values
