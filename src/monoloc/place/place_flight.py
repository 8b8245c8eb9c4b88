"""A localizer of a place, as a flight in a single room takes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import SettingError
from monoloc.flight.in_place import InPlace
from monoloc.geometry import FloatArray
from monoloc.likelihood.scan import EMPTY_SCAN
from monoloc.obstacles import tells_obstacles
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles
from monoloc.place.hand_over import carried
from monoloc.place.place_files import Place
from monoloc.place.place_localizer import PlaceLocalizer
from monoloc.place.place_manifest import Door
from monoloc.relocalization.state_machine import Mode
from monoloc.start import Start
from monoloc.step import Step
from monoloc.step_budget import Level
from monoloc.supervision.state import Reason

_UNKNOWN = Estimate(np.eye(4), np.eye(6), 0.0)  # before the first room; says nothing
_SEARCHING = Step(
    estimate=_UNKNOWN,
    state="lost",
    reasons=frozenset({Reason.SEARCHING}),
    probability_far=1.0,
    restarted=False,
    particle_estimate=_UNKNOWN,
    mean_log_likelihood=float("nan"),
    landmark_pose=None,
    mode=Mode.SEARCHING,
    motion=None,
    depth=None,
    scan=EMPTY_SCAN,
    changed_region=None,
)


class PlaceFlight:
    """A :class:`~monoloc.flight.flight_loop.FlightLocalizer` for a place.

    While the place is searched for the camera, the step is *lost*, and has the pose of the last room, which says
    nothing.

    Args:
        localizer: that has taken no frame yet.
        place: that it localises in; doors join all of its rooms to the first.
    """

    def __init__(self, localizer: PlaceLocalizer, place: Place) -> None:
        self._localizer, self._place = localizer, place
        self._way: list[tuple[str, Door]] = []  # from the room that was entered last to the first
        self._searching, self._tells_obstacles = _SEARCHING, False
        self._in_place = InPlace(None, None, _UNKNOWN, False)

    def step(
        self,
        color: NDArray[np.uint8],
        elapsed_s: float,
        *,
        down: FloatArray | None = None,
        measured_motion: Motion | None = None,
        level: Level | None = None,
    ) -> Step:
        """Take in one frame; raises as :meth:`monoloc.place.place_localizer.PlaceLocalizer.step`."""
        found = self._localizer.step(color, elapsed_s, down=down, measured_motion=measured_motion, level=level)
        bundle = self._localizer.bundle
        if found.step is None or found.room is None or bundle is None:
            self._in_place = InPlace(None, None, self._in_place.estimate, False, self._localizer.unreadable)
            return replace(self._searching, level=found.level)
        if found.entered:
            way = self._place.way(found.room, self._place.names[0])
            assert way is not None  # doors join all rooms
            self._way, self._tells_obstacles = way, tells_obstacles(bundle)
        estimate = found.step.estimate
        for room, door in self._way:
            estimate = carried(estimate, door, room)
        entered = bundle if found.entered else None
        unreadable = self._localizer.unreadable
        self._in_place = InPlace(found.room, entered, estimate, self._tells_obstacles, unreadable)
        self._searching = replace(_SEARCHING, estimate=found.step.estimate, particle_estimate=found.step.estimate)
        return found.step

    def reset(self, start: Start | None) -> None:
        """Raises SettingError where there is a start: a place is searched, and only before its first frame."""
        raise SettingError("start", "is given, but a place is searched for the camera", "leave it out")

    @property
    def in_place(self) -> InPlace:
        """Where the last step was."""
        return self._in_place

    @property
    def particles(self) -> Particles:
        """After the last step, in its room's world; while the place is searched, one where the camera was last."""
        particles = self._localizer.particles
        if particles is not None:
            return particles
        return Particles(self._searching.estimate.pose[None], np.zeros(1), np.zeros(1))
