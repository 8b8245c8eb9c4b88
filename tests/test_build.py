"""A build measures with what the held-out frames did not tune, and the bundle and the report say what it measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from map_helpers import make_mixture
from monoloc.adapt.adaptation import AdaptResult
from monoloc.adapt.settings import AdaptConfig
from monoloc.adapt.tuning import Score
from monoloc.builder.build_config import BuildConfig, BuildReport
from monoloc.builder.calibrate import Sample
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import Bundle, fingerprint
from monoloc.camera import Camera
from monoloc.depth.spec import DepthModel
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray
from monoloc.localizer import LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.start import Start
from monoloc.supervision.state import LikelihoodThresholds
from synthetic_room import Room, RoomRecording, depth_from_blue

FRAMES = 16
HELD_OUT = [2, 3, 9]
RESULT = AdaptResult(
    original=make_mixture(8, 0),
    adapted=make_mixture(8, 1),
    depth_model=replace(depth_from_blue(), name="tuned on all"),
    held_out_model=replace(depth_from_blue(), name="rehearsed"),
    held_out_map=make_mixture(8, 2),
    held_out=[np.array(HELD_OUT[2:]), np.array(HELD_OUT[:2])],
    scores=[Score(0, nll=2.0, depth_loss=0.3, absrel=0.2), Score(10, nll=1.0, depth_loss=0.2, absrel=0.1)],
    steps=20,
    kl=0.5,
)
HEALTHY = LikelihoodThresholds(low=-1.0, lost=-2.0)
LASTING = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.02, sd_growth_m=0.2, sd_growth_rad=0.4)
ERRORS = np.random.default_rng(0).normal(0.0, 0.02, (2, FRAMES, 6))
REMARK = "what was said of the frames"


@dataclass
class Measured:
    """What a build's measurements were given, and what the last of them say."""

    found_sd: tuple[float, float] = (0.1, 0.05)
    calibrated: list[tuple[GaussianMixture, list[Sample]]] = field(default_factory=list)
    found: list[tuple[GaussianMixture, list[Sample], FloatArray, LocalizerConfig]] = field(default_factory=list)
    regions: list[NDArray[np.int64]] = field(default_factory=list)
    is_tuned: bool = False
    started: list[tuple[Bundle, Start]] = field(default_factory=list)

    def calibrate(
        self, mixture: GaussianMixture, samples: list[Sample], base: LocalizerConfig, _: np.random.Generator
    ) -> tuple[LocalizerConfig, LikelihoodThresholds]:
        self.calibrated.append((mixture, samples))
        return base.model_copy(update={"log_scale_sd": 0.123}), HEALTHY

    def measure_bias(
        self,
        starts_at: Callable,
        rehearsed_at: Callable,
        recording: RoomRecording,
        regions: list,
        tuned: bool,
        _: Any,
    ) -> tuple[BiasModel, ReferencePoses]:
        self.regions, self.is_tuned = regions, tuned
        starts_at(recording.poses[0])
        rehearsed_at(recording.poses[1])
        return LASTING, ReferencePoses(recording.poses, *ERRORS)

    def measure_relocalization_error(
        self, mixture: GaussianMixture, samples: list, viewpoints: FloatArray, config: LocalizerConfig, *_: Any
    ) -> tuple[float, float]:
        self.found.append((mixture, samples, viewpoints, config))
        return self.found_sd

    def start_localizer(self, bundle: Bundle, camera: Camera, start: Start, _: np.random.Generator) -> None:
        self.started.append((bundle, start))


class _Predictor:
    """Stands for a network that runs: says in place of depth which it is and what it was shown."""

    def __init__(self, model: DepthModel, camera: Camera) -> None:
        self.model = model

    def __call__(self, color: NDArray[np.uint8]) -> Any:
        return self.model, fingerprint(color)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> Measured:
    """A build that adapts to :data:`RESULT` and measures nothing."""
    measured = Measured()
    monkeypatch.setattr("monoloc.adapt.adaptation.adapt", lambda *_: RESULT)
    monkeypatch.setattr("monoloc.builder.pipeline.check_frames", lambda *_: [REMARK])
    monkeypatch.setattr("monoloc.builder.pipeline.DepthPredictor", _Predictor)
    for name in ("calibrate", "measure_bias", "measure_relocalization_error", "start_localizer"):
        monkeypatch.setattr(f"monoloc.builder.pipeline.{name}", getattr(measured, name))
    monkeypatch.setattr(
        "monoloc.depth.training.quantise.quantise", lambda content, _: (b"8 bits of " + content, None)
    )
    return measured


def build(recording: RoomRecording, **settings: Any) -> tuple[Bundle, BuildReport]:
    config = BuildConfig(components=8, voxel_m=0.1, **settings)
    return build_bundle(recording, config, 0, NoProgress(), Room().cloud(0.1), "tiny-0.35")


@pytest.mark.parametrize(("tune", "steps"), [("all", 20), ("last", 20), ("last", 0), ("none", 20)])
def test_what_poses_err_by_is_known_of_a_network_that_learned_of_the_frames(
    recording: RoomRecording, measured: Measured, monkeypatch: pytest.MonkeyPatch, tune: str, steps: int
) -> None:
    monkeypatch.setattr("monoloc.adapt.adaptation.adapt", lambda *_: replace(RESULT, steps=steps))
    build(recording, adapt=AdaptConfig(tune=tune))
    assert measured.is_tuned == (tune != "none" and steps > 0)


@pytest.mark.parametrize("int8", [False, True])
def test_what_tuned_on_a_frame_is_not_judged_by_it(recording: RoomRecording, measured: Measured, int8: bool) -> None:
    bundle, _ = build(recording, int8=int8)
    final, rehearsed = RESULT.depth_model, RESULT.held_out_model
    if int8:
        final, rehearsed = (
            replace(model, content=b"8 bits of " + model.content, name=f"{model.name} in 8 bits")
            for model in (final, rehearsed)
        )
    ((mixture, samples),) = measured.calibrated
    assert mixture is RESULT.held_out_map
    assert [sample.index for sample in samples] == HELD_OUT
    for sample in samples:
        assert sample.depth == (rehearsed, fingerprint(recording.color(sample.index)))
        np.testing.assert_array_equal(sample.pose, recording.poses[sample.index])
    ((mixture, searched_in, viewpoints, settings),) = measured.found
    assert mixture is RESULT.held_out_map and searched_in is samples and settings.log_scale_sd == 0.123
    np.testing.assert_array_equal(viewpoints, recording.poses)
    assert measured.regions is RESULT.held_out
    expected = ((final, RESULT.adapted), (rehearsed, RESULT.held_out_map))
    for index, ((started, start), (model, room)) in enumerate(zip(measured.started, expected, strict=True)):
        assert started.depth_model == model and started.adapted is room
        assert len(started.viewpoints) == 0  # it is not looked for: how far it goes astray is to be seen
        assert started.settings.log_scale_sd == 0.123 and started.healthy == HEALTHY
        np.testing.assert_array_equal(start.pose, recording.poses[index])
    assert bundle.depth_model == final and bundle.adapted is RESULT.adapted and bundle.original is RESULT.original
    np.testing.assert_array_equal(bundle.viewpoints.poses, recording.poses)
    np.testing.assert_array_equal([bundle.viewpoints.there, bundle.viewpoints.back], ERRORS)


@pytest.mark.parametrize(
    ("found_sd", "doubts"),
    [((0.97, 0.1), ["one image tells where a camera is to 1.0 m only: flights need a start"]), ((0.1, 0.6), [])],
)
def test_what_was_measured_is_in_the_bundle_and_a_weak_search_is_warned_of(
    recording: RoomRecording, measured: Measured, found_sd: tuple[float, float], doubts: list[str]
) -> None:
    measured.found_sd = found_sd
    bundle, report = build(recording)
    stated = {"relocalization_sd_m": found_sd[0], "relocalization_sd_rad": found_sd[1]}
    assert bundle.settings.lasting == LASTING.model_copy(update=stated)
    assert bundle.settings.log_scale_sd == 0.123 and bundle.healthy == HEALTHY
    assert bundle.settings.supports_relocalization == (not doubts)
    assert report.warnings == [REMARK, *doubts]
    figures = (report.nll_start, report.nll_end, report.depth_absrel_before, report.depth_absrel_after)
    assert figures == (2.0, 1.0, 0.2, 0.1)
    assert (report.kl, report.steps, report.components, report.frames) == (0.5, 20, 8, FRAMES)
