"""How far off a distance to an obstacle may be, as far as the build measured it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray


def tells_obstacles(bundle: Bundle) -> bool:
    """Whether the network was tuned: others report half or more of the obstacles under a metre as farther away."""
    return bundle.provenance.tune != "none"


@dataclass(frozen=True)
class DepthError:
    """Standard deviation of a distance: one part in proportion to it, and one that is the same everywhere.

    Attributes:
        relative_sd: share of the distance.
        absolute_sd_m: metres.
        is_measured: whether a build measured them in the room with the network that is used. If not, they are those
            of the settings, and say little.
    """

    relative_sd: float
    absolute_sd_m: float
    is_measured: bool

    @classmethod
    def of(cls, bundle: Bundle) -> DepthError:
        """What the build of a bundle measured.

        The standard deviation of log-depth and that of its scale are fitted at true poses of frames that tuned
        nothing. The scale of the map adds to them where no sensor measured it. Between the build's views depth errs
        by as much; from others it may err by more.
        """
        settings, likelihood = bundle.settings, bundle.settings.likelihood
        parts = [settings.log_scale_sd, bundle.provenance.scale_sd or 0.0]
        is_relative = likelihood.kind == "ray"
        if is_relative:
            parts.append(likelihood.log_depth_sd)
        absolute_m = 0.0 if is_relative else likelihood.noise_sd_m
        return cls(float(np.linalg.norm(parts)), absolute_m, tells_obstacles(bundle))

    def sd_m(self, distances_m: FloatArray) -> FloatArray:
        """Standard deviation of distances (...) m; NaN where there is none, infinite beyond what is told."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.hypot(self.relative_sd * distances_m, self.absolute_sd_m))
