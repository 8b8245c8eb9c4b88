"""``monoloc bench ageing``: days in a room whose furniture is moved."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import typer

from monoloc.cli.common import (
    JsonOption,
    SeedOption,
    print_json,
    print_table,
    stderr,
)
from monoloc.cli.output_checks import check_folder
from monoloc.progress import ConsoleProgress
from monoloc_lab.bench.ageing import ErrorFigures, as_json, bench_ageing, rendered_days


def ageing(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder that keeps the renderings.")],
    days: Annotated[int, typer.Option("--days", min=1, max=100, help="Number of days.")] = 10,
    moves: Annotated[int, typer.Option("--moves", min=0, help="Objects that are moved before each day.")] = 3,
    flights: Annotated[int, typer.Option("--flights", min=1, help="Flights a day that update the map.")] = 1,
    room: Annotated[
        int, typer.Option("--room", min=0, help="Seed of the room, of what is moved and of flights.")
    ] = 4,
    sensor: Annotated[bool, typer.Option("--sensor", help="Updates see surfaces by a depth sensor.")] = False,
    starts: Annotated[int, typer.Option("--starts", min=1, help="Flights on each map, from other starts.")] = 2,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Move furniture day by day, update the map from each day's flights, and compare it with a fresh build.

    It needs the extra synth of monoloc-lab, and LLVM 17 or newer to render in minutes.

    \b
    Examples:
      monoloc bench ageing --out days
      monoloc bench ageing --out days --room 2 --days 5 --sensor --json
    """
    check_folder(out, "--out")
    progress = ConsoleProgress(stderr)
    recordings = rendered_days(days, moves, flights, room, out, progress)
    cv2.setNumThreads(1)  # as in a flight
    figures = bench_ageing(recordings, sensor, starts, seed, progress)
    if json:
        print_json(as_json(figures))
        return
    rows = [
        [
            str(number),
            ", ".join(day.moved),
            _text(day.never_updated),
            _text(day.updated),
            day.refusal or ", ".join(f"{count} {kind}" for kind, count in day.applied.items()),
        ]
        for number, day in enumerate(figures.days, start=1)
    ]
    columns = ["day", "moved", "never updated", "updated", "then applied"]
    print_table("Median and RMSE of the day's flight before the update; frames not vouched for", columns, rows)
    last = [
        [name, _text(each), str(count)]
        for name, each, count in zip(
            ("never updated", "updated", "fresh build"),
            (figures.never_updated, figures.updated, figures.fresh),
            figures.landmarks,
            strict=True,
        )
    ]
    print_table("Another flight on the last day", ["map", "error", "landmarks"], last)
    stderr.print(f"the other room's flight is refused: {figures.poisoned}", soft_wrap=True)


def _text(errors: ErrorFigures) -> str:
    missing = errors.frames - errors.vouched_for
    return f"{100 * errors.median_m:.1f}, {100 * errors.rmse_m:.1f} cm; {missing} of {errors.frames}"
