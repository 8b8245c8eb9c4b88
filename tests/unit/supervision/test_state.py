"""The state that a user sees."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.particle_filter.estimate import Estimate
from monoloc.relocalization.state_machine import Mode
from monoloc.supervision.state import classify_state

THRESHOLDS = LikelihoodThresholds(low=-2.0, lost=-3.0)


def state_of(
    value: float,
    mode: Mode = Mode.TRACKING,
    position_sd_m: float = 0.05,
    odometry_tracked: bool = True,
    landmarks_used: bool = False,
) -> str:
    belief = Estimate(np.eye(4), np.diag(np.repeat([position_sd_m**2, 1e-4], 3)), 0.0)
    return classify_state(belief, mode, value, THRESHOLDS, odometry_tracked, landmarks_used)


@pytest.mark.parametrize(
    ("value", "state"),
    [
        (-1.0, "tracking"),
        (-2.0, "tracking"),  # a value at a threshold is not below it
        (-2.5, "uncertain"),
        (-3.0, "uncertain"),
        (-3.5, "lost"),
        (np.nan, "uncertain"),
    ],
)
def test_state_by_the_scans_likelihood(value: float, state: str) -> None:
    assert state_of(value) == state


@pytest.mark.parametrize("value", [-1.0, -3.5, np.nan])
@pytest.mark.parametrize("landmarks_used", [False, True])
def test_camera_of_unknown_position_is_lost(value: float, landmarks_used: bool) -> None:
    assert state_of(value, position_sd_m=3.0, landmarks_used=landmarks_used) == "lost"


@pytest.mark.parametrize("value", [-1.0, -3.5, np.nan])
@pytest.mark.parametrize("mode", [Mode.SEARCHING, Mode.VERIFYING])
def test_camera_that_is_searched_for_or_verified_is_lost(value: float, mode: Mode) -> None:
    assert state_of(value, mode) == "lost"


@pytest.mark.parametrize(("value", "state"), [(-1.0, "uncertain"), (-2.5, "uncertain"), (-3.5, "lost")])
def test_camera_that_odometry_did_not_follow_is_at_best_uncertain(value: float, state: str) -> None:
    assert state_of(value, odometry_tracked=False) == state


@pytest.mark.parametrize(
    ("value", "state"), [(-1.0, "tracking"), (-2.5, "uncertain"), (-3.5, "uncertain"), (np.nan, "uncertain")]
)
def test_scan_that_does_not_fit_is_uncertain_where_landmarks_are_used(value: float, state: str) -> None:
    assert state_of(value, landmarks_used=True) == state
