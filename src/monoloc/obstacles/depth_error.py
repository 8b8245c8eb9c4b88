"""How far off a distance to an obstacle may be, as far as the build measured it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray
from monoloc.io.recording import evenly_spaced
from monoloc.map.depth_rendering import RENDERED_WIDTH, cloud_depth, point_spacing_m
from monoloc.map.surface import surface_points

_SEEN_POINTS, _SEEN_VIEWS = 50_000, 30  # of the map, and of the build's cameras, that tell how near these looked
_NEAREST_PERCENT = 1.0


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
        nearest_m: depth than which the build's cameras saw 1 % nearer. What is nearer was hardly ever seen when the
            errors were measured and the network was tuned: it may be measured as much farther than it is.
    """

    relative_sd: float
    absolute_sd_m: float
    is_measured: bool
    nearest_m: float = 0.0

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
        return cls(float(np.linalg.norm(parts)), absolute_m, tells_obstacles(bundle), nearest_depth_m(bundle))

    def sd_m(self, distances_m: FloatArray) -> FloatArray:
        """Standard deviation of distances (...) m; NaN where there is none, infinite where a direction is free."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.hypot(self.relative_sd * distances_m, self.absolute_sd_m))


def nearest_depth_m(bundle: Bundle) -> float:
    """Depth than which the build's cameras saw 1 % nearer, by the map; 0 if the bundle keeps no reference poses."""
    poses = bundle.reference_poses.poses
    if len(poses) == 0:
        return 0.0
    cloud = surface_points(bundle.original, _SEEN_POINTS, np.random.default_rng(0))
    camera, spacing_m = bundle.camera.of_width(RENDERED_WIDTH), point_spacing_m(cloud)
    views = [cloud_depth(cloud, camera, pose, spacing_m) for pose in poses[evenly_spaced(len(poses), _SEEN_VIEWS)]]
    seen = np.concatenate([view[view > 0.0] for view in views])
    return float(np.percentile(seen, _NEAREST_PERCENT)) if len(seen) else 0.0
