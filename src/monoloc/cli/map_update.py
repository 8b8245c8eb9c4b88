"""``monoloc map update``: learn from flights where the room is no longer as the map says."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
import typer

from monoloc.bundle import Bundle, check_target, read_bundle, write_bundle
from monoloc.bundle_signature import SIGNATURE
from monoloc.cli.bundle_output import SIGNATURE_REMOVED, check_bundle_output, note_replaced
from monoloc.cli.common import (
    DepthScaleOption,
    FixDepthOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    SeedOption,
    note,
    open_source,
    print_json,
    print_table,
    say_written,
    stderr,
    warn,
)
from monoloc.cli.map_looking import warn_of_up
from monoloc.cli.output_checks import check_outputs, check_picture
from monoloc.cli.start_option import METAVAR, UNKNOWN, start_of
from monoloc.edit_record import Edit
from monoloc.editing.as_found import AsFound
from monoloc.editing.edit_history import drawn_edits
from monoloc.errors import DataError, SettingError
from monoloc.files import target_of
from monoloc.io.recording import Recording
from monoloc.level_map import T_map_world
from monoloc.map.surface import surface_points
from monoloc.printable import printable
from monoloc.progress import ConsoleProgress
from monoloc.start import START_ERROR_DEG, START_ERROR_M
from monoloc.updating.apply_update import applied
from monoloc.updating.observed_flight import ObservedFlight, observe
from monoloc.updating.proposals import Proposal, proposals
from monoloc.updating.room_evidence import Evidence, evidence_path, read_evidence, write_evidence
from monoloc.viz.update_drawing import UpdateView, plot_update

_DRAWN_POINTS = 60_000


def update(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="Bundle of the room.", show_default=False)],
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SOURCE",
            help="Recordings of flights; without any, the evidence of earlier ones is used.",
            show_default=False,
        ),
    ] = None,
    frames: FramesOption = "::",
    start: Annotated[
        str,
        typer.Option(
            "--start", metavar=METAVAR, help="First pose of the flights, or 'truth'. [the room is searched]"
        ),
    ] = UNKNOWN,
    depth: Annotated[
        Literal["predicted", "sensor"] | None,
        typer.Option("--depth", help="Depth of surfaces, by the network or a sensor. [sensor where there is one]"),
    ] = None,
    apply: Annotated[
        str | None, typer.Option("--apply", metavar="ID,...", help="Apply these proposals, by their ids.")
    ] = None,
    auto: Annotated[bool, typer.Option("--auto", help="Apply all proposals.")] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="PNG to write: what is proposed, and the map before and after.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Bundle to write. [the same]")] = None,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    fix_depth: FixDepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Propose edits where flights contradict a map, and apply them.

    Evidence is kept in NAME.evidence.npz beside the bundle, and adds up over calls.

    \b
    Examples:
      monoloc map update kitchen.monoloc folder:monday --plot change.png
      monoloc map update kitchen.monoloc folder:tuesday folder:wednesday
      monoloc map update kitchen.monoloc --apply 3f09ac,d1c2e7
      monoloc map update kitchen.monoloc folder:thursday --auto
    """
    given = sources or []
    target = out or bundle
    _check_choice(apply, auto, given)
    _check_outputs(bundle, out, plot, given)
    rng = np.random.default_rng(seed)
    found = AsFound.of(target_of(target), evidence_path(target_of(target)))
    room = read_bundle(bundle)
    if auto or apply is not None:
        check_target(target)  # before the flights are looked at, which takes minutes
    recordings = [open_source(source, frames, intrinsics, depth_scale, fix_depth=fix_depth) for source in given]
    if depth == "sensor":
        _check_depth(recordings)
    before = evidence = read_evidence(evidence_path(target_of(bundle)), room)
    cv2.setNumThreads(1)  # as in a flight
    flights = []
    for recording in recordings:
        is_sensor_depth = recording.has_depth if depth is None else depth == "sensor"
        first = None if recording.poses is None else recording.poses[0]
        begin = start_of(start, room, first, START_ERROR_M, float(np.deg2rad(START_ERROR_DEG)), rng)
        known = frozenset(evidence.frames)
        progress = ConsoleProgress(stderr)
        flight = observe(room, recording, begin, is_sensor_depth, known, rng, progress)
        evidence = evidence.after_flight(room, flight, is_sensor_depth, rng)
        flights.append(flight)
    proposed = proposals(evidence, room)
    chosen = proposed if auto else _chosen(proposed, apply)
    updated, left = applied(room, evidence, chosen, rng)
    was_signed = (target / SIGNATURE).is_file()
    unused = None if chosen else _none_used(flights)
    plot = plot if unused is None else None
    is_written = unused is None and (left is not before or out is not None)
    with found.held() if is_written else nullcontext():
        if plot is not None:  # first, so that a bundle is not replaced and then reported as failed
            shown = updated if chosen else applied(room, evidence, proposed, np.random.default_rng(seed))[0]
            _draw(plot, bundle.name, room, shown, proposed, "after" if chosen else "if all were applied", seed)
        if is_written:
            if chosen or out is not None:
                write_bundle(target, updated)
            write_evidence(evidence_path(target_of(target)), left, updated)
    if chosen and was_signed:
        note(target, SIGNATURE_REMOVED)
    _warn_of(updated.edits[len(updated.edits) - len(chosen) :], target)
    _print(target, flights, evidence, proposed, chosen, plot, json, 0 if unused is None else 1)
    if unused is not None:
        raise unused


def _warn_of(edits: Sequence[Edit], bundle: Path) -> None:
    for edit in edits:
        for warning in edit.record.changes.get("warnings", []):
            warn(bundle, warning)


def _none_used(flights: Sequence[ObservedFlight]) -> DataError | None:
    """What is wrong with the flights, if not one of them could be used."""
    if not flights or any(flight.refusal is None for flight in flights):
        return None
    others = "" if len(flights) == 1 else f", and none of the other flights can be used ({len(flights) - 1})"
    return DataError(flights[0].name, f"{flights[0].refusal}{others}", flights[0].fix)


def _check_outputs(bundle: Path, out: Path | None, plot: Path | None, sources: list[str]) -> None:
    if out is not None:
        check_bundle_output(out, sources)
        if target_of(out) != target_of(bundle):
            note_replaced(out, evidence_path(target_of(out)))
    check_outputs({"--plot": plot}, (bundle, *sources))
    check_picture(plot, "--plot")
    evidence = evidence_path(target_of(out or bundle))
    if sources and evidence.parent.is_dir() and not os.access(evidence.parent, os.W_OK):
        fix = "copy the bundle to a folder that you can write to"
        raise DataError(evidence, "what flights show cannot be written there", fix)


def _check_depth(recordings: Sequence[Recording]) -> None:
    for recording in recordings:
        if not recording.has_depth:
            raise SettingError("--depth", f"is sensor, but {recording.name} has no depth", "leave it out")


def _check_choice(apply: str | None, auto: bool, sources: list[str]) -> None:
    if apply is None:
        return
    if auto:
        raise SettingError("--apply", "is given together with --auto", "give one of them")
    if sources:
        problem = "chooses from a list that these recordings change"
        raise SettingError("--apply", problem, "look at the new list first: leave --apply out")


def _chosen(proposed: list[Proposal], apply: str | None) -> list[Proposal]:
    ids = [] if apply is None else [part.strip() for part in apply.split(",")]
    by_id = {each.id: each for each in proposed}
    for name in ids:
        if name not in by_id:
            fix = "list them again: leave --apply out" if proposed else "fly again: nothing is proposed"
            raise SettingError("--apply", f"has {name!r}, which is the id of no current proposal", fix)
    return [by_id[name] for name in dict.fromkeys(ids)]


def _draw(
    path: Path, name: str, before: Bundle, after: Bundle, proposed: list[Proposal], which: str, seed: int
) -> None:
    first, second = (
        UpdateView(
            f"{name}, {title}",
            surface_points(room.original, _DRAWN_POINTS, np.random.default_rng(seed)),
            room.landmarks.points.astype(np.float64),
            drawn_edits(room, np.random.default_rng(seed)),
        )
        for title, room in (("before", before), (which, after))
    )
    warn_of_up(before, name)
    plot_update(
        path,
        first,
        second,
        [(each.id, each.kind, each.points) for each in proposed],
        T_map_world(before),
    )


def _print(
    target: Path,
    flights: list[ObservedFlight],
    evidence: Evidence,
    proposed: list[Proposal],
    chosen: list[Proposal],
    plot: Path | None,
    json: bool,
    skipped: int,
) -> None:
    """Print what an update comes to, without a line of the first ``skipped`` flights, which an error names."""
    used = {id(each) for each in chosen}
    if json:
        print_json(
            {
                "bundle": str(target),
                "flights": [
                    {
                        "name": each.name,
                        "usable_frames": len(each.frames),
                        "states": each.states,
                        "refusal": each.refusal,
                        "fix": each.fix or None,
                    }
                    for each in flights
                ],
                "counted_flights": len(evidence.flights),
                "proposals": [{**each.described(), "applied": id(each) in used} for each in proposed],
                "picture": None if plot is None else str(plot),
            }
        )
        return
    for flight in flights[skipped:]:
        usable, refused = f"{len(flight.frames)} usable frames", f"refused: {flight.refusal}; {flight.fix}"
        said = usable if flight.refusal is None else refused
        stderr.print(f"{flight.name}: {said}", soft_wrap=True)
    say_written(plot)
    rows = [
        [
            f"{each.id}\napplied" if id(each) in used else each.id,
            each.kind,
            str(len(each.members)),
            *("\n".join(f"{value:.2f}" for value in corner) for corner in (each.lower, each.upper)),
            f"{each.agreeing:.0f} of {each.views:.0f}",
            str(each.flights),
            f"{each.odds:.0f}",
        ]
        for each in proposed
    ]
    if not proposed:
        typer.echo(
            f"{printable(str(target))}: no change is proposed; flights counted so far: {len(evidence.flights)}"
        )
        return
    title = f"{target}: proposals; flights counted so far: {len(evidence.flights)}"
    print_table(title, ["id", "what", "number", "from (m)", "to (m)", "views", "flights", "odds"], rows)
