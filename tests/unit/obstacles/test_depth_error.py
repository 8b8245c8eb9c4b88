"""The stated error of distances follows from what the build measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.bundle import Bundle
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import make_pose, so3_exp
from monoloc.obstacles import DepthError
from synthetic_room import room_bundle


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return room_bundle(40)


def test_parts_add_up_and_only_a_tuned_network_is_measured(bundle: Bundle) -> None:
    likelihood = bundle.settings.likelihood.model_copy(update={"log_depth_sd": 0.06})
    settings = bundle.settings.model_copy(update={"likelihood": likelihood, "log_scale_sd": 0.08})
    untuned = DepthError.of(replace(bundle, settings=settings))
    assert untuned == DepthError(pytest.approx(0.1), 0.0, is_measured=False, nearest_m=0.0)
    provenance = bundle.provenance.model_copy(update={"tune": "all", "scale_sd": 0.24})
    tuned = DepthError.of(replace(bundle, settings=settings, provenance=provenance))
    assert tuned == DepthError(pytest.approx(0.26), 0.0, is_measured=True)


def test_depth_with_an_error_in_metres_has_one(bundle: Bundle) -> None:
    likelihood = bundle.settings.likelihood.model_copy(update={"kind": "volume", "noise_sd_m": 0.05})
    settings = bundle.settings.model_copy(update={"likelihood": likelihood, "log_scale_sd": 0.0})
    np.testing.assert_allclose(DepthError.of(replace(bundle, settings=settings)).sd_m(np.array([0.0, 4.0])), 0.05)


def test_nearest_depth_is_what_the_builds_cameras_saw(bundle: Bundle) -> None:
    """Two metres before the wall of a room without boxes in view."""
    before_wall = make_pose(so3_exp([0.0, np.pi, 0.0]), [0.0, -0.3, 0.5])  # looks along -z, at the wall at z = -2
    known = replace(bundle, reference_poses=ReferencePoses.without_bias(np.stack([before_wall] * 3)))
    assert 1.0 < DepthError.of(known).nearest_m < 2.6
    assert DepthError.of(bundle).nearest_m == 0.0  # it keeps no reference poses


@pytest.mark.filterwarnings("error")
def test_nothing_has_no_error_and_the_free_an_infinite_one() -> None:
    sd_m = DepthError(0.1, 0.02, True).sd_m(np.array([1.0, np.nan, np.inf]))
    assert sd_m[0] == pytest.approx(np.hypot(0.1, 0.02)) and np.isnan(sd_m[1]) and sd_m[2] == np.inf
