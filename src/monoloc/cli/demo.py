"""``monoloc demo``: the main job on a real room, with a table and pictures at the end."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from monoloc.adapt.settings import Tune
from monoloc.build import BuildConfig, build_bundle
from monoloc.bundle import Bundle, write_bundle
from monoloc.cli.common import JsonOption, SeedOption, check_folder, open_source, print_json, print_table, stderr
from monoloc.cli.localize import draw
from monoloc.config import override
from monoloc.errors import DataError
from monoloc.extras import require_plotting
from monoloc.outputs.tum import write_tum
from monoloc.progress import ConsoleProgress
from monoloc.runs import Run, Start, disturbed, localize

_ROOM = "7scenes/redkitchen"
_BUILD_FRAMES, _RUN_FRAMES = "0:400:4", "0:400"
_START_ERROR_M, _START_ERROR_DEG = 0.10, 3.0


def demo(
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder of recordings. [MONOLOC_DATA, or ../shared/data]")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for bundles, trajectories and plots.")] = Path(
        "demo-output"
    ),
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Build a map of a real room, adapt the network to it, and localise: unadapted, adapted, with sensor depth.

    \b
    Examples:
      monoloc demo
      monoloc demo --data ~/recordings --out demo-output --json
    """
    room = (data or Path(os.environ.get("MONOLOC_DATA", "../shared/data"))) / _ROOM
    if not room.is_dir():
        raise DataError(room, "is not there", "give --data or set MONOLOC_DATA to a folder with 7scenes/redkitchen")
    check_folder(out, "--out")
    require_plotting()
    out.mkdir(exist_ok=True)
    source = f"7scenes:{room}"
    plain = _build(source, out / "plain.monoloc", "none", seed)
    adapted = _build(source, out / "adapted.monoloc", "all", seed)
    runs = {
        "unadapted": _run(source, plain, seed, out / "unadapted"),
        "adapted": _run(source, adapted, seed, out / "adapted"),
        "sensor depth (bound)": _run(source, plain, seed, out / "sensor", use_sensor_depth=True),
    }
    metrics = {name: run.metrics() for name, run in runs.items()}
    if json:
        print_json({"runs": metrics, "output": str(out)})
        return
    print_table(
        f"{_ROOM}: built from frames {_BUILD_FRAMES}, localised on {_RUN_FRAMES}; figures on unseen frames",
        ["depth", "median", "RMSE", "rotation", "in 5 cm, 5°", "depth error", "ms a frame"],
        [[name, *_row(figures)] for name, figures in metrics.items()],
    )
    stderr.print(f"plots, trajectories and bundles: {out.resolve()}")


def _build(source: str, path: Path, tune: Tune, seed: int) -> Bundle:
    stderr.print(f"[bold]build[/bold] {path.name} (--tune {tune})")
    config = override(BuildConfig(), adapt={"tune": tune, "map_transform": tune != "none"})
    bundle, _ = build_bundle(open_source(source, _BUILD_FRAMES), config, seed, ConsoleProgress(stderr))
    write_bundle(path, bundle)
    return bundle


def _run(source: str, bundle: Bundle, seed: int, stem: Path, use_sensor_depth: bool = False) -> Run:
    stderr.print(f"[bold]localize[/bold] {stem.name}")
    recording = open_source(source, _RUN_FRAMES)
    assert recording.poses is not None
    rng = np.random.default_rng(seed)
    start = Start(disturbed(recording.poses[0], _START_ERROR_M, np.deg2rad(_START_ERROR_DEG), rng))
    run = localize(bundle, recording, start, bundle.settings, rng, ConsoleProgress(stderr), use_sensor_depth)
    write_tum(stem.with_suffix(".txt"), recording.timestamps_s, run.poses)
    draw(stem.with_suffix(".png"), run, bundle, f"RedKitchen, {stem.name}")
    return run


def _row(figures: dict[str, Any]) -> list[str]:
    return [
        f"{100 * figures['unseen_ate_median_m']:.1f} cm",
        f"{100 * figures['unseen_ate_rmse_m']:.1f} cm",
        f"{figures['unseen_rot_median_deg']:.1f}°",
        f"{100 * figures['unseen_within_5cm_5deg']:.0f} %",
        f"{100 * figures['unseen_depth_absrel']:.1f} %",
        f"{figures['step_ms_median']:.1f}",
    ]
