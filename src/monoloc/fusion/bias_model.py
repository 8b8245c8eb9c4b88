"""How far a pose measurement is biased: at the poses that a room was built from, and away from them."""

from __future__ import annotations

import math

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.geometry import FloatArray
from monoloc.landmarks.pnp import LandmarkPose

_CORRELATION_LENGTH_M = 0.7  # of the bias, in pose distance
COMMON_ERROR = 0.03
"""Variance that landmarks have in common, relative to that of one corner, at the reference poses of a new build. By
maximum likelihood over a real desk and a real kitchen: docs/decisions/fusion.md."""

MOST_SD = 100.0
"""Largest standard deviation of a model, metres and radians, and largest growth, the same a metre: such a bias is as
good as unknown."""

_STATED_GROWTH = np.array([0.3, 0.15])
"""Least growth of the particles' bias, metres and radians a metre, that a stated covariance allows for: the median of
five stretches beyond a build's frames. The errors in a build's own two regions may be small by chance
(docs/decisions/fusion.md)."""

_MOST_DISTANCE_M = 0.5  # to which growth was measured; from farther, errors were not seen to grow on


class BiasModel(BaseModel):
    """Standard deviation of a bias that varies slowly along a trajectory.

    Per axis it is ``sqrt(sd_at_reference^2 + (sd_growth * distance)^2)``, with the distance of
    :func:`monoloc.geometry.pose_distance_m` to the nearest reference pose, after the known part of the bias has been
    subtracted.

    Attributes:
        sd_at_reference_m, sd_at_reference_rad: of position and rotation at the reference poses.
        sd_growth_m, sd_growth_rad: growth, metres and radians a metre of pose distance.
        relocalization_sd_m, relocalization_sd_rad: of a relocalised pose, where that is wider.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    sd_at_reference_m: float = Field(0.0, ge=0.0, le=MOST_SD)
    sd_at_reference_rad: float = Field(0.0, ge=0.0, le=MOST_SD)
    sd_growth_m: float = Field(0.0, ge=0.0, le=MOST_SD)
    sd_growth_rad: float = Field(0.0, ge=0.0, le=MOST_SD)
    relocalization_sd_m: float = Field(0.0, ge=0.0, le=MOST_SD)
    relocalization_sd_rad: float = Field(0.0, ge=0.0, le=MOST_SD)

    @classmethod
    def bounded(cls, **measured: float) -> BiasModel:
        """The model of what was measured, up to what a bundle may state.

        Growth is an error divided by a distance, which has no bound: particles that wander off are metres away beside
        a reference pose.
        """
        return cls(**{name: min(value, MOST_SD) for name, value in measured.items()})

    def reference_variance_share(self, distance_m: float) -> FloatArray:
        """Variance at the reference poses divided by that at a distance, (6,)."""
        reference, here = self.sds(0.0), self.sds(distance_m)
        return np.divide(reference, here, out=np.ones(6), where=here > 0.0) ** 2

    def sds(self, distance_m: float) -> FloatArray:
        """Standard deviations of the bias twist (rho, phi), (6,), at a distance from the nearest reference pose."""
        return self._grown(np.array([self.sd_growth_m, self.sd_growth_rad]), distance_m)

    def stated_sds(self, distance_m: float) -> FloatArray:
        """The same for a covariance that is stated: the bias grows at least as it did in other rooms."""
        return self._grown(np.maximum([self.sd_growth_m, self.sd_growth_rad], _STATED_GROWTH), distance_m)

    def _grown(self, growth: FloatArray, distance_m: float) -> FloatArray:
        return np.repeat(np.hypot([self.sd_at_reference_m, self.sd_at_reference_rad], distance_m * growth), 3)

    def relocalization_sds(self, distance_m: float) -> FloatArray:
        """The same after a relocalisation, which may be wrong about the distance itself."""
        relocalization = np.repeat([self.relocalization_sd_m, self.relocalization_sd_rad], 3)
        return np.asarray(np.maximum(relocalization, self.sds(distance_m)))

    def correlation(self, step_m: float) -> float:
        """Correlation of the biases of two poses at a pose distance."""
        return math.exp(-step_m / _CORRELATION_LENGTH_M)


class LandmarkBiasModel(BiasModel):
    """The bias of landmark poses, and the noise beside it.

    The corners' localisation error alone would average out over hundreds of landmarks. But landmarks of one surface
    are misplaced together, and more so the farther the view is from those that placed them. In a flat view, such an
    error shifts and turns the pose along directions that the view determines weakly. So the covariance keeps the
    shape that the corners' localisation error gives it, and grows with the number of landmarks.

    Attributes:
        common_error: variance that landmarks have in common, see :data:`COMMON_ERROR`. In bundles that do not
            state it, any number of landmarks counts as twenty.
        common_error_growth: its growth a square metre of pose distance, up to half a metre.
    """

    common_error: float = Field(0.05, ge=0.0, le=1e4)
    common_error_growth: float = Field(0.0, ge=0.0, le=1e4)

    def covariance(self, measured: LandmarkPose, distance_m: float) -> FloatArray:
        """Covariance (6, 6) of a landmark pose without its bias, of a twist in the camera's frame.

        Args:
            distance_m: pose distance to the nearest reference pose.
        """
        common = self.common_error + self.common_error_growth * min(distance_m, _MOST_DISTANCE_M) ** 2
        factor = max(1.0, len(measured.points) * common)
        # Errors in common count as so many fewer landmarks, for the other poses of a flat view too.
        shares = np.exp(-measured.rival_nats / factor)
        spread = np.einsum("k,ki,kj->ij", shares, measured.rivals, measured.rivals) / (1.0 + shares.sum())
        return np.asarray(factor * measured.covariance + spread)
