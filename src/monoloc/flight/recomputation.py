"""A recorded flight, computed again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from monoloc.errors import DataError
from monoloc.flight.flight_loop import FlightLocalizer, FlightOutput, FlightStep
from monoloc.flight.flight_recording import FlightHeader, RecordedIdle, read_events
from monoloc.flight.in_place import InPlace
from monoloc.io.recorded_flight import FRAMES
from monoloc.live.frame_source import LiveFrame


def recompute(
    folder: Path,
    header: FlightHeader,
    localizer: FlightLocalizer,
    outputs: Sequence[FlightOutput],
    show: Callable[[int], None],
    keeps_levels: bool = True,
    in_place: Callable[[], InPlace | None] = lambda: None,
) -> int:
    """Localise the frames of a recorded flight, with its times, its gravity and its attitude.

    Args:
        folder, header: of the flight.
        localizer: as the flight's before its first frame.
        outputs: take the results, as they did in the flight.
        show: is told the number of frames after each.
        keeps_levels: whether to leave out what the flight left out, whatever the localizer's budget.
        in_place: as :class:`~monoloc.flight.flight_loop.Flight`.

    Returns:
        The number of frames.

    Raises:
        DataError: a file is missing or damaged, or there is no frame.
        SettingError: the budget of a place's localizer is out of range.
    """
    count = 0
    for event in read_events(folder, header.camera):
        if isinstance(event, RecordedIdle):
            for output in outputs:
                output.idle(event.idle_s)
            continue
        color, frame = event
        motion = frame.motion
        level = frame.level if keeps_levels else None
        try:
            if frame.start is not None:
                localizer.reset(frame.start.start)
            step = localizer.step(color, frame.elapsed_s, down=frame.down, measured_motion=motion, level=level)
        except ValueError as error:  # as of a direction of gravity, in a room that has none
            problem = f"is damaged in frame {count + 1} ({error})"
            raise DataError(folder / FRAMES, problem, "give another flight") from error
        taken = LiveFrame(color, frame.captured_s, count)
        result = FlightStep(
            taken,
            frame.elapsed_s,
            frame.down,
            step,
            frame.done_s,
            measured_motion=motion,
            in_place=in_place(),
        )
        for output in outputs:
            output.take(result)
        count += 1
        show(count)
    if count == 0:
        raise DataError(folder, "holds no frame", "give another flight")
    return count
