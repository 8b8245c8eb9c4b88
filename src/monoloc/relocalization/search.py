"""Global relocalisation by one scan: a search around all reference poses.

Poses drawn around the reference poses are compared with the map by a part of the scan, with a wide error model. The
best that are apart from each other are refined one by one, and the best of these with the whole scan. Drawing from
the measurement where the belief is worth nothing is sensor resetting (Lenser and Veloso, *Sensor resetting
localization for poorly modelled mobile robots*, 2000).
"""

from __future__ import annotations

import numpy as np

from monoloc.geometry import FloatArray, pose_distance_m, se3_exp
from monoloc.likelihood.protocol import (
    LikelihoodConfig,
    ScanLikelihood,
    checked_mean_log_likelihood,
    weigh_depth_image,
)
from monoloc.likelihood.scan import Scan
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.particles import Particles, scatter
from monoloc.particle_filter.tempering import tempered_update

_SEED_DISTANCE_M = 0.3  # pose distance between reference poses that are searched around
_MOST_SEEDS = 1000
_DRAWN, _DRAWN_SD = 20, np.repeat([0.2, np.deg2rad(10.0)], 3)  # around each: metres, radians
_COARSE_POINTS = 50  # tell places apart as well as all points do, at a quarter of the time
_COARSE_LOG_DEPTH_SD = 0.1
_MODES, _MODE_DISTANCE_M = 5, 0.4
_COARSE_SD = (0.1, float(np.deg2rad(6.0)))  # of a pose before it is refined: metres and radians, per axis
_FINE_SD = (0.05, float(np.deg2rad(3.0)))  # after the first refinement
_COARSE_PARTICLES, _FINE_PARTICLES = 50, 100


class GlobalRelocalizer:
    """Searches a room for a camera, around reference poses.

    Args:
        likelihood, config: of scans under the map.
        reference_poses: (V, 4, 4) ``T_world_camera``, at least one.
        log_scale_sd: standard deviation of the depth's log-scale.
    """

    def __init__(
        self, likelihood: ScanLikelihood, config: LikelihoodConfig, reference_poses: FloatArray, log_scale_sd: float
    ) -> None:
        self._likelihood, self._config = likelihood, config
        self._seeds = _spread_out(reference_poses, _SEED_DISTANCE_M)
        self._log_scale_sd = log_scale_sd

    def sample_everywhere(self, count: int, rng: np.random.Generator) -> Particles:
        """Particles around all reference poses: nothing is known of the camera's pose."""
        seeds = self._seeds[rng.integers(len(self._seeds), size=count)]
        return self._drawn_around(seeds, rng)

    def sample_around(self, place: Estimate, count: int, rng: np.random.Generator) -> Particles:
        """Particles around a relocalised pose."""
        return scatter(place.pose, count, *_COARSE_SD, self._log_scale_sd, rng)

    def relocalize(self, scan: Scan, current: Estimate, rng: np.random.Generator) -> tuple[Estimate, float]:
        """The best pose for a scan of at least one point, and its mean log-likelihood, nats a point.

        Args:
            current: the particles' pose, which competes with those found.
        """
        coarse = _subset(scan, _COARSE_POINTS)
        drawn = self._drawn_around(np.repeat(self._seeds, _DRAWN, axis=0), rng)
        sd = max(_COARSE_LOG_DEPTH_SD, self._config.log_depth_sd)
        values = checked_mean_log_likelihood(self._likelihood, drawn.poses, drawn.log_scale, coarse, sd)
        modes = [
            self._refined(pose, _COARSE_SD, _COARSE_PARTICLES, coarse, rng) for pose in _modes(drawn.poses, values)
        ]
        mode, _ = self._best(modes, scan)
        return self._best([current, self._refined(mode.pose, _FINE_SD, _FINE_PARTICLES, scan, rng)], scan)

    def refine(self, pose: FloatArray, scan: Scan, rng: np.random.Generator) -> tuple[Estimate, float]:
        """Where particles around a pose (4, 4) gather under a scan, and the mean log-likelihood there."""
        return self._best([self._refined(pose, _COARSE_SD, _FINE_PARTICLES, scan, rng)], scan)

    def _drawn_around(self, seeds: FloatArray, rng: np.random.Generator) -> Particles:
        count = len(seeds)
        poses = seeds @ se3_exp(rng.standard_normal((count, 6)) * _DRAWN_SD)
        return Particles(poses, rng.standard_normal(count) * self._log_scale_sd, np.full(count, -np.log(count)))

    def _refined(
        self, pose: FloatArray, sd: tuple[float, float], count: int, scan: Scan, rng: np.random.Generator
    ) -> Estimate:
        def weigh(particles: Particles) -> Particles:
            return weigh_depth_image(particles, scan, self._likelihood, self._config)

        return estimate(tempered_update(scatter(pose, count, *sd, self._log_scale_sd, rng), weigh, rng))

    def _best(self, places: list[Estimate], scan: Scan) -> tuple[Estimate, float]:
        poses = np.stack([place.pose for place in places])
        log_scales = np.array([place.log_scale for place in places])
        values = checked_mean_log_likelihood(self._likelihood, poses, log_scales, scan)
        best = int(np.argmax(values))
        return places[best], float(values[best])


def _spread_out(poses: FloatArray, distance_m: float) -> FloatArray:
    """A subset such that every pose is within a distance of one of it: greedily, the farthest (Gonzalez 1985).

    A room has a few hundred; beyond :data:`_MOST_SEEDS` no more are taken.
    """
    chosen = [0]
    distances = pose_distance_m(poses[0], poses)
    while distances.max() > distance_m and len(chosen) < _MOST_SEEDS:
        chosen.append(int(np.argmax(distances)))
        distances = np.minimum(distances, pose_distance_m(poses[chosen[-1]], poses))
    return poses[chosen]


def _subset(scan: Scan, count: int) -> Scan:
    """So many of a scan's points, spread evenly over the image, or all if there are fewer."""
    chosen = np.unique(np.linspace(0, len(scan) - 1, count).round().astype(np.int64))
    return Scan(scan.points[chosen], scan.weights[chosen])


def _modes(poses: FloatArray, values: FloatArray) -> list[FloatArray]:
    """The best poses that are apart from each other, best first."""
    remaining = np.argsort(-values)
    modes: list[FloatArray] = []
    while len(remaining) and len(modes) < _MODES:
        modes.append(poses[remaining[0]])
        remaining = remaining[pose_distance_m(modes[-1], poses[remaining]) > _MODE_DISTANCE_M]
    return modes
