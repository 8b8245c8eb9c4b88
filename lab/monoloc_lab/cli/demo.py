"""``monoloc demo``: localise in the rendered room of the package, with its shipped bundle or one that is built."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.text import Text

from monoloc.bundle import Bundle, read_bundle
from monoloc.cli.common import (
    JsonOption,
    SeedOption,
    ViewOption,
    open_source,
    print_json,
    print_table,
    stderr,
)
from monoloc.cli.localize import draw
from monoloc.cli.output_checks import check_folder, check_viewing
from monoloc.depth.models import DEFAULT
from monoloc.errors import DataError
from monoloc.extras import require_extra
from monoloc.io.tum_trajectory import write_tum
from monoloc.progress import ConsoleProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from monoloc.viz.viewer import run_viewer
from monoloc_lab.make.demo_bundle import LIVING, RoomBuild
from monoloc_lab.rooms import BUNDLE, TESTS

_RECORDED = "7scenes/redkitchen"


@dataclass(frozen=True)
class _Flight:
    """One run: its light, frames and depth."""

    name: str
    light: str | None
    source: str
    adapted: bool
    frames: str = "::"
    sensor_depth: bool = False


@dataclass(frozen=True)
class _Demo:
    """The runs, and the build before them; None for the shipped bundle."""

    title: str
    flights: tuple[_Flight, ...]
    build: RoomBuild | None


def demo(
    data: Annotated[
        Path | None,
        typer.Option("--data", help=f"A folder with {_RECORDED}, to use that real room instead.", show_default=False),
    ] = None,
    build: Annotated[
        bool, typer.Option("--build", help="Build the room anew, with and without adaptation (minutes, PyTorch).")
    ] = False,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for bundles, trajectories and plots.")] = Path(
        "demo-output"
    ),
    view: ViewOption = False,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Localise a flight through a rendered room in three lights.

    Room, flight and the room's bundle are part of the package. With --build, the bundle is built from another flight,
    and the flight is localised by an unadapted bundle, too. With --data, the room is a real kitchen, built with the
    default settings.

    \b
    Examples:
      monoloc demo
      monoloc demo --view
      monoloc demo --build
      monoloc demo --data ~/recordings --out kitchen --json
    """
    started = time.perf_counter()
    study = _recorded(data) if data is not None else _living(build)
    check_folder(out, "--out")
    require_extra("report")
    check_viewing(view, instead="leave it out")
    out.mkdir(exist_ok=True)
    bundles = _bundles(study.build, out, seed)
    runs = [(flight, _run(flight, bundles[flight.adapted], seed, out, view).metrics()) for flight in study.flights]
    seconds = time.perf_counter() - started
    if json:
        described = [{"name": t.name, "light": t.light, "adapted": t.adapted, **figures} for t, figures in runs]
        print_json({"runs": described, "seconds": seconds, "output": str(out)})
        return
    print_table(
        f"{study.title}; errors on unseen frames",
        ["", "median", "RMSE", "rotation", "coverage", "depth", "ms/frame"],
        [[flight.name, *_row(figures)] for flight, figures in runs],
    )
    written = "plots and trajectories" if study.build is None else "plots, trajectories and bundles"
    stderr.print(f"{seconds:.0f} s; {written}: {out.resolve()}", soft_wrap=True)


def _living(build: bool) -> _Demo:
    flights = tuple(
        _Flight(f"{light} {'adapted' if adapted else 'unadapted'}", light, f"folder:{source}", adapted)
        for light, source in TESTS.items()
        for adapted in ((False, True) if build else (True,))
    )
    origin = "built in L2 from one flight" if build else "shipped bundle, built in L2 from one flight"
    return _Demo(f"rendered living room: {origin}, localised on another", flights, LIVING if build else None)


def _recorded(data: Path) -> _Demo:
    room = data / _RECORDED
    if not room.is_dir():
        raise DataError(room, "does not exist", f"give --data a folder with {_RECORDED}, or leave it out")
    source, build, run = f"7scenes:{room}", "0:400:4", "0:400"
    flights = (
        _Flight("unadapted", None, source, False, run),
        _Flight("adapted", None, source, True, run),
        _Flight("sensor depth (bound)", None, source, False, run, sensor_depth=True),
    )
    title = f"{_RECORDED}: built from frames {build}, localised on {run}"
    return _Demo(title, flights, RoomBuild(source, build, DEFAULT, {}))


def _bundles(build: RoomBuild | None, out: Path, seed: int) -> dict[bool, Bundle]:
    """Bundles by whether they are adapted."""
    if build is None:
        return {True: read_bundle(BUNDLE)}
    names = {False: "plain.monoloc", True: "adapted.monoloc"}
    return {adapted: build.write(out / name, adapted, seed) for adapted, name in names.items()}


def _run(flight: _Flight, bundle: Bundle, seed: int, out: Path, view: bool) -> Run:
    stderr.print(Text.assemble(("localize", "bold"), f" {flight.name}"))
    recording = open_source(flight.source, flight.frames)
    assert recording.poses is not None
    rng = np.random.default_rng(seed)
    start = Start.disturbed(recording.poses[0], rng)
    progress = ConsoleProgress(stderr)
    with run_viewer(flight.name, view, None) as viewer:
        run = localize(bundle, recording, start, rng, progress, flight.sensor_depth, viewer=viewer)
    stem = out / flight.name.split(" (")[0].replace(" ", "-")
    write_tum(stem.with_suffix(".txt"), recording.timestamps_s, run.poses)
    draw(stem.with_suffix(".png"), run, bundle, flight.name)
    return run


def _row(figures: dict[str, Any]) -> list[str]:
    return [
        f"{100 * figures['unseen_ate_median_m']:.1f} cm",
        f"{100 * figures['unseen_ate_rmse_m']:.1f} cm",
        f"{figures['unseen_rot_median_deg']:.1f}°",
        f"{100 * figures['unseen_coverage_95']:.0f} %",
        f"{100 * figures['unseen_depth_absrel']:.1f} %",
        f"{figures['step_ms_median']:.1f}",
    ]
