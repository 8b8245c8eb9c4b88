"""What a localizer says during and after faults of its camera, on frames that did not build its bundle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from monoloc.bundle import Bundle
from monoloc.errors import DataError
from monoloc.io.recording import Recording
from monoloc.localizer import Localizer
from monoloc.progress import Progress
from monoloc.start import Start
from monoloc_lab.bench.faults import FAULT_S, FAULTS, Fault, Surroundings
from monoloc_lab.bench.judged_flight import FlightFrame, Image, JudgedFlight, fly, pooled, seconds_until, share
from monoloc_lab.bench.unseen_frames import Frames, UnseenFrames

BEFORE_S, AFTER_S = 4.0, 5.0
"""Seconds that are flown before and after a fault."""

BLIND_S = 1.0
"""Time into a blinding fault after which no pose can be vouched for."""


@dataclass(frozen=True)
class PartFigures:
    """Figures of the frames in a fault, or after it.

    Attributes:
        frames: their number.
        states: number of frames in each state; ``refused`` are frames that the localizer does not take in.
        silent_frames: that are *tracking* or *map-changed*, and more than 30 cm off or outside 3.5 standard
            deviations in position. Of another room, every such frame is silent.
        silent_share: of the frames, 0..1; None without frames.
        coverage_95: of the frames that are not *lost*; None without any.
    """

    frames: int
    states: dict[str, int]
    silent_frames: int
    silent_share: float | None
    coverage_95: float | None


@dataclass(frozen=True)
class FaultFigures:
    """Figures of the flights with one fault.

    Attributes:
        during, after: of the frames in the fault, and after it.
        reported_s: from the fault's first frame to the first one in it that is not *tracking*; of several flights the
            longest, None if there is no such frame in one of them.
        recovery_s: from the first frame after the fault to the first *tracking* one less than 30 cm off, likewise.
        silent_frames_blind: in a blinding fault, silent frames later than 1 s into it; else 0.
    """

    during: PartFigures
    after: PartFigures
    reported_s: float | None
    recovery_s: float | None
    silent_frames_blind: int


@dataclass(frozen=True)
class FaultTotals:
    """Totals over all faults but the control.

    Attributes:
        frames: in and after faults.
        silent_frames, silent_share: of these.
        silent_frames_blind: silent frames later than 1 s into black, frozen, another room or mirrored images.
    """

    frames: int
    silent_frames: int
    silent_share: float | None
    silent_frames_blind: int


@dataclass(frozen=True)
class FaultsFigures:
    """Figures of all faults by name, and those for which the recording has too few unseen frames in a row."""

    faults: dict[str, FaultFigures]
    totals: FaultTotals
    left_out: list[str]


@dataclass(frozen=True)
class FaultFlight:
    """A flight, in parts."""

    during: JudgedFlight
    after: JudgedFlight


def bench_faults(
    bundle: Bundle,
    recording: Recording,
    other: Recording,
    names: Sequence[str],
    flights: int,
    seed: int,
    progress: Progress,
) -> FaultsFigures:
    """Fly faults over the frames of a recording that did not build the bundle.

    Args:
        other: a recording of another room; its images are resized to the camera.
        names: of :data:`monoloc_lab.bench.faults.FAULTS`.
        flights: with each fault, over different frames.
        seed: of the frames, starts and localizers.

    Raises:
        DataError: the recording has no poses or too few unseen frames for any fault, or an image cannot be read.
    """
    frames = UnseenFrames(bundle, recording, progress)
    windows = {name: frames.windows_lasting(_flight_s(FAULTS[name])) for name in names}
    possible = [name for name in names if windows[name]]
    if not possible:
        seconds = min(_flight_s(FAULTS[name]) for name in names)
        raise DataError(frames.name, f"has no {seconds:.0f} s of unseen frames in a row", "give more frames")
    elsewhere = _images_of(other, (frames.camera.width, frames.camera.height))
    figures = {}
    with progress.task("faults", len(possible) * flights) as show:
        for done, name in enumerate(possible):
            flown = []
            for number in range(flights):
                # The same frames for every fault that lasts as long.
                rng = np.random.default_rng((seed, number))
                window = windows[name][rng.integers(len(windows[name]))]
                flown.append(_fly_fault(bundle, frames, FAULTS[name], window, elsewhere, rng))
                show(done * flights + number + 1)
            figures[name] = fault_figures(FAULTS[name], flown)
    return FaultsFigures(figures, totals(figures), [name for name in names if not windows[name]])


def _flight_s(fault: Fault) -> float:
    return BEFORE_S + (FAULT_S if fault.is_of_whole_flight else fault.seconds) + AFTER_S


def _images_of(recording: Recording, size: tuple[int, int]) -> Callable[[int], Image]:
    def image(index: int) -> Image:
        color = recording.color(index % len(recording))
        return np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

    return image


def with_fault(
    fault: Fault, frames: Sequence[FlightFrame], elsewhere: Callable[[int], Image], rng: np.random.Generator
) -> tuple[list[FlightFrame], slice]:
    """A flight's frames with a fault in their middle, and which of them are in the fault."""
    if fault.is_of_whole_flight:
        return fault.change(frames, Surroundings(frames[0], elsewhere, rng)), slice(0, len(frames))
    times_s = np.array([frame.time_s for frame in frames]) - frames[0].time_s
    first, end = np.searchsorted(times_s, [BEFORE_S, BEFORE_S + fault.seconds]).tolist()
    changed = fault.change(frames[first:end], Surroundings(frames[first - 1], elsewhere, rng))
    return [*frames[:first], *changed, *frames[end:]], slice(first, first + len(changed))


def _fly_fault(
    bundle: Bundle,
    frames: UnseenFrames,
    fault: Fault,
    window: Frames,
    elsewhere: Callable[[int], Image],
    rng: np.random.Generator,
) -> FaultFlight:
    camera = frames.camera
    camera = replace(camera, fx=fault.focal_factor * camera.fx, fy=fault.focal_factor * camera.fy)
    start = Start.disturbed(frames.poses[window[0]], rng)
    flown, in_fault = with_fault(fault, frames.flight(window), elsewhere, rng)
    flight = fly(Localizer(bundle, camera, start, seed=rng), flown)
    return FaultFlight(flight.part(in_fault), flight.part(slice(in_fault.stop, None)))


def fault_figures(fault: Fault, flights: Sequence[FaultFlight]) -> FaultFigures:
    """Figures of flights, at least one, with a fault."""
    durings, afters = [flight.during for flight in flights], [flight.after for flight in flights]
    return FaultFigures(
        during=_part_figures(pooled(durings)),
        after=_part_figures(pooled(afters)),
        reported_s=_longest([seconds_until(during, ~during.is_tracking) for during in durings]),
        recovery_s=_longest([seconds_until(after, after.is_near) for after in afters]),
        silent_frames_blind=sum(_silent_frames_blind(during) for during in durings) if fault.is_blinding else 0,
    )


def _part_figures(flight: JudgedFlight) -> PartFigures:
    errors = flight.not_lost
    return PartFigures(
        frames=len(flight),
        states=dict(Counter(flight.states.tolist())),
        silent_frames=int(flight.is_silent.sum()),
        silent_share=share(flight.is_silent),
        coverage_95=errors.coverage_95 if len(errors.pose_nees) else None,
    )


def _longest(seconds: Sequence[float | None]) -> float | None:
    known = [s for s in seconds if s is not None]
    return max(known) if len(known) == len(seconds) else None


def _silent_frames_blind(during: JudgedFlight) -> int:
    return int(np.sum(during.is_silent & (during.times_s > during.times_s[:1] + BLIND_S)))


def totals(figures: dict[str, FaultFigures]) -> FaultTotals:
    """Totals over all faults but the control."""
    faults = [each for name, each in figures.items() if name != "none"]
    frames = sum(each.during.frames + each.after.frames for each in faults)
    silent = sum(each.during.silent_frames + each.after.silent_frames for each in faults)
    return FaultTotals(
        frames=frames,
        silent_frames=silent,
        silent_share=silent / frames if frames else None,
        silent_frames_blind=sum(each.silent_frames_blind for each in faults),
    )
