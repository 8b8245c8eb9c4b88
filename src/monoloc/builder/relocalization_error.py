"""How far a relocalised pose is off, measured at known poses."""

from __future__ import annotations

import math

import numpy as np

from monoloc.builder.samples import Sample, scans_of
from monoloc.evaluation.consistency import FAR_M
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, pose_distance_m
from monoloc.io.recording import evenly_spaced
from monoloc.likelihood.protocol import ScanLikelihood
from monoloc.localizer_config import LocalizerConfig
from monoloc.particle_filter.estimate import Estimate
from monoloc.progress import Progress
from monoloc.relocalization.search import GlobalRelocalizer

_MOST_SCANS = 30
_LEAST_DISTANCE_M = 0.5  # pose distance of the reference poses that a scan is searched from
_PERCENTILE, _CHI2_PERCENTILE_3 = 80.0, 4.642  # of errors, and of chi-squared with three degrees of freedom


def measure_relocalization_error(
    likelihood: ScanLikelihood,
    samples: list[Sample],
    reference_poses: FloatArray,
    config: LocalizerConfig,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[float, float, float]:
    """How well one scan relocalises a camera.

    Each scan is searched from reference poses at least half a metre away, if there are such, as if the camera were
    that far from the recorded path: at a view that a network has not seen, it may mistake one place for another.
    Four errors of five are within these deviations; the fifth is left to the verification, in which a pose is
    believed only if no other fits better a second later.

    Args:
        likelihood: of scans in the room.
        samples: frames at known poses; at least one gives a scan.
        reference_poses: (V, 4, 4) ``T_world_camera``.
        config: of the localizer.

    Returns:
        Standard deviations per axis, metres and radians, and the share of poses less than 30 cm off.
    """
    scans = scans_of(samples, config, rng)
    chosen = evenly_spaced(len(scans), _MOST_SCANS)
    found, true = [], []
    with progress.task("searching", len(chosen)) as show:
        for done, (scan, sample) in enumerate(scans[index] for index in chosen.tolist()):
            distances_m = pose_distance_m(sample.pose, reference_poses)
            places = reference_poses[distances_m >= min(_LEAST_DISTANCE_M, float(distances_m.max()))]
            relocalizer = GlobalRelocalizer(likelihood, config.likelihood, places, config.log_scale_sd)
            anywhere = Estimate(places[0], np.eye(6), 0.0)
            found.append(relocalizer.relocalize(scan, anywhere, rng)[0].pose)
            true.append(sample.pose)
            show(done + 1)
    errors = pose_errors(np.stack(found), np.stack(true))
    far_m, far_rad = (np.percentile(error, _PERCENTILE) for error in (errors.position_m, errors.rotation_rad))
    near = int((errors.position_m < FAR_M).sum())
    precision = (near + 1.0) / (len(errors.position_m) + 2.0)  # Laplace's rule: few scans prove nothing
    chi = math.sqrt(_CHI2_PERCENTILE_3)
    return float(far_m) / chi, float(far_rad) / chi, precision
