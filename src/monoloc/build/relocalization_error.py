"""How far off a lost camera is found, measured at frames that tuned nothing."""

from __future__ import annotations

import math

import numpy as np

from monoloc.build.calibrate import Sample, scans_of
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, viewpoints_apart
from monoloc.likelihood.scan_likelihood import Measurement
from monoloc.localizer import LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.estimate import Estimate
from monoloc.progress import Progress
from monoloc.relocalization.search import Search

_SAMPLES = 30
_BESIDE_M = 0.5  # viewpoints nearer than this are looked around from elsewhere only, a radian for a metre
_SHARE, _CHI2_SHARE_3 = 80.0, 4.642  # percentile of errors, and of chi-squared with three degrees of freedom


def measure_found(
    mixture: GaussianMixture,
    samples: list[Sample],
    viewpoints: FloatArray,
    config: LocalizerConfig,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[float, float]:
    """Standard deviations per axis, metres and radians, of where one scan says that a lost camera is.

    Each frame is looked for from viewpoints that are half a metre away or more, as if the camera were as far beside
    the recorded path, where there are such; a network that saw no view from there may well take one for another. The
    deviations are those of which four errors of five are within what they should be: the fifth is for the trial, in
    which a camera is found again only if nothing fits better a second later.

    Args:
        mixture: of the room.
        samples: frames that tuned nothing; one at least gives a scan.
        viewpoints: (V, 4, 4) ``T_world_camera`` of the frames that the room is built from.
        config: of the localizer.
    """
    measurement = Measurement(mixture, config.measurement)
    usable = scans_of(samples, config, rng)
    chosen = np.unique(np.linspace(0, len(usable) - 1, min(_SAMPLES, len(usable))).round().astype(np.int64))
    found, true = [], []
    with progress.task("searching", len(chosen)) as show:
        for done, (scan, sample) in enumerate(usable[index] for index in chosen.tolist()):
            distances_m = viewpoints_apart(sample.pose, viewpoints)
            places = viewpoints[distances_m >= min(_BESIDE_M, float(distances_m.max()))]
            search = Search(measurement, places, config.log_scale_sd)
            anywhere = Estimate(places[0], np.eye(6), 0.0)
            found.append(search(scan, anywhere, rng)[0].pose)
            true.append(sample.pose)
            show(done + 1)
    errors = pose_errors(np.stack(found), np.stack(true))
    far_m, far_rad = (np.percentile(error, _SHARE) for error in (errors.position_m, errors.rotation_rad))
    return float(far_m) / math.sqrt(_CHI2_SHARE_3), float(far_rad) / math.sqrt(_CHI2_SHARE_3)
