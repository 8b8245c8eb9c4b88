"""Errors that last from frame to frame, as those of a network's depth do: of them the particles know nothing."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.geometry import FloatArray

_LENGTH_M = 2.0  # of a change of viewpoint, a radian for a metre, over which errors become others


class LastingErrors(BaseModel):
    """How wide they are: as measured at the viewpoints of a build, and wider away from them.

    A standard deviation per axis, about what is known of them, is ``sqrt(near^2 + (growth * distance)^2)``, with the
    distance of :func:`monoloc.geometry.viewpoints_apart` to the nearest of those viewpoints.

    Attributes:
        near_sd_m, near_sd_rad: of position and rotation at the viewpoints.
        growth_m, growth_rad: metres and radians a metre away from them.
        found_sd_m, found_sd_rad: of where a lost camera was found, if that is wider.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    near_sd_m: float = Field(0.0, ge=0.0)
    near_sd_rad: float = Field(0.0, ge=0.0)
    growth_m: float = Field(0.0, ge=0.0)
    growth_rad: float = Field(0.0, ge=0.0)
    found_sd_m: float = Field(0.0, ge=0.0)
    found_sd_rad: float = Field(0.0, ge=0.0)

    def near_share(self, distance_m: float) -> FloatArray:
        """Near errors' share of the variance so far from the nearest viewpoint, (6,)."""
        near, widths = self.widths(0.0), self.widths(distance_m)
        return np.divide(near, widths, out=np.ones(6), where=widths > 0.0) ** 2

    def widths(self, distance_m: float) -> FloatArray:
        """Standard deviations of a twist (rho, phi), (6,), so far from the nearest viewpoint."""
        sd = np.hypot([self.near_sd_m, self.near_sd_rad], distance_m * np.array([self.growth_m, self.growth_rad]))
        return np.repeat(sd, 3)

    def found_widths(self, distance_m: float) -> FloatArray:
        """The same where a lost camera was found: how far it is from the viewpoints, it may be wrong about."""
        found = np.repeat([self.found_sd_m, self.found_sd_rad], 3)
        return np.asarray(np.maximum(found, self.widths(distance_m)))

    def kept(self, step_m: float) -> float:
        """Correlation of the errors of two viewpoints that are so far apart."""
        return math.exp(-step_m / _LENGTH_M)
