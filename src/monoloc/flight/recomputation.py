"""A recorded flight, computed again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from monoloc.bundle import Bundle
from monoloc.config import override
from monoloc.errors import DataError
from monoloc.flight.flight_loop import FlightOutput, FlightStep
from monoloc.flight.flight_recording import FlightHeader, RecordedIdle, read_events
from monoloc.live.frame_source import LiveFrame
from monoloc.localizer import Localizer


def recompute(
    folder: Path,
    header: FlightHeader,
    bundle: Bundle,
    outputs: Sequence[FlightOutput],
    show: Callable[[int], None],
    budget_ms: float | None = None,
) -> int:
    """Localise the frames of a recorded flight, with its times, its gravity and its attitude.

    Args:
        folder, header: of the flight.
        bundle: of the flight.
        outputs: take the results, as they did in the flight.
        show: is told the number of frames after each.
        budget_ms: that each step keeps here; None leaves out what the flight left out.

    Returns:
        The number of frames.

    Raises:
        DataError: a file is missing or damaged, or there is no frame.
        SettingError: the budget is out of range.
    """
    start = None if header.start is None else header.start.start
    settings = override(bundle.settings, budget_ms=budget_ms)
    localizer = Localizer(bundle, header.camera, start, settings, seed=header.seed)
    count = 0
    for event in read_events(folder, header.camera):
        if isinstance(event, RecordedIdle):
            for output in outputs:
                output.idle(event.idle_s)
            continue
        color, frame = event
        if frame.start is not None:
            localizer.reset(frame.start.start)
        motion = frame.motion
        level = frame.level if budget_ms is None else None
        step = localizer.step(color, frame.elapsed_s, down=frame.down, measured_motion=motion, level=level)
        taken = LiveFrame(color, frame.captured_s, count)
        result = FlightStep(taken, frame.elapsed_s, frame.down, step, frame.done_s, measured_motion=motion)
        for output in outputs:
            output.take(result)
        count += 1
        show(count)
    if count == 0:
        raise DataError(folder, "holds no frame", "give another flight")
    return count
