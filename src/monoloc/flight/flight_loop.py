"""The loop of a flight: the newest frame in, a step, and what becomes of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from operator import methodcaller
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, MonolocError
from monoloc.flight.flight_inputs import OtherSensors, Starting
from monoloc.flight.in_place import InPlace, Switch
from monoloc.geometry import FloatArray
from monoloc.live.frame_source import EndOfStreamError, FrameSource, LiveFrame
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate
from monoloc.same_image import is_same_image
from monoloc.settled_objects import settled
from monoloc.start import Start
from monoloc.step import Step
from monoloc.step_budget import Level, level_counts

MOST_AHEAD_S = 0.02
"""By which a camera's stamps may be ahead of the clock."""

_WAIT_S = 0.1  # for a frame, before the outputs hear that there is none
_KEPT = 10_000  # latencies and intervals that the summary is made of, the last ones


@dataclass(frozen=True)
class FlightStep:
    """A frame and its result.

    Attributes:
        frame: as the camera gave it.
        elapsed_s: since the previous localised frame, 0 at the first.
        down_camera: direction of gravity that was used, (3,) in the camera's frame, or None.
        step: the localizer's result.
        done_s: when it was known, by the source's clock.
        start: from which the localizer began anew at this frame, such as a marker tells it.
        measured_motion: since the previous localised frame that was used, by another sensor than the camera, or
            None.
        in_place: which room of a place the step is of; None in a flight in a single room.
    """

    frame: LiveFrame
    elapsed_s: float
    down_camera: FloatArray | None
    step: Step
    done_s: float
    start: Start | None = None
    measured_motion: Motion | None = None
    in_place: InPlace | None = None

    @property
    def room(self) -> str | None:
        """In whose world the step's poses are; None in a flight in a single room, or while a place is searched."""
        return None if self.in_place is None else self.in_place.room

    @property
    def estimate(self) -> Estimate:
        """The belief in the one map of the flight: the room's world, or that of the first room of a place."""
        return self.step.estimate if self.in_place is None else self.in_place.estimate


class FlightLocalizer(Protocol):
    """What a flight is localised by; a :class:`~monoloc.localizer.Localizer` is one."""

    def step(
        self,
        color: NDArray[np.uint8],
        elapsed_s: float,
        *,
        down: FloatArray | None = None,
        measured_motion: Motion | None = None,
        level: Level | None = None,
    ) -> Step:
        """Take in one frame; see :meth:`monoloc.localizer.Localizer.step`."""
        ...

    def reset(self, start: Start | None) -> None:
        """Begin anew; see :meth:`monoloc.localizer.Localizer.reset`."""
        ...


class FlightOutput(Protocol):
    """Takes the results of a flight.

    An output that raises a MonolocError hears no more until the end, and the flight goes on: a full disk must not
    take the pose from an autopilot.
    """

    def take(self, result: FlightStep) -> None:
        """A frame was localised."""
        ...

    def idle(self, now_s: float) -> None:
        """No frame came for a tenth of a second, or the one that came was dropped."""
        ...

    def close(self) -> None:
        """The flight is over: write what is still held."""
        ...


@dataclass
class FlightSummary:
    """What a flight came to.

    Attributes:
        frames: localised.
        dropped: frames that were not, by reason: ``early`` (the room was still being read), ``skipped`` (a newer one
            had come), ``old`` (older than the limit when their turn came), ``future`` (captured after they came, by a
            clock that is wrong), ``unordered`` (captured no later than the one before), ``without start`` (before the
            first marker).
        states: number of frames in each state.
        levels: number of frames at each level of the budget.
        poses: of frames that are not *lost*, if there is an autopilot: ``sent``, or why they were not: ``old`` (older
            than the limit when they were done), ``future``, ``unconfirmed`` (no frame had been vouched for yet),
            ``without image`` (it was repeated or empty), ``not finite``.
        unwritten: what outputs did not write since the disk was too slow, by kind: ``mcap images``, ``mcap frames``,
            ``poses``, ``messages``.
        failures: of outputs, which took no more frames; and, first, what ended the flight.
        latencies_s: from capture to result, of the last frames.
        intervals_s: between localised frames, of the last ones.
        rooms: number of frames that are not *lost* in each room of a place; None in a single room.
        switches: entries into rooms of a place, the last ones.
    """

    frames: int = 0
    dropped: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    levels: Counter[Level] = field(default_factory=Counter)
    poses: Counter[str] = field(default_factory=Counter)
    unwritten: Counter[str] = field(default_factory=Counter)
    failures: list[MonolocError] = field(default_factory=list)
    latencies_s: list[float] = field(default_factory=list)
    intervals_s: list[float] = field(default_factory=list)
    rooms: Counter[str] | None = None
    switches: list[Switch] = field(default_factory=list)
    _began_s: float | None = None
    _room: str | None = None

    def add(self, result: FlightStep) -> None:
        self._add_room(result)
        self.frames += 1
        self.states[result.step.state] += 1
        self.levels[result.step.level] += 1
        self.latencies_s.append(result.done_s - result.frame.captured_s)
        if self.frames > 1:
            self.intervals_s.append(result.elapsed_s)
        for values in (self.latencies_s, self.intervals_s):
            del values[:-_KEPT]

    def _add_room(self, result: FlightStep) -> None:
        if result.in_place is None:
            return
        captured_s, room = result.frame.captured_s, result.room
        self._began_s = captured_s if self._began_s is None else self._began_s
        self.rooms = Counter() if self.rooms is None else self.rooms
        if room is not None and result.in_place.entered is not None:
            self.switches.append(Switch(self.frames, captured_s - self._began_s, self._room, room))
            del self.switches[:-_KEPT]
        if room is not None and result.step.state != "lost":
            self.rooms[room] += 1
        self._room = room

    @property
    def rate_hz(self) -> float | None:
        """One over the median interval; None of a single frame."""
        interval_s = float(np.median(self.intervals_s)) if self.intervals_s else 0.0
        return 1.0 / interval_s if interval_s else None

    def latency_s(self, percent: float) -> float | None:
        """That many per cent of the frames took no longer; None without frames."""
        return float(np.percentile(self.latencies_s, percent)) if self.latencies_s else None

    def figures(self) -> dict[str, object]:
        """Ready for JSON."""
        return {
            "frames": self.frames,
            "dropped": dict(self.dropped),
            "poses": dict(self.poses),
            "unwritten": dict(self.unwritten),
            "states": dict(self.states),
            "levels": level_counts(self.levels),
            "rate_hz": self.rate_hz,
            "latency_s_median": self.latency_s(50.0),
            "latency_s_p95": self.latency_s(95.0),
            **self._of_rooms(),
        }

    def _of_rooms(self) -> dict[str, object]:
        if self.rooms is None:
            return {}
        return {"rooms": dict(self.rooms), "switches": [asdict(switch) for switch in self.switches]}


class Flight:
    """Localises a camera until it ends or is stopped; call :meth:`run` once.

    Args:
        localizer: of the room or the place.
        camera: of the source's images.
        source: of frames.
        outputs: take every result, in this order.
        most_age_s: since its capture, beyond which a frame is dropped.
        starting: how the flight begins; its start is the localizer's.
        sensors: what others than the camera tell.
        summary: is filled as the flight goes.
        in_place: where in a place the last step was; None in a single room.
    """

    def __init__(
        self,
        localizer: FlightLocalizer,
        camera: Camera,
        source: FrameSource,
        outputs: Sequence[FlightOutput],
        most_age_s: float,
        starting: Starting,
        sensors: OtherSensors,
        summary: FlightSummary,
        in_place: Callable[[], InPlace | None] = lambda: None,
    ) -> None:
        self._localizer, self._camera, self._source, self._outputs = localizer, camera, source, outputs
        self._most_age_s, self._sensors, self._summary, self._in_place = most_age_s, sensors, summary, in_place
        self._find_start = starting.find
        self._is_lost, self._is_waiting = starting.begins != "known", starting.begins == "waiting"
        self._previous: LiveFrame | None = None
        self._start: Start | None = None
        self._sequence: int | None = None  # of the last frame
        self._failed: list[FlightOutput] = []

    def run(self, stop: Callable[[], bool]) -> None:
        """Localise every frame that is in time.

        Args:
            stop: says whether to stop; asked between frames.

        Raises:
            DataError: the camera's images are of another size, or cannot be read.
        """
        with settled():
            while not stop():
                try:
                    frame = self._source.next(_WAIT_S)
                except EndOfStreamError:
                    break
                if frame is not None and self._is_in_time(frame) and self._begins(frame):
                    self._localize(frame)
                else:
                    self._hand_on(methodcaller("idle", self._source.now_s()))

    def _is_in_time(self, frame: LiveFrame) -> bool:
        self._count_unseen(frame.sequence)
        age_s = self._source.now_s() - frame.captured_s
        if age_s > self._most_age_s:
            reason = "old"
        elif age_s < -MOST_AHEAD_S:
            reason = "future"
        elif self._previous is not None and frame.captured_s <= self._previous.captured_s:
            reason = "unordered"
        else:
            return True
        self._summary.dropped[reason] += 1
        return False

    def _count_unseen(self, sequence: int) -> None:
        """Count the images between the last frame and this one; before the first, the room was still being read."""
        if self._sequence is None and sequence > 0:
            self._summary.dropped["early"] += sequence
        self._summary.dropped["skipped"] += 0 if self._sequence is None else sequence - self._sequence - 1
        self._sequence = sequence

    def _begins(self, frame: LiveFrame) -> bool:
        """Whether the frame can be localised, after a start was looked for in it, if that is needed."""
        self._check_size(frame)
        previous = None if self._previous is None else self._previous.color
        # An image that repeats says nothing of where the camera is now.
        looks = self._is_lost and not is_same_image(frame.color, previous)
        self._start = self._find_start(frame.color) if looks else None
        if self._start is not None:
            self._localizer.reset(self._start)
            self._is_waiting = False
        if self._is_waiting:
            self._summary.dropped["without start"] += 1
        return not self._is_waiting

    def _localize(self, frame: LiveFrame) -> None:
        before_s = frame.captured_s if self._previous is None else self._previous.captured_s
        elapsed_s = frame.captured_s - before_s
        down_camera = self._sensors.down_at(frame.captured_s)
        motion = None if self._previous is None else self._sensors.motion_between(before_s, frame.captured_s)
        step = self._localizer.step(frame.color, elapsed_s, down=down_camera, measured_motion=motion)
        self._previous, self._is_lost = frame, step.state == "lost"
        done_s, in_place = self._source.now_s(), self._in_place()
        result = FlightStep(frame, elapsed_s, down_camera, step, done_s, self._start, motion, in_place)
        self._summary.add(result)
        self._hand_on(methodcaller("take", result))

    def _hand_on(self, say: Callable[[FlightOutput], None]) -> None:
        for output in self._outputs:
            if output in self._failed:
                continue
            try:
                say(output)
            except MonolocError as error:
                self._failed.append(output)
                self._summary.failures.append(error)

    def _check_size(self, frame: LiveFrame) -> None:
        height, width = frame.color.shape[:2]
        if (width, height) != (self._camera.width, self._camera.height):
            problem = (
                f"gives images of {width}x{height}, but the camera is {self._camera.width}x{self._camera.height}"
            )
            raise DataError(
                self._source.name, problem, "give the intrinsics of these images, or set the camera's size"
            )
