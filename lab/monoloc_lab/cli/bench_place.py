"""``monoloc bench place``: a building of many rooms."""

from __future__ import annotations

import tempfile
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import cv2
import typer

from monoloc.cli.common import (
    JsonOption,
    SeedOption,
    print_figures,
    print_json,
    print_table,
    stderr,
    text_of,
)
from monoloc.cli.output_checks import check_folder
from monoloc.progress import ConsoleProgress
from monoloc_lab.bench.places import bench_place


def place(
    rooms: Annotated[int, typer.Option("--rooms", min=2, max=200, help="Number of rooms.")] = 20,
    work: Annotated[
        Path | None,
        typer.Option("--work", metavar="FOLDER", help="Keeps the bundles, which the next call does not build again."),
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Draw a building, record each room by itself, join them by measured doors, and fly through all of it.

    20 rooms take about 15 minutes of one core.

    \b
    Examples:
      monoloc bench place --rooms 3
      monoloc bench place --work building --json
    """
    if work is not None:
        check_folder(work, "--work")
        work.mkdir(exist_ok=True)
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() if work is None else nullcontext(work) as folder:
        figures = asdict(bench_place(rooms, seed, Path(folder), ConsoleProgress(stderr)))
    if json:
        print_json(figures)
        return
    sizes = figures.pop("sizes")
    print_figures("monoloc bench place", figures, json=False)
    print_table("Cost", list(sizes[0]), [[text_of(value) for value in size.values()] for size in sizes])
