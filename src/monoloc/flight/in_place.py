"""Where in a place of several rooms a flight is, for its outputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from monoloc.bundle import Bundle
from monoloc.particle_filter.estimate import Estimate
from monoloc.step import Step


@dataclass(frozen=True)
class InPlace:
    """Where in a place a frame was localised.

    Attributes:
        room: in whose world the step's poses are; None while the place is searched for the camera.
        entered: bundle of the room, at its first frame; None at all others.
        estimate: the belief in the world of the place's first room, by way of the doors between; its covariance has
            grown by theirs. Says nothing without a room.
        tells_obstacles: whether the room's depth may be taken for obstacles.
        unreadable: why rooms could not be read when they were needed last, by name: they are not entered.
    """

    room: str | None
    entered: Bundle | None
    estimate: Estimate
    tells_obstacles: bool
    unreadable: Mapping[str, str] = field(default_factory=dict)

    @property
    def problems(self) -> list[str]:
        """What keeps rooms from being entered, in words."""
        return [f"room {room} cannot be entered: {why}" for room, why in self.unreadable.items()]

    def in_first_room(self, step: Step) -> Step:
        """The frame's step with its pose in the world of the place's first room, and without depth where that tells
        no obstacles.
        """
        return replace(step, estimate=self.estimate, depth=step.depth if self.tells_obstacles else None)


@dataclass(frozen=True)
class Switch:
    """A frame at which the belief entered a room.

    Attributes:
        frame, time_s: its number among the localised ones, and seconds since the first of them.
        before, after: rooms; ``before`` is None where the camera was searched for.
    """

    frame: int
    time_s: float
    before: str | None
    after: str
