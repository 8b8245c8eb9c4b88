"""A build measures with networks and maps that were not tuned on the measured frames, and reports the results."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from edit_helpers import bend
from map_helpers import make_mixture
from monoloc.adapt.result import AdaptResult, Score
from monoloc.builder.bias import KnownBiasCheck
from monoloc.builder.build_config import METHODS, BuildConfig
from monoloc.builder.build_report import BuildReport
from monoloc.builder.pipeline import build_bundle
from monoloc.builder.samples import Sample
from monoloc.bundle import Bundle, fingerprint
from monoloc.camera import Camera
from monoloc.depth.spec import DepthModel
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import ADDITIONS, LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.supervision.integrity import Classes, IntegrityModel, SensorModel
from synthetic_room import Room, RoomRecording, depth_from_blue

FRAMES = 16
HELD_OUT = [2, 3, 9]
RESULT = AdaptResult(
    original=make_mixture(8, 0),
    adapted=make_mixture(8, 1),
    depth_model=replace(depth_from_blue(), name="final"),
    hold_out_model=replace(depth_from_blue(), name="hold-out"),
    hold_out_map=make_mixture(8, 2),
    held_out=[np.array(HELD_OUT[2:]), np.array(HELD_OUT[:2])],
    scores=[Score(0, nll=2.0, depth_loss=0.3, absrel=0.2), Score(10, nll=1.0, depth_loss=0.2, absrel=0.1)],
    steps=20,
    kl=0.5,
    transform=bend(),
)
THRESHOLDS = LikelihoodThresholds(low=-1.0, lost=-2.0)
BIAS_MODEL = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.02, sd_growth_m=0.2, sd_growth_rad=0.4)
BIASES = np.random.default_rng(0).normal(0.0, 0.02, (2, FRAMES, 6))
SCAN_CLASSES = Classes(edges=(-1.5,), right=(0.1, 0.9), wrong=(0.8, 0.2))
SENSOR = SensorModel(thresholds=LikelihoodThresholds(low=1.0, lost=0.5), search_precision=0.7)
HELPS = KnownBiasCheck(before_m=0.2, before_rad=0.1, after_m=0.1, after_rad=0.1)
REMARK = "a warning about the frames"

Likelihood = tuple[GaussianMixture, LikelihoodConfig]  # stands for a likelihood: what it was made of


@dataclass
class Measurements:
    """Stands for a build's measurements: stores their arguments and returns fixed results."""

    relocalization: tuple[float, float, float] = (0.1, 0.05, 0.9)
    calibrated: list[tuple[Likelihood, list[Sample]]] = field(default_factory=list)
    relocalized: list[tuple[Likelihood, list[Sample], FloatArray, LocalizerConfig]] = field(default_factory=list)
    evidence: list[tuple[Likelihood, list[Sample], FloatArray, LocalizerConfig]] = field(default_factory=list)
    sensed: list[tuple[Bundle, RoomRecording]] = field(default_factory=list)
    localized: dict[str, Bundle] = field(default_factory=dict)
    regions: list[NDArray[np.int64]] = field(default_factory=list)
    check: KnownBiasCheck | None = HELPS

    def calibrate_likelihood(
        self,
        likelihood_for: Callable[[LikelihoodConfig], Likelihood],
        samples: list[Sample],
        base: LocalizerConfig,
        _: np.random.Generator,
        fits_width: bool,
    ) -> tuple[LocalizerConfig, LikelihoodThresholds]:
        assert fits_width == (base.likelihood.kind == "ray")
        self.calibrated.append((likelihood_for(base.likelihood), samples))
        return base.model_copy(update={"log_scale_sd": 0.123}), THRESHOLDS

    def measure_bias(
        self,
        final: Bundle,
        hold_out: Bundle,
        recording: RoomRecording,
        regions: list[NDArray[np.int64]],
        progress: Any,
    ) -> tuple[BiasModel, ReferencePoses, KnownBiasCheck | None]:
        self.localized = {"final": final, "hold-out": hold_out}
        self.regions = regions
        assert recording.poses is not None
        return BIAS_MODEL, ReferencePoses(recording.poses, *BIASES), self.check

    def measure_relocalization_error(
        self, likelihood: Likelihood, samples: list[Sample], poses: FloatArray, config: LocalizerConfig, *_: Any
    ) -> tuple[float, float, float]:
        self.relocalized.append((likelihood, samples, poses, config))
        return self.relocalization

    def measure_scan_evidence(
        self, likelihood: Likelihood, samples: list[Sample], poses: FloatArray, config: LocalizerConfig, _: Any
    ) -> Classes:
        self.evidence.append((likelihood, samples, poses, config))
        return SCAN_CLASSES

    def measure_sensor(self, bundle: Bundle, recording: RoomRecording, *_: Any) -> SensorModel:
        self.sensed.append((bundle, recording))
        return SENSOR


class _Predictor:
    """Stands for a network that runs: returns in place of depth the model and the image's fingerprint."""

    def __init__(self, model: DepthModel, camera: Camera) -> None:
        self.model = model

    def __call__(self, color: NDArray[np.uint8]) -> Any:
        return self.model, fingerprint(color)


@pytest.fixture
def measurements(monkeypatch: pytest.MonkeyPatch) -> Measurements:
    """A build that adapts to :data:`RESULT` and measures nothing."""
    measurements = Measurements()
    replacements = {
        "DepthPredictor": _Predictor,
        "make_likelihood": lambda mixture, config: (mixture, config),
        "localizer_factory": lambda bundle, seed: bundle,
    } | {
        name: getattr(measurements, name)
        for name in (
            "calibrate_likelihood",
            "measure_bias",
            "measure_relocalization_error",
            "measure_scan_evidence",
            "measure_sensor",
        )
    }
    for name, replacement in replacements.items():
        monkeypatch.setattr(f"monoloc.builder.pipeline.{name}", replacement)
    monkeypatch.setattr("monoloc.builder.mapped_room.check_recording", lambda *_: [])
    monkeypatch.setattr("monoloc.builder.mapped_room.check_frames", lambda *_: [REMARK])
    monkeypatch.setattr("monoloc.adapt.adaptation.adapt", lambda *_: RESULT)
    monkeypatch.setattr(
        "monoloc.depth.training.quantise.quantise", lambda content, _: (b"8 bits of " + content, None)
    )
    return measurements


def build(recording: RoomRecording, **settings: Any) -> tuple[Bundle, BuildReport]:
    config = BuildConfig(components=8, voxel_m=0.1, landmarks=False, **settings)
    return build_bundle(recording, config, 0, NoProgress(), Room().cloud(0.1), "tiny-0.35")


@pytest.mark.parametrize(
    ("check", "is_used"),
    [
        (HELPS, True),
        (replace(HELPS, after_rad=0.2), False),
        (None, False),
    ],
)
def test_known_bias_is_used_where_it_was_measured_to_help(
    recording: RoomRecording, measurements: Measurements, check: KnownBiasCheck | None, is_used: bool
) -> None:
    measurements.check = check
    bundle, report = build(recording)
    assert (bundle.settings.without == ()) == is_used == report.known_bias_used
    assert report.known_bias_check == check


def test_papers_method_flies_as_it_was_tuned(recording: RoomRecording, measurements: Measurements) -> None:
    """Its bias is not measured, and the filter's likelihood is that of tuning."""
    paper = METHODS["paper"]
    bundle, _ = build(recording, adapt=paper.adapt, localizer=paper.localizer)
    likelihood, adapt = bundle.settings.likelihood, paper.adapt
    assert (likelihood.kind, likelihood.noise_sd_m) == ("volume", adapt.noise_sd_m)
    assert likelihood.outlier_share == adapt.outlier_share
    assert measurements.localized == {} and not bundle.reference_poses.forward_bias.any()
    assert {*bundle.settings.without} == {*ADDITIONS}


@pytest.mark.parametrize("int8", [False, True])
def test_held_out_frames_are_measured_with_the_hold_out_run(
    recording: RoomRecording, measurements: Measurements, int8: bool
) -> None:
    bundle, _ = build(recording, int8=int8)
    final, hold_out = RESULT.depth_model, RESULT.hold_out_model
    if int8:
        final, hold_out = (
            replace(model, content=b"8 bits of " + model.content, name=f"{model.name} in 8 bits")
            for model in (final, hold_out)
        )
    assert recording.poses is not None
    (((mixture, _), samples),) = measurements.calibrated
    assert mixture is RESULT.hold_out_map
    assert [sample.index for sample in samples] == HELD_OUT
    for sample in samples:
        assert sample.depth == (hold_out, fingerprint(recording.color(sample.index)))
        np.testing.assert_array_equal(sample.pose, recording.poses[sample.index])
    (((mixture, _), relocalized, poses, settings),) = measurements.relocalized
    assert mixture is RESULT.hold_out_map and relocalized is samples and settings.log_scale_sd == 0.123
    np.testing.assert_array_equal(poses, recording.poses)
    (((mixture, _), *evidence),) = measurements.evidence
    assert mixture is RESULT.hold_out_map and evidence[0] is samples and evidence[1] is poses
    ((sensed, sensed_recording),) = measurements.sensed
    assert sensed.adapted is RESULT.adapted and sensed_recording.frame_names == recording.frame_names
    assert measurements.regions is RESULT.held_out
    for name, model, mixture in (("final", final, RESULT.adapted), ("hold-out", hold_out, RESULT.hold_out_map)):
        localized = measurements.localized[name]
        assert localized.depth_model == model and localized.adapted is mixture
        assert localized.settings.log_scale_sd == 0.123 and localized.thresholds == THRESHOLDS
    assert bundle.depth_model == final and bundle.adapted is RESULT.adapted and bundle.original is RESULT.original
    np.testing.assert_array_equal(bundle.reference_poses.poses, recording.poses)
    known = bundle.reference_poses
    np.testing.assert_array_equal([known.forward_bias, known.backward_bias], BIASES)


@pytest.mark.parametrize("roll_rad", [0.0, 0.5 * np.pi])
def test_images_on_their_side_tell_no_gravity(
    recording: RoomRecording, measurements: Measurements, roll_rad: float
) -> None:
    """Of a camera that turned by 180 degrees in the room; upright, its mean y axis points down."""
    turned = copy(recording)
    yaws = np.outer(np.linspace(0.0, np.pi, len(recording)), [0.0, 1.0, 0.0])
    turned.poses = make_pose(so3_exp(yaws) @ so3_exp([0.0, 0.0, roll_rad]), np.zeros((len(recording), 3)))
    bundle, _ = build(turned)
    assert bundle.provenance.down_world == pytest.approx((0.0, 0.0 if roll_rad else 1.0, 0.0))
    assert not bundle.provenance.knows_down


@pytest.mark.parametrize(
    ("relocalization", "warnings"),
    [
        ((0.97, 0.1, 0.2), ["a search by one scan is right 20% of the time, too rarely: flights need a start"]),
        ((0.1, 0.6, 0.25), []),
    ],
)
def test_bundle_and_report_hold_the_measurements_and_warn_of_poor_relocalization(
    recording: RoomRecording,
    measurements: Measurements,
    relocalization: tuple[float, float, float],
    warnings: list[str],
) -> None:
    measurements.relocalization = relocalization
    bundle, report = build(recording)
    sd_m, sd_rad, precision = relocalization
    assert bundle.settings.particle_bias == BIAS_MODEL.model_copy(
        update={"relocalization_sd_m": sd_m, "relocalization_sd_rad": sd_rad}
    )
    assert bundle.settings.log_scale_sd == 0.123 and bundle.thresholds == THRESHOLDS
    assert bundle.integrity == IntegrityModel(scan=SCAN_CLASSES, scan_search_precision=precision)
    assert bundle.sensor == SENSOR
    assert bundle.transform is RESULT.transform and bundle.edits == ()
    assert bundle.cloud is not None and bundle.cloud.points == report.cloud_points
    levels = [np.median(cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2GRAY)) for index in range(len(recording))]
    assert bundle.provenance.brightness == pytest.approx((np.mean(levels), np.std(levels)), abs=1.0)
    assert bundle.supports_relocalization == (not warnings)
    no_gravity = "floor and walls do not show the direction of gravity: poses for an autopilot need down = "
    assert bundle.down is None and report.warnings[1].startswith(no_gravity)
    assert [report.warnings[0], *report.warnings[2:]] == [REMARK, *warnings]
    figures = (report.nll_start, report.nll_end, report.depth_absrel_before, report.depth_absrel_after)
    assert figures == (2.0, 1.0, 0.2, 0.1)
    assert (report.kl, report.steps, report.components, report.frames) == (0.5, 20, 8, FRAMES)
