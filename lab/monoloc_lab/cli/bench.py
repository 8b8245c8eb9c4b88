"""``monoloc bench``: how fast it is here, against what one would use in its place."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.pipeline import build_bundle
from monoloc.builder.room_map import room_cloud
from monoloc.bundle import read_bundle, write_bundle
from monoloc.cli.common import (
    FramesOption,
    JsonOption,
    SeedOption,
    SourceArgument,
    open_source,
    print_json,
    print_table,
    refuse_frames,
    stderr,
    text_of,
)
from monoloc.config import override
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.recording import Selection
from monoloc.progress import ConsoleProgress
from monoloc_lab.bench.fitting import FitFigures, FitSizes, bench_fit
from monoloc_lab.bench.kernels import KernelFigures, KernelSizes, bench_kernels
from monoloc_lab.bench.scenes import made_up_cloud
from monoloc_lab.bench.whole_step import PipelineFigures, bench_pipeline

app = typer.Typer(
    help="Measure speed, against what one would use in its place.", no_args_is_help=True, rich_markup_mode=None
)

KERNEL_SIZES, FIT_SIZES = KernelSizes(), FitSizes()
_NETWORK = "one-third-0.35-int8"
_CLOUD_POINTS = 60_000  # of the room that is made where no recording is given
_BUILD_EVERY, _FEWEST_BUILD_FRAMES = 4, 10  # a bundle is built from every so many frames, if that leaves enough

RoomArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="[SOURCE]", help="A recording with depth, whose room is the map. [a made-up room]", show_default=False
    ),
]


@app.command()
def kernels(
    source: RoomArgument = None, frames: FramesOption = "::", seed: SeedOption = 0, json: JsonOption = False
) -> None:
    """Time the weighing of 1000 particles on 200 scan points, for maps of 200 to 100,000 components.

    \b
    Examples:
      monoloc bench kernels
      monoloc bench kernels 7scenes:redkitchen --frames ::4 --json
    """
    rng = np.random.default_rng(seed)
    _show(bench_kernels(_cloud(source, frames, rng), KERNEL_SIZES, rng, ConsoleProgress(stderr)), json)


@app.command("map")
def map_(
    source: RoomArgument = None, frames: FramesOption = "::", seed: SeedOption = 0, json: JsonOption = False
) -> None:
    """Time the fit of a map of 200 components to 40,000 points.

    \b
    Examples:
      monoloc bench map
      monoloc bench map 7scenes:redkitchen --frames ::4 --json
    """
    cloud = _cloud(source, frames, np.random.default_rng(seed))
    _show(bench_fit(cloud, FIT_SIZES, seed, ConsoleProgress(stderr)), json)


@app.command()
def pipeline(
    source: SourceArgument,
    bundle: Annotated[
        Path | None,
        typer.Option("--bundle", help=f"A bundle of the room. [one with {_NETWORK}, not adapted, is built]"),
    ] = None,
    frames: FramesOption = "::",
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Time the whole step and its stages on a recording, on one core, in a process of its own.

    \b
    Examples:
      monoloc bench pipeline 7scenes:redkitchen
      monoloc bench pipeline 7scenes:redkitchen --bundle kitchen.monoloc --json
    """
    recording = open_source(source, frames)
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "give a recording with camera poses")
    if bundle is not None:
        read_bundle(bundle)
        _show(bench_pipeline(bundle, source, frames, seed), json)
        return
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "room.monoloc"
        config = override(BuildConfig(), adapt={"tune": "none", "map_transform": False})
        room, _ = build_bundle(_every(recording), config, seed, ConsoleProgress(stderr), network=_NETWORK)
        write_bundle(built, room)
        _show(bench_pipeline(built, source, frames, seed), json)


def _cloud(source: str | None, frames: str, rng: np.random.Generator) -> FloatArray:
    """The cloud of a recording, as a build makes it, or of a made-up room."""
    if source is None:
        refuse_frames(frames, "a made-up room")
        return made_up_cloud(_CLOUD_POINTS, rng)
    return room_cloud(open_source(source, frames), None, BuildConfig(), ConsoleProgress(stderr))


def _every(recording: Selection) -> Selection:
    """Enough of a recording's frames to build from: every fourth, or all of a short one."""
    step = _BUILD_EVERY if len(recording) >= _BUILD_EVERY * _FEWEST_BUILD_FRAMES else 1
    return Selection(recording, range(0, len(recording), step))


def _show(figures: KernelFigures | FitFigures | PipelineFigures, json: bool) -> None:
    content: dict[str, Any] = asdict(figures)
    left_out = [name for name, value in content.items() if value is None]
    if left_out:
        stderr.print(f"scikit-learn is not installed, so these are left out: {', '.join(left_out)}")
    if json:
        print_json(content)
    else:
        rows = [[name, text_of(value)] for name, value in content.items() if value is not None]
        print_table("monoloc bench, one thread", ["", ""], rows)
