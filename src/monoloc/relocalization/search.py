"""Where in the whole room a camera is, by one scan: around the viewpoints that the room was built from.

Poses drawn around those are held against the map with a part of the scan, and tolerance for being beside the place;
the best few that are apart are refined, each by itself, and the best of them with all of the scan. Drawing from what
the sensor says where the belief is worth nothing is sensor resetting (Lenser and Veloso, *Sensor resetting
localization for poorly modelled mobile robots*, 2000).
"""

from __future__ import annotations

import numpy as np

from monoloc.geometry import FloatArray, se3_exp, viewpoints_apart
from monoloc.likelihood.scan import Scan
from monoloc.likelihood.scan_likelihood import Measurement
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.particles import Particles, scatter
from monoloc.particle_filter.tempering import correct

_PLACES_APART_M = 0.3  # of viewpoints that are each drawn around, a radian for a metre
_DRAWN, _DRAWN_SD = 20, np.repeat([0.2, np.deg2rad(10.0)], 3)  # around each: metres, radians
_FEW_POINTS = 50  # tell places apart; all of them cost four times as much and tell no more
_TOLERANT_LOG_DEPTH_SD = 0.1
_MODES, _MODES_APART_M = 5, 0.4
_NEAR_SD = (0.1, float(np.deg2rad(6.0)))  # of a pose that is to be refined: metres and radians, per axis
_NEARER_SD = (0.05, float(np.deg2rad(3.0)))  # once it was
_REFINING, _REFINING_ALL = 50, 100  # particles: with few points, and with all


class Search:
    """Looks for a camera around viewpoints.

    Args:
        measurement: how well scans fit the map.
        viewpoints: (V, 4, 4) ``T_world_camera``, at least one.
        log_scale_sd: of the depth's log-scale, from image to image.
    """

    def __init__(self, measurement: Measurement, viewpoints: FloatArray, log_scale_sd: float) -> None:
        self._measurement = measurement
        self._places = _spread_out(viewpoints, _PLACES_APART_M)
        self._log_scale_sd = log_scale_sd

    def anywhere(self, count: int, rng: np.random.Generator) -> Particles:
        """So many particles around all viewpoints: the belief of one who knows nothing."""
        places = self._places[rng.integers(len(self._places), size=count)]
        return self._drawn_around(places, rng)

    def around(self, found: Estimate, count: int, rng: np.random.Generator) -> Particles:
        """So many particles where the camera was found."""
        return scatter(found.pose, count, *_NEAR_SD, self._log_scale_sd, rng)

    def __call__(self, scan: Scan, here: Estimate, rng: np.random.Generator) -> tuple[Estimate, float]:
        """The best place for a scan of at least one point, and how well it fits there: mean log-likelihood, nats.

        Args:
            here: a place that is among those judged.
        """
        few = _some_of(scan, _FEW_POINTS)
        drawn = self._drawn_around(np.repeat(self._places, _DRAWN, axis=0), rng)
        tolerant_sd = max(_TOLERANT_LOG_DEPTH_SD, self._measurement.config.log_depth_sd)
        fits = self._measurement.mean_log_likelihood(drawn.poses, drawn.log_scale, few, tolerant_sd)
        modes = [self._refined(pose, _NEAR_SD, _REFINING, few, rng) for pose in _best_apart(drawn.poses, fits)]
        mode, _ = self._best(modes, scan)
        return self._best([here, self._refined(mode.pose, _NEARER_SD, _REFINING_ALL, scan, rng)], scan)

    def _drawn_around(self, places: FloatArray, rng: np.random.Generator) -> Particles:
        count = len(places)
        poses = places @ se3_exp(rng.standard_normal((count, 6)) * _DRAWN_SD)
        return Particles(poses, rng.standard_normal(count) * self._log_scale_sd, np.full(count, -np.log(count)))

    def _refined(
        self, pose: FloatArray, sd: tuple[float, float], count: int, scan: Scan, rng: np.random.Generator
    ) -> Estimate:
        particles = scatter(pose, count, *sd, self._log_scale_sd, rng)
        return estimate(correct(particles, lambda some: self._measurement.weigh_image(some, scan), rng))

    def _best(self, places: list[Estimate], scan: Scan) -> tuple[Estimate, float]:
        poses = np.stack([place.pose for place in places])
        log_scales = np.array([place.log_scale for place in places])
        fits = self._measurement.mean_log_likelihood(poses, log_scales, scan)
        best = int(np.argmax(fits))
        return places[best], float(fits[best])


def _spread_out(viewpoints: FloatArray, apart_m: float) -> FloatArray:
    """Some of the viewpoints, from which no other is farther: each time the farthest from those chosen."""
    chosen = [0]
    distances = viewpoints_apart(viewpoints[0], viewpoints)
    while distances.max() > apart_m:
        chosen.append(int(np.argmax(distances)))
        distances = np.minimum(distances, viewpoints_apart(viewpoints[chosen[-1]], viewpoints))
    return viewpoints[chosen]


def _some_of(scan: Scan, count: int) -> Scan:
    """So many of a scan's points, even over the image, or all if there are fewer."""
    chosen = np.unique(np.linspace(0, len(scan) - 1, count).round().astype(np.int64))
    return Scan(scan.points[chosen], scan.weights[chosen])


def _best_apart(poses: FloatArray, fits: FloatArray) -> list[FloatArray]:
    """The best poses that are apart from each other, best first."""
    left = np.argsort(-fits)
    best: list[FloatArray] = []
    while len(left) and len(best) < _MODES:
        best.append(poses[left[0]])
        left = left[viewpoints_apart(best[-1], poses[left]) > _MODES_APART_M]
    return best
