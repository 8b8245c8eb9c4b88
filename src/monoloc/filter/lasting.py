"""Errors that last from frame to frame, as those of a network's depth do: of them the particles know nothing."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.filter.estimate import Estimate
from monoloc.geometry import FloatArray, se3_exp

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Twist = tuple[_Finite, _Finite, _Finite, _Finite, _Finite, _Finite]

_LENGTH_M = 2.0  # of a change of viewpoint, a radian for a metre, over which errors become others


class LastingErrors(BaseModel):
    """What they are in the mean, and how wide: as measured at the viewpoints of a build, and wider away from them.

    A standard deviation per axis, about the mean, is ``sqrt(near^2 + (growth * distance)^2)``, with the distance of
    :func:`monoloc.geometry.viewpoints_apart` to the nearest of those viewpoints.

    Attributes:
        mean: twist (rho, phi) in the camera's frame, metres and radians: but for what varies, the particles' pose
            at the viewpoints is the true one times its exponential.
        near_sd_m, near_sd_rad: of position and rotation at the viewpoints.
        growth_m, growth_rad: metres and radians a metre away from them.
        found_sd_m, found_sd_rad: of where a lost camera was found, if that is wider.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    mean: _Twist = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    near_sd_m: float = Field(0.0, ge=0.0)
    near_sd_rad: float = Field(0.0, ge=0.0)
    growth_m: float = Field(0.0, ge=0.0)
    growth_rad: float = Field(0.0, ge=0.0)
    found_sd_m: float = Field(0.0, ge=0.0)
    found_sd_rad: float = Field(0.0, ge=0.0)

    def without_mean(self, located: Estimate, distance_m: float) -> Estimate:
        """What the particles say so far from the nearest viewpoint, less what they err by in the mean.

        The mean was found at the viewpoints: away from them it counts by near errors' share of the variance.
        """
        near, widths = self.widths(0.0), self.widths(distance_m)
        share = np.divide(near, widths, out=np.ones(6), where=widths > 0.0) ** 2
        return replace(located, pose=located.pose @ se3_exp(-share * np.array(self.mean)))

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
