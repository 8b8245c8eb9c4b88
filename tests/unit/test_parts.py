"""Parts of the localizer that are left out: what a flight is then made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from map_helpers import make_mixture
from monoloc.bundle import Bundle
from monoloc.errors import SettingError
from monoloc.fusion.bias_model import BiasModel, LandmarkBiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.localizer_config import PARTS, Part
from monoloc.parts import leave_out, parse_parts
from synthetic_room import RoomRecording, make_bundle

FRAMES = 4


def _with(recording: RoomRecording, **settings: Any) -> Bundle:
    bundle = make_bundle(make_mixture(8), recording, range(4))
    return replace(bundle, settings=bundle.settings.model_copy(update=settings))


def test_nothing_changes_where_nothing_is_left_out(recording: RoomRecording) -> None:
    bundle = make_bundle(make_mixture(8), recording, range(4))
    assert leave_out(bundle) is bundle


def test_all_parts_are_left_out(recording: RoomRecording) -> None:
    config = leave_out(_with(recording, without=PARTS)).settings
    assert (config.motion, config.log_scale_sd, config.scale_tilt) == ("random-walk", 0.0, None)
    assert (config.particle_bias, config.landmark_bias) == (BiasModel(), LandmarkBiasModel())


@pytest.mark.parametrize("part", ["known-bias", "bias"])
def test_bias_that_is_not_subtracted_is_part_of_the_unknown_one(recording: RoomRecording, part: Part) -> None:
    poses = recording.poses[:4]
    known = ReferencePoses(poses, *np.full((2, 4, 6), 0.04))
    model = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.03, sd_growth_m=0.2)
    bundle = replace(_with(recording, without=(part,), particle_bias=model), reference_poses=known)
    reduced = leave_out(bundle)
    config = reduced.settings
    assert not reduced.reference_poses.forward_bias.any() and len(reduced.reference_poses) == 4
    if part == "known-bias":
        assert config.particle_bias.sd_at_reference_m == pytest.approx(0.05)
        assert config.particle_bias.sd_growth_m == 0.2
    else:
        assert config.particle_bias == BiasModel()


def test_names_are_read_and_an_unknown_one_is_named() -> None:
    assert parse_parts("landmarks, odometry,landmarks") == ("landmarks", "odometry")
    with pytest.raises(SettingError, match="--without: has 'landmark'; choose from landmarks, scan, odometry"):
        parse_parts("bias,landmark")
