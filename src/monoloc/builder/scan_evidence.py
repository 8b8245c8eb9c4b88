"""How well a scan fits at right and at wrong poses."""

from __future__ import annotations

import numpy as np

from monoloc.builder.relocalization_error import measure_relocalization_error
from monoloc.builder.samples import Sample, scans_of
from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray, pose_distance_m
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.likelihood import make_likelihood
from monoloc.likelihood.protocol import ScanLikelihood
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig
from monoloc.progress import NoProgress
from monoloc.relocalization.search import GlobalRelocalizer
from monoloc.sensor_depth import sensor_settings, sparse_depth
from monoloc.supervision.integrity import WRONG_DISTANCE_M, Classes, IntegrityModel, SensorModel

_MOST_SCANS = 60
_WRONG_POSES = 2  # a scan


def measure_scan_evidence(
    likelihood: ScanLikelihood,
    samples: list[Sample],
    reference_poses: FloatArray,
    config: LocalizerConfig,
    rng: np.random.Generator,
) -> Classes:
    """Fits where particles gather around true poses, and where they gather around others.

    Particles of a lost camera gather at the best fit nearby, so a wrong pose is judged by that.

    Args:
        likelihood: of scans in the room.
        samples: frames at known poses; at least one gives a scan.
        reference_poses: (V, 4, 4) ``T_world_camera``: the wrong poses are drawn from them.
        config: of the localizer.

    Returns:
        Classes of fits; a single one, which says nothing, where all reference poses are near each other.
    """
    relocalizer = GlobalRelocalizer(likelihood, config.likelihood, reference_poses, config.log_scale_sd)
    scans = scans_of(samples, config, rng)
    right, wrong = [], []
    for scan, sample in (scans[index] for index in evenly_spaced(len(scans), _MOST_SCANS).tolist()):
        right.append(relocalizer.refine(sample.pose, scan, rng)[1])
        others = reference_poses[pose_distance_m(sample.pose, reference_poses) >= WRONG_DISTANCE_M]
        for pose in rng.permutation(others)[:_WRONG_POSES]:
            wrong.append(relocalizer.refine(pose, scan, rng)[1])
    return IntegrityModel.scan_classes(right, wrong) if wrong else Classes()


def measure_sensor(bundle: Bundle, recording: Recording, rng: np.random.Generator) -> SensorModel:
    """How well a depth sensor's scans fit the bundle's map at right and at wrong poses, and how they relocalise.

    Args:
        recording: posed frames; without depth, nothing is measured.
    """
    poses = recording.poses
    assert poses is not None
    if not recording.has_depth:
        return SensorModel()
    settings = sensor_settings(bundle.settings)
    chosen = evenly_spaced(len(recording), _MOST_SCANS)
    samples = [
        Sample(index, sparse_depth(recording.depth(index), recording.camera), poses[index])
        for index in chosen.tolist()
    ]
    scans = scans_of(samples, settings, rng)
    if not scans:
        return SensorModel()
    likelihood = make_likelihood(bundle.adapted, settings.likelihood)
    values = [
        float(likelihood.mean_log_likelihood(sample.pose[None], np.zeros(1), scan)[0]) for scan, sample in scans
    ]
    return SensorModel(
        thresholds=LikelihoodThresholds.from_log_likelihoods(values),
        scan=measure_scan_evidence(likelihood, samples, poses, settings, rng),
        search_precision=measure_relocalization_error(likelihood, samples, poses, settings, rng, NoProgress())[2],
    )
