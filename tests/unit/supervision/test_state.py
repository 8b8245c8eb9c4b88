"""The state that a user sees, and its reasons."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from monoloc.relocalization.state_machine import Mode
from monoloc.supervision.map_change import ChangedRegion
from monoloc.supervision.state import Reason, State, Supervision, classify_state


def supervision_of(**given: Any) -> Supervision:
    """Of a frame at which all is well, but for what is given."""
    well: dict[str, Any] = {
        "mode": Mode.TRACKING,
        "probability_far": 0.01,
        "probability_wrong": 0.01,
        "repeated_s": 0.0,
        "image_is_empty": False,
        "odometry_tracked": True,
        "is_near_build": True,
        "camera_mismatch": False,
        "camera_turned": False,
        "camera_confirmed": True,
        "start_confirmed": True,
        "changed_region": None,
    }
    return Supervision(**(well | given))


@pytest.mark.parametrize(
    ("probability_far", "previous", "state"),
    [
        (0.0, "tracking", "tracking"),
        (0.049, "tracking", "tracking"),
        (0.05, "tracking", "uncertain"),
        (0.049, "uncertain", "uncertain"),
        (0.02, "lost", "uncertain"),
        (0.019, "uncertain", "tracking"),
        (0.019, "lost", "tracking"),
        (0.499, "tracking", "uncertain"),
        (0.5, "tracking", "lost"),
        (1.0, "uncertain", "lost"),
    ],
)
def test_state_by_the_probability_of_being_far_off(probability_far: float, previous: State, state: State) -> None:
    """With hysteresis: what was tracked stays so for longer than it takes to be so again."""
    supervision = supervision_of(probability_far=probability_far, probability_wrong=probability_far)
    assert classify_state(supervision, previous)[0] == state


def test_state_does_not_flicker_between_its_bounds() -> None:
    state: State = "tracking"
    seen = []
    for far in (0.03, 0.06, 0.03, 0.045, 0.03, 0.01, 0.03, 0.045):
        state, _ = classify_state(supervision_of(probability_far=far), state)
        seen.append(state)
    assert seen == ["tracking"] + 4 * ["uncertain"] + 3 * ["tracking"]


@pytest.mark.parametrize("mode", [Mode.SEARCHING, Mode.VERIFYING])
def test_camera_that_is_searched_for_or_verified_is_lost(mode: Mode) -> None:
    assert classify_state(supervision_of(mode=mode), "tracking")[0] == "lost"


@pytest.mark.parametrize("doubt", [{"repeated_s": 0.21}, {"camera_mismatch": True}, {"start_confirmed": False}])
def test_doubtful_images_and_intrinsics_are_at_best_uncertain(doubt: dict[str, Any]) -> None:
    assert classify_state(supervision_of(**doubt), "tracking")[0] == "uncertain"
    assert classify_state(supervision_of(probability_far=0.6, **doubt), "tracking")[0] == "lost"


REGION = ChangedRegion(np.zeros(3), np.ones(3))


def test_changed_map_is_said_where_the_pose_is_vouched_for() -> None:
    """With the hysteresis of *tracking*, and for no other reason; doubts about the pose win."""
    said = ("map-changed", frozenset({Reason.MAP_CHANGED}))
    assert classify_state(supervision_of(changed_region=REGION), "lost") == said
    for previous in ("tracking", "map-changed"):
        near_bound = supervision_of(changed_region=REGION, probability_far=0.04, odometry_tracked=False)
        assert classify_state(near_bound, previous) == said
    assert classify_state(supervision_of(probability_far=0.04), "map-changed")[0] == "tracking"
    for far, state in ((0.06, "uncertain"), (0.6, "lost")):
        assert classify_state(supervision_of(changed_region=REGION, probability_far=far), "map-changed")[0] == state
    assert classify_state(supervision_of(changed_region=REGION, camera_mismatch=True), "tracking")[0] == "uncertain"


@pytest.mark.parametrize(
    "harmless",
    [
        {"repeated_s": 0.2},
        {"image_is_empty": True},
        {"odometry_tracked": False},
        {"is_near_build": False},
        {"camera_confirmed": False},
    ],
)
def test_what_the_probability_allows_for_is_tracking_without_reasons(harmless: dict[str, Any]) -> None:
    assert classify_state(supervision_of(**harmless), "tracking") == ("tracking", frozenset())


REASONS: dict[Reason, dict[str, Any]] = {
    Reason.SEARCHING: {"mode": Mode.SEARCHING, "probability_far": 1.0, "probability_wrong": 1.0},
    Reason.VERIFYING: {"mode": Mode.VERIFYING, "probability_far": 1.0, "probability_wrong": 1.0},
    Reason.BELIEF_DOUBTFUL: {"probability_far": 0.3, "probability_wrong": 0.2},
    Reason.POSITION_WIDE: {"probability_far": 0.3, "probability_wrong": 0.1},
    Reason.IMAGE_REPEATED: {"repeated_s": 0.3},
    Reason.CAMERA_MISMATCH: {"camera_mismatch": True},
    Reason.CAMERA_TURNED: {"camera_turned": True},
    Reason.MAP_CHANGED: {"changed_region": REGION},
}
# These come with a width or a doubt, and explain it.
CAUSES: dict[Reason, dict[str, Any]] = {
    Reason.NO_ODOMETRY: {"odometry_tracked": False},
    Reason.IMAGE_EMPTY: {"image_is_empty": True},
    Reason.FAR_FROM_BUILD: {"is_near_build": False},
    Reason.CAMERA_UNCONFIRMED: {"camera_confirmed": False},
}


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_is_given(reason: Reason) -> None:
    if reason in CAUSES:
        given, expected = REASONS[Reason.POSITION_WIDE] | CAUSES[reason], {reason, Reason.POSITION_WIDE}
    else:
        given, expected = REASONS[reason], {reason}
    state, reasons = classify_state(supervision_of(**given), "tracking")
    assert state != "tracking" and reasons == expected


def test_state_that_is_not_tracking_has_a_reason() -> None:
    """Between the two bounds too, where neither doubt alone reaches either."""
    for far in (0.02, 0.021, 0.03, 0.05, 0.5, 1.0):
        for share in (0.0, 0.3, 0.5, 0.7, 1.0):
            supervision = supervision_of(probability_far=far, probability_wrong=share * far)
            state, reasons = classify_state(supervision, "uncertain")
            assert state != "tracking" and reasons, (far, share)
