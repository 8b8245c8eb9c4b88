"""``monoloc demo``: build, adapt and localise in the rendered room of the package."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.text import Text

from monoloc.adapt.settings import Tune
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.cli.common import (
    JsonOption,
    SeedOption,
    ViewOption,
    check_folder,
    check_viewing,
    open_source,
    print_json,
    print_table,
    stderr,
)
from monoloc.cli.localize import draw
from monoloc.config import override
from monoloc.depth.models import DEFAULT
from monoloc.errors import DataError
from monoloc.extras import require_plotting
from monoloc.io.tum_trajectory import write_tum
from monoloc.progress import ConsoleProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from monoloc.viz.viewer import run_viewer
from monoloc_lab.rooms import BUILD, TESTS

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
    """The build and the runs.

    Attributes:
        network, adapt: of the build; the rendered room takes fewer steps than the default, to be faster.
    """

    title: str
    source: str
    frames: str
    network: str
    adapt: dict[str, object]
    flights: tuple[_Flight, ...]


def demo(
    data: Annotated[
        Path | None,
        typer.Option("--data", help=f"A folder with {_RECORDED}, to use that real room instead.", show_default=False),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for bundles, trajectories and plots.")] = Path(
        "demo-output"
    ),
    view: ViewOption = False,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Build a map of a room, adapt a network to it, and localise another flight, in bright, medium and dim light.

    The room is rendered and part of the package. With --data it is a real kitchen, with the default settings.

    \b
    Examples:
      monoloc demo
      monoloc demo --view
      monoloc demo --data ~/recordings --out kitchen --json
    """
    started = time.perf_counter()
    study = _embedded() if data is None else _recorded(data)
    check_folder(out, "--out")
    require_plotting()
    check_viewing(view)
    out.mkdir(exist_ok=True)
    bundles = {adapted: _build(study, adapted, out, seed) for adapted in (False, True)}
    runs = [(flight, _run(flight, bundles[flight.adapted], seed, out, view).metrics()) for flight in study.flights]
    seconds = time.perf_counter() - started
    if json:
        described = [{"name": t.name, "light": t.light, "adapted": t.adapted, **figures} for t, figures in runs]
        print_json({"runs": described, "seconds": seconds, "output": str(out)})
        return
    print_table(
        f"{study.title}; errors on unseen frames",
        ["", "median", "RMSE", "rotation", "coverage", "depth error", "ms per frame"],
        [[flight.name, *_row(figures)] for flight, figures in runs],
    )
    stderr.print(f"{seconds:.0f} s; plots, trajectories and bundles: {out.resolve()}")


def _embedded() -> _Demo:
    flights = tuple(
        _Flight(f"{light} {'adapted' if adapted else 'unadapted'}", light, f"folder:{source}", adapted)
        for light, source in TESTS.items()
        for adapted in (False, True)
    )
    adapt: dict[str, object] = {"steps": 200, "synthesised_views": 300}
    title = "rendered living room: built in L2 from one flight, localised on another"
    return _Demo(title, f"folder:{BUILD}", "::2", "one-third-0.35", adapt, flights)


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
    return _Demo(f"{_RECORDED}: built from frames {build}, localised on {run}", source, build, DEFAULT, {}, flights)


def _build(study: _Demo, adapted: bool, out: Path, seed: int) -> Bundle:
    path = out / ("adapted.monoloc" if adapted else "plain.monoloc")
    tune: Tune = "all" if adapted else "none"
    stderr.print(Text.assemble(("build", "bold"), f" {path.name} (--tune {tune})"))
    adapt = {**study.adapt, "tune": tune, "map_transform": adapted}
    config = override(BuildConfig(), adapt=adapt, landmarks=adapted)
    recording = open_source(study.source, study.frames)
    bundle, _ = build_bundle(recording, config, seed, ConsoleProgress(stderr), network=study.network)
    write_bundle(path, bundle)
    return read_bundle(path)  # its map is rounded, so this is the bundle that remains


def _run(flight: _Flight, bundle: Bundle, seed: int, out: Path, view: bool) -> Run:
    stderr.print(Text.assemble(("localize", "bold"), f" {flight.name}"))
    recording = open_source(flight.source, flight.frames)
    assert recording.poses is not None
    rng = np.random.default_rng(seed)
    start = Start.disturbed(recording.poses[0], rng)
    progress = ConsoleProgress(stderr)
    with run_viewer(flight.name, view, None) as viewer:
        run = localize(bundle, recording, start, bundle.settings, rng, progress, flight.sensor_depth, viewer=viewer)
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
