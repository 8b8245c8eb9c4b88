"""How a localizer recovers from kidnaps, finds itself without a start, and notices edits of the map.

All on frames that did not build its bundle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monoloc.bundle import Bundle
from monoloc.errors import DataError
from monoloc.evaluation.consistency import Consistency
from monoloc.fusion.reference_poses import NEAR_M
from monoloc.geometry import FloatArray, pose_distance_m
from monoloc.io.recording import Recording
from monoloc.localizer import Localizer
from monoloc.progress import Progress
from monoloc.start import Start
from monoloc_lab.bench.judged_flight import JudgedFlight, Mask, fly, longest_run_s, pooled, seconds_until, share
from monoloc_lab.bench.map_edits import EditedFlight, draw_edits, fly_edits
from monoloc_lab.bench.unseen_frames import Frames, UnseenFrames

BEFORE_FRAMES = 30
"""Frames that are followed before a kidnap."""

AFTER_S = 5.0
"""Seconds that are flown after a kidnap or an unknown start."""

APART_M = 0.7
"""Least pose distance of a kidnap, see :func:`monoloc.geometry.pose_distance_m`."""

_FOUND_S = 3.0  # in which a camera is to be found
_REPORTED_S = 0.5  # in which a kidnap is to be noticed
_SETTLED_S = 1.0  # after which the error of a start is forgotten
_WRONG_PLACE_S = 1.0  # of *tracking* at a wrong pose, after which a drone flies by it


@dataclass(frozen=True)
class RegionFigures:
    """Figures of the kidnaps and starts whose first frame is in a region, and of the frames in it.

    Rates are shares, 0..1; None of nothing. Their meaning is that of :class:`RecoveryFigures`.
    """

    starts: int
    global_start_rate: float | None
    kidnaps: int
    kidnap_recovery_rate: float | None
    false_alarm_rate: float | None
    coverage_95: float | None


@dataclass(frozen=True)
class RecoveryFigures:
    """Figures over all kidnaps and unknown starts; those without a name of either are over the frames of both, from
    the kidnap or start on. A *map-changed* frame counts as *tracking*. Rates are shares, 0..1; None of nothing.

    Attributes:
        starts, kidnaps: number of flights.
        supports_starts: whether the bundle's localizer starts without a pose; else none of the starts is found.
        global_start_rate, kidnap_recovery_rate: *tracking* less than 20 cm and 10 degrees off within 3 s.
        lost_reported_rate: kidnaps after which a frame within 0.5 s is not *tracking*, or is right already.
        false_tracking_rate: *tracking* frames more than 30 cm off, of all *tracking* frames.
        wrong_place_rate: flights that are more than 30 cm off and *tracking* for more than a second without a break.
        false_alarm_rate: frames before the kidnaps, later than 1 s after the start, that are not *tracking*.
        coverage_95, coverage_99, nees: of frames that are not *lost*; ``nees`` is the mean, divided by 6.
        recovery_s_median: of the kidnaps that are recovered from.
        map_edits: number of flights over edited maps, and of the same flights over the true map.
        map_changed_rate: flights over edited maps in which a *map-changed* frame names a region of the edit.
        map_changed_false_rate: flights over the true map in which a frame is *map-changed*.
        near, away: within :data:`~monoloc.fusion.reference_poses.NEAR_M` of the build's frames, and farther away.
    """

    starts: int
    supports_starts: bool
    global_start_rate: float | None
    kidnaps: int
    kidnap_recovery_rate: float | None
    lost_reported_rate: float | None
    false_tracking_rate: float | None
    wrong_place_rate: float | None
    false_alarm_rate: float | None
    coverage_95: float | None
    coverage_99: float | None
    nees: float | None
    recovery_s_median: float | None
    map_edits: int
    map_changed_rate: float | None
    map_changed_false_rate: float | None
    near: RegionFigures
    away: RegionFigures


@dataclass(frozen=True)
class Kidnap:
    """Frames that are followed, and the frames elsewhere that follow them."""

    before: Frames
    after: Frames


def draw_kidnaps(frames: UnseenFrames, count: int, rng: np.random.Generator) -> list[Kidnap]:
    """Kidnaps from random frames to random ones that are at least :data:`APART_M` away.

    Raises:
        DataError: there are not enough frames in a row, or all are close together.
    """
    if count == 0:
        return []  # what the recording cannot give is then not needed
    befores, afters = frames.windows_of(BEFORE_FRAMES), _afters(frames)
    if not befores:
        raise DataError(frames.name, f"has no {BEFORE_FRAMES} unseen frames in a row", "give more frames")
    firsts = frames.poses[[after[0] for after in afters]]
    apart = [np.flatnonzero(pose_distance_m(frames.poses[before[-1]], firsts) >= APART_M) for before in befores]
    possible = [index for index, places in enumerate(apart) if len(places)]
    if not possible:
        raise DataError(frames.name, f"has no unseen frames {APART_M} m apart", "give frames of more of the room")
    chosen = rng.choice(possible, size=count)
    return [Kidnap(befores[index], afters[rng.choice(apart[index])]) for index in chosen]


def draw_starts(frames: UnseenFrames, count: int, rng: np.random.Generator) -> list[Frames]:
    """Random frames in a row of :data:`AFTER_S` seconds.

    Raises:
        DataError: there are none.
    """
    if count == 0:
        return []
    afters = _afters(frames)
    return [afters[index] for index in rng.integers(len(afters), size=count)]


def _afters(frames: UnseenFrames) -> list[Frames]:
    afters = frames.windows_lasting(AFTER_S)
    if not afters:
        raise DataError(frames.name, f"has no {AFTER_S:.0f} s of unseen frames in a row", "give more frames")
    return afters


def bench_recovery(
    bundle: Bundle, recording: Recording, kidnaps: int, starts: int, map_edits: int, seed: int, progress: Progress
) -> RecoveryFigures:
    """Fly kidnaps, unknown starts and edited maps over the frames of a recording that did not build the bundle.

    Args:
        kidnaps, starts, map_edits: number of flights.
        seed: of the draws, the starts and the localizers.

    Raises:
        DataError: the recording has no poses or too few unseen frames, or an image cannot be read.
    """
    frames = UnseenFrames(bundle, recording, progress)
    rng = np.random.default_rng(seed)
    drawn_kidnaps, drawn_starts = draw_kidnaps(frames, kidnaps, rng), draw_starts(frames, starts, rng)
    drawn_edits = draw_edits(bundle, recording, frames, map_edits, seed)  # so that minutes of flights are not lost
    with progress.task("kidnaps", len(drawn_kidnaps)) as show:
        kidnapped = []
        for number, kidnap in enumerate(drawn_kidnaps):
            kidnapped.append(_fly_kidnap(bundle, frames, kidnap, np.random.default_rng((seed, 0, number))))
            show(number + 1)
    with progress.task("unknown starts", len(drawn_starts)) as show:
        started = []
        for number, start in enumerate(drawn_starts):
            started.append(_fly_start(bundle, frames, start, np.random.default_rng((seed, 1, number))))
            show(number + 1)
    edited = fly_edits(bundle, frames, drawn_edits, seed, progress)
    return recovery_figures(kidnapped, started, edited)


def _fly_kidnap(bundle: Bundle, frames: UnseenFrames, kidnap: Kidnap, rng: np.random.Generator) -> JudgedFlight:
    before = frames.flight(kidnap.before)
    after = frames.flight(kidnap.after, before[-1].time_s + frames.interval_s)
    start = Start.disturbed(frames.poses[kidnap.before[0]], rng)
    return fly(Localizer(bundle, frames.camera, start, seed=rng), [*before, *after])


def _fly_start(bundle: Bundle, frames: UnseenFrames, start: Frames, rng: np.random.Generator) -> JudgedFlight | None:
    try:
        localizer = Localizer(bundle, frames.camera, seed=rng)
    except ValueError:
        return None
    return fly(localizer, frames.flight(start))


def recovery_figures(
    kidnapped: list[JudgedFlight], started: list[JudgedFlight | None], edited: list[EditedFlight]
) -> RecoveryFigures:
    """Figures of flights.

    Args:
        kidnapped: of which the first :data:`BEFORE_FRAMES` frames are before the kidnap.
        started: without a pose; None where the localizer does not start so.
        edited: over edited maps.
    """
    befores = [flight.part(slice(BEFORE_FRAMES)) for flight in kidnapped]
    afters = [flight.part(slice(BEFORE_FRAMES, None)) for flight in kidnapped]
    begun = [flight for flight in started if flight is not None]
    recoveries_s = [seconds_until(after, after.is_found) for after in afters]
    recovered_s = [s for s in recoveries_s if s is not None]
    runs = [*afters, *begun]
    frames = pooled(runs) if runs else None
    not_lost = _not_lost(frames)
    return RecoveryFigures(
        starts=len(started),
        supports_starts=len(begun) == len(started),
        global_start_rate=_rate([flight is not None and _is_soon_found(flight) for flight in started]),
        kidnaps=len(afters),
        kidnap_recovery_rate=_rate([_is_soon_found(after) for after in afters]),
        lost_reported_rate=_rate([_is_reported(after) for after in afters]),
        false_tracking_rate=None if frames is None else share(frames.is_far[frames.is_tracking]),
        wrong_place_rate=_rate([longest_run_s(run, run.is_far) > _WRONG_PLACE_S for run in runs]),
        false_alarm_rate=_false_alarm_rate(befores),
        coverage_95=None if not_lost is None else not_lost.coverage_95,
        coverage_99=None if not_lost is None else not_lost.coverage_99,
        nees=None if not_lost is None else float(np.mean(not_lost.pose_nees)) / 6.0,
        recovery_s_median=float(np.median(recovered_s)) if recovered_s else None,
        map_edits=len(edited),
        map_changed_rate=_rate([flight.names_edit for flight in edited]),
        map_changed_false_rate=_rate([flight.is_false for flight in edited]),
        near=_region_figures(befores, afters, begun, lambda distance_m: distance_m <= NEAR_M),
        away=_region_figures(befores, afters, begun, lambda distance_m: distance_m > NEAR_M),
    )


def _region_figures(
    befores: list[JudgedFlight],
    afters: list[JudgedFlight],
    begun: list[JudgedFlight],
    is_inside: Callable[[FloatArray], Mask],
) -> RegionFigures:
    """Of the region in which the distance to the build's frames satisfies ``is_inside``."""
    kidnaps_there = [after for after in afters if is_inside(after.distance_m)[0]]
    starts_there = [start for start in begun if is_inside(start.distance_m)[0]]
    runs = [*afters, *begun]
    not_lost = _not_lost(pooled([run.part(is_inside(run.distance_m)) for run in runs]) if runs else None)
    return RegionFigures(
        starts=len(starts_there),
        global_start_rate=_rate([_is_soon_found(start) for start in starts_there]),
        kidnaps=len(kidnaps_there),
        kidnap_recovery_rate=_rate([_is_soon_found(kidnap) for kidnap in kidnaps_there]),
        false_alarm_rate=_false_alarm_rate(befores, is_inside),
        coverage_95=None if not_lost is None else not_lost.coverage_95,
    )


def _rate(outcomes: list[bool]) -> float | None:
    return share(np.array(outcomes, dtype=np.bool_))


def _not_lost(frames: JudgedFlight | None) -> Consistency | None:
    """Errors of the frames that are not *lost*; None without any."""
    return None if frames is None or not len(frames.not_lost.pose_nees) else frames.not_lost


def _is_soon_found(flight: JudgedFlight) -> bool:
    return _within(seconds_until(flight, flight.is_found), _FOUND_S)


def _within(seconds: float | None, bound_s: float) -> bool:
    return seconds is not None and seconds <= bound_s


def _is_reported(after: JudgedFlight) -> bool:
    return _within(seconds_until(after, ~after.is_tracking | after.is_found), _REPORTED_S)


def _false_alarm_rate(
    befores: list[JudgedFlight], is_inside: Callable[[FloatArray], Mask] = lambda distance_m: distance_m >= 0.0
) -> float | None:
    settled = [
        before.part((before.times_s - before.times_s[0] > _SETTLED_S) & is_inside(before.distance_m))
        for before in befores
    ]
    return share(~pooled(settled).is_tracking) if settled else None
