"""``monoloc bench recovery``, ``faults``, ``fly``, ``soak`` and ``stop``: flights in which something happens."""

from __future__ import annotations

import tempfile
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, get_args

import cv2
import typer

from monoloc.bundle import read_bundle
from monoloc.cli.common import (
    FramesOption,
    JsonOption,
    SeedOption,
    SourceArgument,
    open_source,
    print_figures,
    print_json,
    print_table,
    stderr,
    text_of,
    warn,
)
from monoloc.cli.output_checks import check_folder
from monoloc.errors import SettingError
from monoloc.extras import require_extra
from monoloc.fusion.reference_poses import NEAR_M
from monoloc.mavlink.firmware import Firmware
from monoloc.progress import ConsoleProgress
from monoloc.supervision.state import State
from monoloc_lab.bench.fault_flights import FaultFigures, bench_faults
from monoloc_lab.bench.faults import FAULTS
from monoloc_lab.bench.judged_flight import REFUSED
from monoloc_lab.bench.recovery import bench_recovery
from monoloc_lab.bench.stopping import bench_stops, check_room, rendered_approaches
from monoloc_lab.rooms import TESTS
from monoloc_lab.soak.live_flight import bench_live_flight
from monoloc_lab.soak.many_steps import bench_soak

_OTHER_ROOM = f"folder:{TESTS['L1']}"

BundleArgument = Annotated[Path, typer.Argument(metavar="BUNDLE", help="A bundle of the recording's room.")]


def recovery(
    bundle: BundleArgument,
    source: SourceArgument,
    frames: FramesOption = "::",
    kidnaps: Annotated[int, typer.Option("--kidnaps", min=0, help="Number of kidnaps.")] = 30,
    starts: Annotated[int, typer.Option("--starts", min=0, help="Number of starts without a pose.")] = 30,
    map_edits: Annotated[int, typer.Option("--map-edits", min=0, help="Number of edited maps.")] = 20,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Kidnap the camera, start it without a pose, and edit its map, over frames that were not used in the build.

    \b
    Examples:
      monoloc bench recovery kitchen.monoloc 7scenes:redkitchen
      monoloc bench recovery kitchen.monoloc 7scenes:redkitchen --kidnaps 100 --json
    """
    room, recording = read_bundle(bundle), open_source(source, frames)
    figures = bench_recovery(room, recording, kidnaps, starts, map_edits, seed, ConsoleProgress(stderr))
    if starts and not figures.supports_starts:
        stderr.print(f"{bundle} does not support starts without a pose, so none of them counts as found")
    rates = [each for each in (figures.global_start_rate, figures.kidnap_recovery_rate) if each is not None]
    if rates and not any(rates):
        asks = f"monoloc check {bundle} {source} shows whether it is another room"
        warn(source, f"the camera was found after no start and no kidnap; {asks}")
    content = asdict(figures)
    if json:
        print_json(content)
    else:
        regions = {name: content.pop(name) for name in ("near", "away")}
        print_figures("monoloc bench recovery", content, json=False)
        rows = [[name, *map(text_of, figures.values())] for name, figures in regions.items()]
        print_table(f"within and beyond {NEAR_M} m of the build's frames", ["", *regions["near"]], rows)


def faults(
    bundle: BundleArgument,
    source: SourceArgument,
    frames: FramesOption = "::",
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME", help=f"One of {', '.join(FAULTS)}; may be repeated. [all]"),
    ] = None,
    other: Annotated[
        str | None,
        typer.Option("--other", metavar="SOURCE", help="A recording of another room. [the rendered room]"),
    ] = None,
    flights: Annotated[int, typer.Option("--flights", min=1, help="Number of flights with each fault.")] = 2,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Let the camera fail in the middle of flights over frames that were not used in the build.

    \b
    Examples:
      monoloc bench faults kitchen.monoloc 7scenes:redkitchen
      monoloc bench faults kitchen.monoloc 7scenes:redkitchen --only black --only frozen --json
    """
    names = _fault_names(only)
    room, recording = read_bundle(bundle), open_source(source, frames)
    elsewhere = open_source(other or _OTHER_ROOM, "::")
    figures = bench_faults(room, recording, elsewhere, names, flights, seed, ConsoleProgress(stderr))
    if figures.left_out:
        stderr.print(f"too few unseen frames in a row, so these are left out: {', '.join(figures.left_out)}")
    if json:
        print_json(asdict(figures))
        return
    for when, seconds in (("in", "said after"), ("after", "recovery")):
        columns = ["", "frames", "silent", seconds, "coverage"]
        rows = [_row(name, each, is_after=when == "after") for name, each in figures.faults.items()]
        print_table(f"Frames {when} the fault: {' / '.join(get_args(State))} / refused", columns, rows)
    totals = figures.totals
    stderr.print(
        f"{totals.silent_frames} of {totals.frames} frames are silent, {totals.silent_frames_blind} of them later "
        "than 1 s into black, frozen, other-room or mirrored"
    )


def _fault_names(only: list[str] | None) -> list[str]:
    unknown = [name for name in only or () if name not in FAULTS]
    if unknown:
        raise SettingError("--only", f"is {unknown[0]!r}", f"name one of {', '.join(FAULTS)}")
    return [name for name in FAULTS if not only or name in only]


def _row(name: str, figures: FaultFigures, is_after: bool) -> list[str]:
    part, seconds = (figures.after, figures.recovery_s) if is_after else (figures.during, figures.reported_s)
    return [
        name,
        " / ".join(str(part.states.get(state, 0)) for state in (*get_args(State), REFUSED)),
        str(part.silent_frames),
        "-" if seconds is None else f"{seconds:.1f} s",
        "-" if part.coverage_95 is None else f"{100.0 * part.coverage_95:.0f} %",
    ]


def fly(
    bundle: BundleArgument,
    source: SourceArgument,
    frames: FramesOption = "::",
    seconds: Annotated[float, typer.Option("--seconds", min=15.0, help="Undisturbed flight.")] = 60.0,
    rate_hz: Annotated[float, typer.Option("--rate-hz", min=1.0, max=120.0, help="Images a second.")] = 30.0,
    firmware: Annotated[Firmware, typer.Option("--firmware", help="Firmware that is simulated.")] = Firmware.PX4,
    json: JsonOption = False,
) -> None:
    """Fly a recording live, over sockets, and lose camera, link and process on the way.

    It needs Linux.

    \b
    Examples:
      monoloc bench fly kitchen.monoloc 7scenes:redkitchen --frames 0:400
      monoloc bench fly kitchen.monoloc 7scenes:redkitchen --firmware ardupilot --json
    """
    camera = open_source(source, frames).camera
    require_extra("mavlink")
    require_extra("stream")
    with tempfile.TemporaryDirectory() as folder:
        figures = bench_live_flight(
            bundle, source, frames, camera, seconds, rate_hz, firmware, Path(folder), stderr.print
        )
    content = asdict(figures)
    if not json:  # how often the pilot read each text, and a line for each recording
        killed, after = content["recordings"]
        content |= {"texts": dict(Counter(figures.texts)), "recordings": {"killed": killed, "after": after}}
    print_figures(f"{bundle}, {source}", content, json)


def soak(
    bundle: BundleArgument,
    source: SourceArgument,
    frames: FramesOption = "::",
    steps: Annotated[int, typer.Option("--steps", min=200, help="Number of steps.")] = 100_000,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Take very many steps with one localizer, and measure whether its memory or its time grow.

    It needs Linux. Small images make it quick.

    \b
    Examples:
      monoloc bench soak living.monoloc folder:living --steps 20000
      monoloc bench soak kitchen.monoloc 7scenes:redkitchen --frames 0:300 --json
    """
    room, recording = read_bundle(bundle), open_source(source, frames)
    cv2.setNumThreads(1)  # as in a flight
    with ConsoleProgress(stderr).task("soak", steps) as show:
        content = asdict(bench_soak(room, recording, steps, seed, show))
    print_figures(f"{bundle}, {source}", content, json)


def stop(
    bundle: Annotated[
        Path, typer.Argument(metavar="BUNDLE", help="A bundle of the rendered living room of monoloc demo.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder that keeps the renderings.")],
    mapped: Annotated[int, typer.Option("--mapped", min=1, help="Approaches to what is in the map.")] = 20,
    new: Annotated[int, typer.Option("--new", min=0, help="Approaches to an obstacle that is not.")] = 5,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Let a simulated drone stop before obstacles in the rendered living room, in three lights.

    It needs the extra synth of monoloc-lab, and renders for ten minutes or more the first time.

    \b
    Examples:
      monoloc bench stop living.monoloc --out approaches
      monoloc bench stop living.monoloc --out approaches --mapped 4 --new 2 --json
    """
    check_folder(out, "--out")
    room = read_bundle(bundle)
    check_room(room, bundle)
    progress = ConsoleProgress(stderr)
    figures = bench_stops(room, rendered_approaches(mapped, new, seed, out, progress), seed, progress)
    if json:
        print_json(asdict(figures))
        return
    for light, each in figures.lights.items():
        kinds = (("mapped", each.mapped, each.mapped_errors), ("new", each.new, each.new_errors))
        for name, stops, errors in kinds:
            if stops is None:
                continue
            rows = [
                [f"{bin_m} m", str(of.sectors)]
                + [f"{100 * e.median:+.0f} %, {100 * e.missed_rate:.0f} %" for e in (of.frame, of.live, of.joined)]
                for bin_m, of in errors.items()
            ]
            title = (
                f"{light}, {name}: {stops.stops} of {stops.approaches} stopped, {stops.stops_by_distance} by distance"
            )
            print_table(title, ["true distance", "sectors", "frame", "last second", "with the map"], rows)
    stderr.print("median error, and share of sectors that are measured 30 % farther or more")
