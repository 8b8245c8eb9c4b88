"""Days in a room whose furniture is moved: a map that learns from each day's flight, and one that does not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from monoloc.adapt.settings import AdaptConfig
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import Bundle
from monoloc.evaluation.consistency import consistency
from monoloc.geometry import FloatArray
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Recording
from monoloc.io.registry import open_recording
from monoloc.progress import NoProgress, Progress
from monoloc.run import localize
from monoloc.start import Start
from monoloc.supervision.state import VOUCHED_FOR
from monoloc.updating.apply_update import applied
from monoloc.updating.observed_flight import ObservedFlight, observe
from monoloc.updating.proposals import Proposal, proposals
from monoloc.updating.room_evidence import Evidence
from monoloc_lab.rooms import TESTS
from monoloc_lab.synth.changing_room import changed, flown, plan_round, render_round
from monoloc_lab.synth.layout import generate_room

_BUILD = BuildConfig(adapt=AdaptConfig(tune="none", map_transform=False))


@dataclass(frozen=True)
class Days:
    """Recordings of the days, in one world.

    Attributes:
        moved: names of what was moved before each day's flight.
        build: of the round before anything was moved.
        flights: of each day, at least one.
        test: another flight on the last day.
        fresh: of the round on the last day, as the build.
        other_room: of a flight elsewhere.
    """

    moved: list[list[str]]
    build: Recording
    flights: list[list[Recording]]
    test: Recording
    fresh: Recording
    other_room: Recording


@dataclass(frozen=True)
class ErrorFigures:
    """Errors of some flights.

    Attributes:
        median_m, rmse_m: of the positions of all frames.
        vouched_for: frames that were *tracking* or *map-changed*.
        silent: those of them that were more than 30 cm off.
    """

    median_m: float
    rmse_m: float
    frames: int
    vouched_for: int
    silent: int


@dataclass(frozen=True)
class DayFigures:
    """One day: what was moved, how the day's first flight went on both maps before the update, and what was updated.

    Attributes:
        refusal: why flights of the day added no evidence; None if all did.
        usable_frames: of all flights of the day.
        applied: number of landmarks or voxels that each kind of proposal changed.
        undo_bytes: that the day's edits take.
    """

    moved: list[str]
    never_updated: ErrorFigures
    updated: ErrorFigures
    refusal: str | None
    usable_frames: int
    applied: dict[str, int]
    undo_bytes: int


@dataclass(frozen=True)
class AgeingFigures:
    """JSON keys of ``monoloc bench ageing``.

    Attributes:
        days: in order.
        never_updated, updated, fresh: on the last day's test flight, of the three maps.
        poisoned: refusal of the other room's flight, and whether it changed the evidence.
        landmarks: of the built, the updated and the fresh map.
    """

    days: list[DayFigures]
    never_updated: ErrorFigures
    updated: ErrorFigures
    fresh: ErrorFigures
    poisoned: str | None
    poison_changed: bool
    landmarks: tuple[int, int, int]


def rendered_days(days: int, moves: int, flights: int, seed: int, out: Path, progress: Progress) -> Days:
    """Render the days; what an earlier call rendered is reused.

    Args:
        moves: objects that are moved before each day.
        flights: of each day.

    Raises:
        MissingExtraError: Mitsuba is not installed.
        SettingError: the room has no space for the round, or for the moves.
    """
    out.mkdir(exist_ok=True)
    room = generate_room(seed)
    planned = plan_round(room, seed)
    build = render_round(room, planned, 0, out / "day-00", progress)
    moved, flown_on = list[list[str]](), list[list[Recording]]()
    for day in range(1, days + 1):
        room, names = changed(room, planned, moves, np.random.default_rng((seed, 1, day)))
        moved.append(names)
        flown_on.append([])
        for flight in range(flights):
            name, key = (f"day-{day:02d}-{flight}", (day, flight)) if flight else (f"day-{day:02d}", (day,))
            today = flown(planned, np.random.default_rng((seed, 2, *key)))
            noise = flight * (days + 3) + day
            flown_on[-1].append(_opened(render_round(room, today, noise, out / name, progress)))
    again = flown(planned, np.random.default_rng((seed, 2, days + 1)))
    test = render_round(room, again, days + 1, out / "test", progress)
    fresh = render_round(room, planned, days + 2, out / "fresh", progress)
    return Days(moved, _opened(build), flown_on, _opened(test), _opened(fresh), _opened(TESTS["L1"]))


def bench_ageing(days: Days, is_sensor_depth: bool, starts: int, seed: int, progress: Progress) -> AgeingFigures:
    """Fly day after day.

    Args:
        is_sensor_depth: whether a depth sensor shows surfaces to the updates; else the network.
        starts: flights on each map, each from another start.
        seed: of builds, starts and localizers.
    """
    rng = np.random.default_rng((seed, 0xA6E))
    built, fresh = (build_bundle(each, _BUILD, seed)[0] for each in (days.build, days.fresh))
    bundle, evidence = built, Evidence.none(built)
    figures = []
    poisoned, poison_changed = None, False
    with progress.task("days", len(days.flights)) as show:
        for day, (moved, recordings) in enumerate(zip(days.moved, days.flights, strict=True), start=1):
            never_updated, updated = (_errors(each, recordings[0], starts, seed) for each in (built, bundle))
            if day == (len(days.flights) + 1) // 2:
                flight = observe(bundle, days.other_room, None, False, frozenset(), rng, NoProgress())
                poisoned = flight.refusal
                poison_changed = evidence.after_flight(bundle, flight, False, rng) is not evidence
            count, refusals, usable, changes = len(bundle.edits), [], 0, Counter[str]()
            for recording in recordings:
                flight, proposed, bundle, evidence = _flight_applied(
                    bundle, evidence, recording, is_sensor_depth, rng
                )
                refusals += [flight.refusal] if flight.refusal else []
                usable += len(flight.frames)
                for each in proposed:
                    changes[each.kind] += len(each.members)
            figures.append(
                DayFigures(
                    moved=moved,
                    never_updated=never_updated,
                    updated=updated,
                    refusal="; ".join(refusals) or None,
                    usable_frames=usable,
                    applied=dict(sorted(changes.items())),
                    undo_bytes=sum(len(edit.undo) for edit in bundle.edits[count:]),
                )
            )
            show(day)
    never_updated, updated, afresh = (_errors(each, days.test, starts, seed) for each in (built, bundle, fresh))
    return AgeingFigures(
        days=figures,
        never_updated=never_updated,
        updated=updated,
        fresh=afresh,
        poisoned=poisoned,
        poison_changed=poison_changed,
        landmarks=(len(built.landmarks), len(bundle.landmarks), len(fresh.landmarks)),
    )


def _flight_applied(
    bundle: Bundle,
    evidence: Evidence,
    recording: Recording,
    is_sensor_depth: bool,
    rng: np.random.Generator,
) -> tuple[ObservedFlight, list[Proposal], Bundle, Evidence]:
    """A flight, all that is proposed after it, and bundle and evidence with that applied."""
    known = frozenset(evidence.frames)
    flight = observe(bundle, recording, None, is_sensor_depth, known, rng, NoProgress())
    evidence = evidence.after_flight(bundle, flight, is_sensor_depth, rng)
    proposed = proposals(evidence, bundle)
    return flight, proposed, *applied(bundle, evidence, proposed, rng)


def as_json(figures: AgeingFigures) -> dict[str, object]:
    """The figures, and the ratio of the updated map's errors to the fresh one's."""
    ratio = {
        "median_ratio": figures.updated.median_m / figures.fresh.median_m,
        "rmse_ratio": figures.updated.rmse_m / figures.fresh.rmse_m,
    }
    return {**asdict(figures), **ratio}


def _opened(path: Path) -> Recording:
    return open_recording(f"folder:{path}", ReaderOptions())


def _errors(bundle: Bundle, recording: Recording, starts: int, seed: int) -> ErrorFigures:
    """Of flights from disturbed starts, pooled."""
    poses = recording.poses
    assert poses is not None
    position_m, states, far = [], list[str](), list[bool]()
    for number in range(starts):
        rng = np.random.default_rng((seed, number))
        run = localize(bundle, recording, Start.disturbed(poses[0], rng), rng, NoProgress())
        errors = consistency(run.poses, poses, run.covariances)
        position_m.append(errors.position_m)
        states += run.states
        far += errors.is_far.tolist()
    return _figures(np.concatenate(position_m), states, far)


def _figures(position_m: FloatArray, states: Sequence[str], far: Sequence[bool]) -> ErrorFigures:
    vouched_for = [state in VOUCHED_FOR for state in states]
    return ErrorFigures(
        median_m=float(np.median(position_m)),
        rmse_m=float(np.sqrt(np.mean(position_m**2))),
        frames=len(states),
        vouched_for=sum(vouched_for),
        silent=sum(said and is_far for said, is_far in zip(vouched_for, far, strict=True)),
    )
