"""How well scans fit at right and at wrong poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.builder.samples import Sample
from monoloc.builder.scan_evidence import measure_scan_evidence, measure_sensor
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, make_pose
from monoloc.likelihood.protocol import LikelihoodConfig, ScanLikelihood
from monoloc.likelihood.ray import RayLikelihood
from monoloc.likelihood.scan import Scan
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.estimate import Estimate
from monoloc.supervision.integrity import Classes, SensorModel
from synthetic_room import NO_DEPTH, SETTINGS, Room, RoomRecording, make_bundle, make_path, sparse_depth

POSES = make_path(20, rate_hz=4.0)  # five seconds


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), POSES)


def samples_of(recording: RoomRecording) -> list[Sample]:
    return [Sample(index, sparse_depth(recording, index), pose) for index, pose in enumerate(POSES)]


class _Relocalizer:
    """A scan fits by 2 + 0.1 times its number at poses below ``bound_m`` along x, and by 0 elsewhere."""

    def __init__(self, bound_m: float) -> None:
        self.bound_m = bound_m
        self.refined_m: list[float] = []

    def __call__(
        self, likelihood: ScanLikelihood, config: LikelihoodConfig, reference_poses: FloatArray, log_scale_sd: float
    ) -> _Relocalizer:
        assert config == SETTINGS.likelihood and log_scale_sd == SETTINGS.log_scale_sd
        return self

    def refine(self, pose: FloatArray, scan: Scan, rng: np.random.Generator) -> tuple[Estimate, float]:
        x_m = float(pose[0, 3])
        self.refined_m.append(x_m)
        return Estimate(pose, np.eye(6), 0.0), 2.0 + x_m if x_m < self.bound_m else 0.0


def along_x(*places_m: float) -> FloatArray:
    places = np.zeros((len(places_m), 3))
    places[:, 0] = places_m
    return make_pose(np.tile(np.eye(3), (len(places), 1, 1)), places)


def test_wrong_poses_are_those_of_the_recording_that_are_far_from_the_true_one(
    recording: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two of them a scan, none nearer than particles could find back from."""
    relocalizer = _Relocalizer(bound_m=1.0)
    monkeypatch.setattr("monoloc.builder.scan_evidence.GlobalRelocalizer", relocalizer)
    true_m = (0.0, 0.1, 0.2, 0.3)
    samples = [Sample(index, sparse_depth(recording, index), pose) for index, pose in enumerate(along_x(*true_m))]
    samples.insert(1, Sample(9, NO_DEPTH, np.eye(4)))  # no scan
    reference_poses = along_x(*true_m, 0.69, 1.1, 1.2, 1.3)
    classes = measure_scan_evidence(None, samples, reference_poses, SETTINGS, np.random.default_rng(0))
    assert len(relocalizer.refined_m) == 3 * len(true_m)
    right_m, *wrong_m = np.reshape(relocalizer.refined_m, (-1, 3)).T
    np.testing.assert_array_equal(right_m, true_m)
    assert set(np.concatenate(wrong_m)) <= {1.1, 1.2, 1.3} and np.all(wrong_m[0] != wrong_m[1])
    right, wrong = classes.likelihoods(0.0)
    assert wrong > 0.8 and right < 0.5
    right, wrong = classes.likelihoods(2.3)
    assert wrong < 0.1 < right


def test_recording_in_one_place_says_nothing(recording: RoomRecording, mixture: GaussianMixture) -> None:
    """There is no wrong pose to compare with."""
    likelihood = RayLikelihood(mixture, SETTINGS.likelihood)
    samples = samples_of(recording)[:2]
    poses = POSES[:1]
    assert measure_scan_evidence(likelihood, samples, poses, SETTINGS, np.random.default_rng(0)) == Classes()


@pytest.mark.slow
def test_exact_depth_tells_right_poses_from_wrong_ones(recording: RoomRecording, mixture: GaussianMixture) -> None:
    likelihood = RayLikelihood(mixture, SETTINGS.likelihood)
    samples = samples_of(recording)[::3]
    classes = measure_scan_evidence(likelihood, samples, POSES, SETTINGS, np.random.default_rng(0))
    right, wrong = classes.likelihoods(-np.inf)
    assert wrong > 0.7 and right < 0.3
    right, wrong = classes.likelihoods(np.inf)
    assert right > 3.0 * wrong


def test_sensor_is_measured_where_the_recording_has_depth(recording: RoomRecording, mixture: GaussianMixture) -> None:
    bundle = replace(make_bundle(mixture, recording), reference_poses=ReferencePoses.without_bias(POSES))
    sensor = measure_sensor(bundle, recording, np.random.default_rng(0))
    assert sensor.thresholds is not None and sensor.thresholds.lost < sensor.thresholds.low
    assert 0.0 < sensor.search_precision < 1.0
    right, wrong = sensor.scan.likelihoods(-np.inf)
    assert wrong > right
    without = RoomRecording(Room(), POSES[:2], has_depth=False)
    assert measure_sensor(bundle, without, np.random.default_rng(0)) == SensorModel()


def test_sensor_that_saw_nothing_is_not_measured(
    recording: RoomRecording, mixture: GaussianMixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "depth", lambda index: np.zeros((256, 320), np.float32), raising=False)
    bundle = make_bundle(mixture, RoomRecording(Room(), POSES[:2]))
    assert measure_sensor(bundle, recording, np.random.default_rng(0)) == SensorModel()
