"""Bias of localizers in a room whose depth is wrong in one region."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.builder import trajectories
from monoloc.builder.bias import measure_bias
from monoloc.bundle import fingerprint
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.geometry import FloatArray
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer import Localizer
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.particles import scatter
from monoloc.progress import NoProgress
from synthetic_room import (
    CAMERA,
    SETTINGS,
    Room,
    RoomRecording,
    depth_from_blue,
    make_localizer,
    make_path,
)


class _TiltedDepth:
    """The room's depth, tilted in some frames; notes which frames it is asked for."""

    def __init__(self, recording: RoomRecording, tilted: set[int]) -> None:
        self._index = {fingerprint(recording.color(index)): index for index in range(len(recording))}
        self._tilted = tilted
        self._exact = DepthPredictor(depth_from_blue(), CAMERA)
        self.frames: list[int] = []

    def __call__(self, color: NDArray[np.uint8]) -> DepthPrediction:
        index = self._index[fingerprint(color)]
        self.frames.append(index)
        depth = self._exact(color)
        if index not in self._tilted:
            return depth
        x = depth.camera.pixel_rays()[..., 0].astype(np.float32)
        return DepthPrediction(depth.depth_m * np.exp(0.25 * x), depth.camera)


def localizer_at(
    mixture: GaussianMixture, reference_poses: FloatArray, depth: _TiltedDepth, pose: FloatArray
) -> Localizer:
    config = SETTINGS.model_copy(update={"particles": 300})
    particles = scatter(pose, config.particles, 0.02, 0.01, config.log_scale_sd, np.random.default_rng(0))
    never_lost = LikelihoodThresholds(low=-9.0, lost=-99.0)
    return make_localizer(mixture, never_lost, particles, reference_poses, 0, config, depth)


@pytest.fixture
def _short_trajectories(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectories, "_WARM_UP_FRAMES", 12)
    monkeypatch.setattr(trajectories, "LONG_FRAMES", 12)


@pytest.mark.slow
@pytest.mark.usefixtures("_short_trajectories")
def test_growth_is_measured_hovering_where_depth_is_wrong(mixture: GaussianMixture) -> None:
    """A pass through the four frames would show only a part of the error that their depth leads to."""
    recording, region = RoomRecording(Room(), make_path(18)), np.arange(10, 14)
    final, hold_out = _TiltedDepth(recording, set()), _TiltedDepth(recording, {*region.tolist()})
    make_final, make_hold_out = (partial(localizer_at, mixture, recording.poses, each) for each in (final, hold_out))
    model, *_ = measure_bias(make_final, make_hold_out, recording, [region], NoProgress())
    in_order = list(range(18))
    assert final.frames == [*in_order[:12][::-1], *in_order, *in_order[::-1]]
    along_reference = len(final.frames)  # as the final one, then in order, then in the region
    assert hold_out.frames[:along_reference] == final.frames
    assert hold_out.frames[along_reference : along_reference + 18] == in_order
    hovered = hold_out.frames[along_reference + 18 :]
    assert hovered[:10] == [10, 11, 12, 13, 12, 11, 10, 11, 12, 13] and len(hovered) >= 4 + 12
    assert model.sd_at_reference_m < 0.03
    # A quarter of the depth across a metre of it rotates a wall by some 14 degrees.
    assert model.sd_growth_rad > 0.1


@pytest.mark.slow
@pytest.mark.usefixtures("_short_trajectories")
def test_segments_are_followed_one_by_one(mixture: GaussianMixture) -> None:
    """Over a pause no camera can be followed."""
    poses = np.concatenate([make_path(12), make_path(12, start_s=5.0)])
    recording = RoomRecording(Room(), poses)
    recording.timestamps_s = recording.timestamps_s + 20.0 * (np.arange(24) >= 12)
    final, hold_out = _TiltedDepth(recording, set()), _TiltedDepth(recording, set())
    started_at: list[FloatArray] = []

    def make_final(pose: FloatArray) -> Localizer:
        started_at.append(pose)
        return localizer_at(mixture, poses, final, pose)

    # Two passes through one region: the localizer hovers in one, then in the other.
    region = np.array([4, 5, 16, 17])
    make_hold_out = partial(localizer_at, mixture, poses, hold_out)
    model, *_ = measure_bias(make_final, make_hold_out, recording, [region], NoProgress())
    np.testing.assert_array_equal(started_at, poses[[11, 23]])  # the warm-up goes backward first
    assert model.sd_at_reference_m < 0.03 and model.sd_at_reference_rad < 0.02
    hovered = hold_out.frames[len(final.frames) + 24 :]
    assert hovered[:4] == [4, 5, 4, 5] and hold_out.frames[-2:] == [16, 17]
