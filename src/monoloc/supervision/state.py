"""The state of the localizer that a user sees, and its reasons."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum
from typing import Literal

from monoloc.relocalization.state_machine import Mode
from monoloc.supervision.map_change import ChangedRegion

State = Literal["tracking", "uncertain", "lost", "map-changed"]

VOUCHED_FOR: frozenset[State] = frozenset({"tracking", "map-changed"})
"""States whose pose may be used: an error that its covariance does not allow for is silent."""

MOST_REPEATED_S = 0.2
"""For which an image may repeat: streams show a frame twice."""

# Probabilities that the position is more than 30 cm off. It is vouched for below the first; once it is not, below
# the second, so that the state does not flicker; and it is *lost* above the third.
_TRACKING_BELOW, _TRACKING_AGAIN_BELOW, _LOST_ABOVE = 0.05, 0.02, 0.5


class Reason(Enum):
    """Why the state is not *tracking*; first what a pilot must know first."""

    CAMERA_MISMATCH = "camera mismatch"
    """Landmarks fit another lens than the stated one: another focal length, or an image stretched along one axis."""
    CAMERA_TURNED = "camera turned"
    """The camera lies on its side or upside down, and depth is predicted by a network that has not learnt that."""
    IMAGE_EMPTY = "image empty"
    """The image has no contrast: dark, covered or saturated."""
    IMAGE_REPEATED = "image repeated"
    """The camera gives the same image again and again, or one that shows nothing of a turn that was measured."""
    NO_ODOMETRY = "no odometry"
    """Odometry did not follow the camera."""
    BELIEF_DOUBTFUL = "belief doubtful"
    """Scans or landmarks speak against the belief, or nothing has confirmed it yet, or for too long."""
    POSITION_WIDE = "position wide"
    """The covariance allows for more than 30 cm."""
    FAR_FROM_BUILD = "far from the build"
    """The camera is believed to be away from the frames that the map was built from."""
    CAMERA_UNCONFIRMED = "camera unconfirmed"
    """The stated focal length is not that of the build's camera, and landmarks have not confirmed it: the covariance
    allows for an error of it."""
    MAP_CHANGED = "map changed"
    """Landmarks are missing in one region in view, while those of the rest of the view are found."""
    SEARCHING = "searching"
    """The pose is unknown, and the room is searched for the camera."""
    VERIFYING = "verifying"
    """A search found a place, and it is verified."""


def in_words(reasons: Collection[Reason]) -> str:
    """Reasons for a person, the most urgent first: a pilot's screen cuts off what is last."""
    return ", ".join(reason.value for reason in Reason if reason in reasons)


BLIND = frozenset({Reason.IMAGE_REPEATED, Reason.IMAGE_EMPTY})
"""Reasons with which the frame's image says nothing: the pose rests on earlier ones.

A frame that is vouched for has none, and so neither has an empty image in the first 0.2 s."""


@dataclass(frozen=True)
class Supervision:
    """What is known of the belief after a frame.

    Attributes:
        mode: of the relocalisation.
        probability_far: that the position is more than 30 cm off.
        probability_wrong: that the belief is wrong, whatever its covariance.
        repeated_s: for how long the image has not changed.
        image_is_empty: whether the image has no contrast.
        odometry_tracked: whether odometry, if there is any, followed the camera.
        is_near_build: whether the believed pose is near the frames that the map was built from.
        camera_mismatch: whether landmarks fit another lens, see :attr:`Reason.CAMERA_MISMATCH`.
        camera_turned: whether depth is predicted from an image that lies on its side, or upside down.
        camera_confirmed: whether the focal length is the build's, or landmarks have confirmed it.
        start_confirmed: whether scans or landmarks have confirmed the belief since the start.
        changed_region: in view, in which the map no longer holds; None where there is none.
    """

    mode: Mode
    probability_far: float
    probability_wrong: float
    repeated_s: float
    image_is_empty: bool
    odometry_tracked: bool
    is_near_build: bool
    camera_mismatch: bool
    camera_turned: bool
    camera_confirmed: bool
    start_confirmed: bool
    changed_region: ChangedRegion | None


def classify_state(supervision: Supervision, previous: State) -> tuple[State, frozenset[Reason]]:
    """The state after a frame, and why it is not *tracking*.

    Args:
        previous: the state after the previous frame.
    """
    state = _state(supervision, previous)
    if state == "map-changed":
        return state, frozenset({Reason.MAP_CHANGED})
    return state, frozenset() if state == "tracking" else _reasons(supervision)


def _state(supervision: Supervision, previous: State) -> State:
    far = supervision.probability_far
    if supervision.mode is not Mode.TRACKING or far >= _LOST_ABOVE:
        return "lost"
    bound = _TRACKING_BELOW if previous in VOUCHED_FOR else _TRACKING_AGAIN_BELOW
    doubtful = supervision.camera_mismatch or supervision.camera_turned or not supervision.start_confirmed
    if doubtful or supervision.repeated_s > MOST_REPEATED_S or far >= bound:
        return "uncertain"
    return "tracking" if supervision.changed_region is None else "map-changed"


def _reasons(supervision: Supervision) -> frozenset[Reason]:
    wrong = supervision.probability_wrong
    wide = supervision.probability_far - wrong
    is_far = supervision.mode is Mode.TRACKING and supervision.probability_far >= _TRACKING_AGAIN_BELOW
    holds = {
        Reason.SEARCHING: supervision.mode is Mode.SEARCHING,
        Reason.VERIFYING: supervision.mode is Mode.VERIFYING,
        Reason.BELIEF_DOUBTFUL: not supervision.start_confirmed or (is_far and wrong >= wide),
        Reason.POSITION_WIDE: is_far and wide > wrong,
        Reason.NO_ODOMETRY: not supervision.odometry_tracked,
        Reason.FAR_FROM_BUILD: supervision.mode is Mode.TRACKING and not supervision.is_near_build,
        Reason.IMAGE_REPEATED: supervision.repeated_s > MOST_REPEATED_S,
        Reason.IMAGE_EMPTY: supervision.image_is_empty,
        Reason.CAMERA_MISMATCH: supervision.camera_mismatch,
        Reason.CAMERA_TURNED: supervision.camera_turned,
        Reason.CAMERA_UNCONFIRMED: not supervision.camera_confirmed,
        Reason.MAP_CHANGED: supervision.changed_region is not None,
    }
    return frozenset(reason for reason, is_so in holds.items() if is_so)
