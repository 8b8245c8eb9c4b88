"""Localises one camera in a place: in the room where it is, and across its doors into others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.component_checks import check_frame
from monoloc.components import ComponentsFactory, default_components
from monoloc.depth.predictor import DepthPrediction
from monoloc.errors import BundleError
from monoloc.fusion.gravity import unit_direction
from monoloc.geometry import FloatArray
from monoloc.landmarks.features import KeypointDetector, Keypoints
from monoloc.localizer import Localizer
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles
from monoloc.place.hand_over import HandOver, carried, near_doors, start_from
from monoloc.place.loaded_rooms import MOST_LOADED, LoadedRooms
from monoloc.place.place_files import Place
from monoloc.place.place_manifest import Door
from monoloc.place.room_search import RoomSearch
from monoloc.same_image import is_same_image
from monoloc.start import Start
from monoloc.step import Step
from monoloc.step_budget import Level
from monoloc.supervision.state import State

_SEARCH_PERIOD_S = 0.2  # between searches of the place
_AGREE_S = 2.0  # within which two searches must find the same room
_LOST_S = 2.0  # for which a room searches for its camera, before the place is asked
# For which none of the room's landmarks are seen, before the place is asked whether the camera is in another room:
# outside its room, a localizer follows scans of what its map does not know.
_UNSEEN_S = 1.0


@dataclass(frozen=True)
class PlaceStep:
    """The result of one frame in a place.

    Attributes:
        room: in whose world the step is; None while the place is searched for the camera.
        step: of that room's localizer; None where there is no room.
        entered: whether this is the first frame in the room: the pose is in another world than before.
        level: what the frame left out to keep its budget.
    """

    room: str | None
    step: Step | None
    entered: bool = False
    level: Level = Level.FULL

    @property
    def state(self) -> State:
        return "lost" if self.step is None else self.step.state


@dataclass(frozen=True)
class _Frame:
    """What :meth:`PlaceLocalizer.step` is given."""

    color: NDArray[np.uint8]
    elapsed_s: float
    measured_depth: DepthPrediction | None
    down: FloatArray | None
    measured_motion: Motion | None
    level: Level | None
    is_repeated: bool  # it shows the previous image again, which is no second view of anything

    @property
    def nowhere(self) -> PlaceStep:
        """The result where the camera is in no room."""
        return PlaceStep(None, None, level=self.level or Level.FULL)


class PlaceLocalizer:
    """Localises one camera in a place; call :meth:`step` with every frame in order.

    Near a door, landmarks of the room beyond are measured too, and the belief goes on there once they explain the
    view better. Where no landmarks of the room are seen for a second, the place is asked, and the camera found in
    another room is believed there. Three rooms are in memory, and one more while it is read. A room that cannot be
    read, such as from a disk that fails, is tried again every few seconds, and not entered until it can be read;
    :attr:`unreadable` says so.

    Args:
        place: as :func:`monoloc.place.place_files.read_place` returns it.
        camera: the camera of the frames.
        room: that the flight starts in; None searches the place for the camera.
        start: its first pose in that room; None searches the room.
        components: makes the components of each room's localizer.
        seed: of all random numbers: the same seed gives the same poses.
        budget_ms, threads: of each room's step, in place of the bundles'; None takes theirs. Searches of the place,
            and landmarks of the rooms beyond near doors, come on top of the budget.

    Raises:
        BundleError: the room's bundle is missing, damaged or changed.
        SettingError: ``budget_ms`` or ``threads`` is out of range; with no room to start in, :meth:`step` raises it.
        ValueError: the place has no such room, or a start is given without a room.
        TypeError: an argument has the wrong type, such as a path for the place.
    """

    def __init__(
        self,
        place: Place,
        camera: Camera,
        room: str | None = None,
        start: Start | None = None,
        components: ComponentsFactory = default_components,
        seed: int | np.random.Generator = 0,
        budget_ms: float | None = None,
        threads: int | None = None,
    ) -> None:
        if not isinstance(place, Place):  # a path, for which the error would come from deep inside
            raise TypeError(f"place must be a Place, as read_place(PATH) gives it, got {type(place).__name__}")
        if not isinstance(camera, Camera):
            raise TypeError(f"camera must be a monoloc.Camera, got {type(camera).__name__}")
        if room is None and start is not None:
            raise ValueError("start needs a room")
        if room is not None and room not in place.names:
            raise ValueError(f"room must be one of {', '.join(place.names)}, got {room}")
        self._place, self._camera, self._components = place, camera, components
        self._rng = np.random.default_rng(seed)
        self._detect = KeypointDetector(camera)
        self._rooms = LoadedRooms(place, camera, budget_ms, threads)
        self._search = RoomSearch(place, self._rooms)
        self._room, self._localizer = room, None if room is None else self._localizer_in(room, start)
        self._hand_over, self._is_first = HandOver(), True
        self._previous: NDArray[np.uint8] | None = None
        self._candidate: str | None = None  # that a search found last
        self._since_candidate_s = 0.0
        self._lost_s, self._unseen_s, self._since_search_s = 0.0, 0.0, _SEARCH_PERIOD_S

    @property
    def loaded(self) -> list[str]:
        """Names of the rooms in memory."""
        return self._rooms.names

    @property
    def unreadable(self) -> Mapping[str, str]:
        """Why rooms could not be read when they were needed last, by name."""
        return self._rooms.unreadable

    @property
    def bundle(self) -> Bundle | None:
        """Of the room that the camera is in; None while the place is searched for it."""
        return None if self._localizer is None or self._room is None else self._rooms[self._room].bundle

    @property
    def particles(self) -> Particles | None:
        """Of the room that the camera is in, in its world; None while the place is searched for it."""
        return None if self._localizer is None else self._localizer.particles

    def step(
        self,
        color: NDArray[np.uint8],
        elapsed_s: float,
        measured_depth: DepthPrediction | None = None,
        down: FloatArray | None = None,
        measured_motion: Motion | None = None,
        level: Level | None = None,
    ) -> PlaceStep:
        """Take in one frame; arguments as :meth:`monoloc.localizer.Localizer.step`.

        A room whose direction of gravity is not known ignores ``down``. A frame at which the camera enters a room may
        be localised twice, in both rooms at the same level.

        Raises:
            ValueError, TypeError: as :meth:`monoloc.localizer.Localizer.step`.
        """
        elapsed_s = 0.0 if self._is_first else elapsed_s
        check_frame(self._camera, color, elapsed_s, measured_depth, measured_motion)
        if down is not None:
            unit_direction(down)  # of which a room is not told while there is none
        self._is_first = False
        self._since_candidate_s += elapsed_s
        self._rooms.pass_time(elapsed_s)
        is_repeated, self._previous = is_same_image(color, self._previous), color.copy()
        frame = _Frame(color, elapsed_s, measured_depth, down, measured_motion, level, is_repeated)
        if self._localizer is None or self._room is None:
            return self._searched(frame)
        step = self._stepped(self._localizer, self._room, frame)
        frame = replace(frame, level=step.level)
        if step.state == "lost":
            self._hand_over.update(0, {})  # frames before it and after it are not in a row
            self._lost_s += elapsed_s
            if self._lost_s < _LOST_S:
                return PlaceStep(self._room, step, level=step.level)
            self._localizer, self._candidate, self._since_search_s = None, None, _SEARCH_PERIOD_S
            return self._searched(frame)
        self._lost_s = 0.0
        self._unseen_s = 0.0 if step.landmark_pose is not None else self._unseen_s + elapsed_s
        stays = PlaceStep(self._room, step, level=step.level)
        return stays if is_repeated else self._left(frame, self._room, step) or stays

    def _left(self, frame: _Frame, room: str, step: Step) -> PlaceStep | None:
        """The first step in another room, if the camera is there; None where it stays."""
        door = self._door_taken(frame.color, room, step.estimate)
        if door is not None:
            return self._handed_over(frame, door, step.estimate)
        other = self._other_room(frame, room)
        return None if other is None else self._entered(other, None, frame)

    def _searched(self, frame: _Frame) -> PlaceStep:
        """Search all rooms; the room's own search then finds the pose, at the same frame."""
        self._since_search_s += frame.elapsed_s
        if self._since_search_s < _SEARCH_PERIOD_S or frame.is_repeated:
            return frame.nowhere
        self._since_search_s = 0.0
        room = self._agreed(frame)
        return frame.nowhere if room is None else self._entered(room, None, frame)

    def _agreed(self, frame: _Frame) -> str | None:
        """The room that the search finds, if the last one that found a room found the same one a short time ago.

        What several rooms have alike, such as a picture, may show a wrong one in a single view.
        """
        found = self._search.find(self._detect(frame.color), known=self._room)
        if found is None:
            return None
        is_agreed = found == self._candidate and self._since_candidate_s < _AGREE_S
        self._candidate, self._since_candidate_s = found, 0.0
        return found if is_agreed else None

    def _other_room(self, frame: _Frame, room: str) -> str | None:
        """The other room that the camera is in, asked once a second while it sees no landmarks of this one.

        What is found is asked for again at the next search.
        """
        if self._unseen_s < _UNSEEN_S:
            return None
        found = self._agreed(frame)
        is_pending = self._candidate not in (None, room) and self._since_candidate_s < _AGREE_S
        self._unseen_s = _UNSEEN_S - _SEARCH_PERIOD_S if is_pending else 0.0
        return None if found == room else found

    def _handed_over(self, frame: _Frame, door: Door, belief: Estimate) -> PlaceStep:
        assert self._room is not None
        return self._entered(door.beyond(self._room), start_from(carried(belief, door, self._room)), frame)

    def _entered(self, room: str, start: Start | None, frame: _Frame) -> PlaceStep:
        self._localizer = None  # so that no two are in memory
        self._room, self._localizer = room, self._localizer_in(room, start)
        self._hand_over, self._candidate = HandOver(), None
        self._lost_s, self._unseen_s = 0.0, 0.0
        step = self._stepped(self._localizer, room, frame)
        return PlaceStep(room, step, entered=True, level=step.level)

    def _localizer_in(self, room: str, start: Start | None) -> Localizer:
        bundle = self._rooms[room].bundle
        return Localizer(bundle, self._camera, start, components=self._components, seed=self._rng)

    def _stepped(self, localizer: Localizer, room: str, frame: _Frame) -> Step:
        down = None if self._rooms[room].bundle.down is None else frame.down
        return localizer.step(
            frame.color, frame.elapsed_s, frame.measured_depth, down, frame.measured_motion, frame.level
        )

    def _door_taken(self, color: NDArray[np.uint8], room: str, belief: Estimate) -> Door | None:
        """The door through which the camera has gone; None where it stays."""
        doors = near_doors(self._place.doors_of(room), room, belief, MOST_LOADED - 1)
        if not doors:
            self._hand_over.update(0, {})
            return None
        seen = self._detect(color)
        here = self._found(room, seen, belief)
        beyond: dict[str, int] = {}
        door_to: dict[str, Door] = {}
        for door in doors:
            name = door.beyond(room)
            try:
                found = self._found(name, seen, carried(belief, door, room))
            except BundleError:  # the pose in this room is worth more
                continue
            if found >= beyond.get(name, 0):
                beyond[name], door_to[name] = found, door
        taken = self._hand_over.update(here, beyond)
        return None if taken is None else door_to[taken]

    def _found(self, room: str, seen: Keypoints, belief: Estimate) -> int:
        """Landmarks of a room that agree on one pose near a belief in its world."""
        measured = self._rooms[room].landmarks.measure_near(seen, belief.pose, belief.covariance)
        return 0 if measured.pose is None else measured.found
