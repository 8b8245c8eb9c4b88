"""``monoloc bench``: speed on this machine, compared with alternatives, and reliability of flights."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    print_figures,
    refuse_frames,
    stderr,
)
from monoloc.config import override
from monoloc.errors import DataError
from monoloc.extras import training_extra
from monoloc.geometry import FloatArray
from monoloc.io.recording import Selection
from monoloc.progress import ConsoleProgress
from monoloc_lab.bench.fitting import FitSizes, bench_fit
from monoloc_lab.bench.floor import FloorSizes, bench_floor
from monoloc_lab.bench.kernels import KernelSizes, bench_kernels
from monoloc_lab.bench.networks import bench_networks
from monoloc_lab.bench.scenes import synthetic_cloud
from monoloc_lab.bench.whole_step import bench_pipeline
from monoloc_lab.cli.bench_ageing import ageing
from monoloc_lab.cli.bench_compare import compare
from monoloc_lab.cli.bench_flights import faults, fly, recovery, soak, stop
from monoloc_lab.cli.bench_place import place

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

app = typer.Typer(
    help="Measure speed, compared with alternatives, and reliability.", no_args_is_help=True, rich_markup_mode=None
)
app.command()(compare)
app.command()(ageing)
app.command()(recovery)
app.command()(faults)
app.command()(fly)
app.command()(soak)
app.command()(stop)
app.command()(place)

_NETWORK = "one-third-0.35-int8"
_CLOUD_POINTS = 60_000  # of the synthetic room
_BUILD_EVERY, _FEWEST_BUILD_FRAMES = 4, 10  # a bundle is built from every fourth frame, if enough frames remain

RoomArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="SOURCE",
        help="A recording with depth, whose room is the map. [a synthetic room]",
        show_default=False,
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
    _show(bench_kernels(_cloud(source, frames, rng), KernelSizes(), rng, ConsoleProgress(stderr)), json)


@app.command()
def scaling(
    source: RoomArgument = None, frames: FramesOption = "::", seed: SeedOption = 0, json: JsonOption = False
) -> None:
    """Time a weighing against the number of particles, points and components, and the dense alternatives.

    \b
    Examples:
      monoloc bench scaling
      monoloc bench scaling 7scenes:redkitchen --frames ::4 --json
    """
    with training_extra():
        from monoloc_lab.bench.scaling import ScalingSizes, bench_scaling
    rng = np.random.default_rng(seed)
    _show(bench_scaling(_cloud(source, frames, rng), ScalingSizes(), rng, ConsoleProgress(stderr)), json)


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
    _show(bench_fit(cloud, FitSizes(), seed, ConsoleProgress(stderr)), json)


@app.command()
def floor(
    source: RoomArgument = None, frames: FramesOption = "::", seed: SeedOption = 0, json: JsonOption = False
) -> None:
    """Time a map of 100,000 components and 200,000 landmarks, beside that of one of its rooms.

    \b
    Examples:
      monoloc bench floor
      monoloc bench floor 7scenes:redkitchen --frames ::4 --json
    """
    rng = np.random.default_rng(seed)
    _show(bench_floor(_cloud(source, frames, rng), FloorSizes(), rng, ConsoleProgress(stderr)), json)


@app.command()
def networks(
    runs: Annotated[int, typer.Option("--runs", min=10, help="Timed runs of each network.")] = 300,
    json: JsonOption = False,
) -> None:
    """Time the shipped depth networks, in 32 and 8 bits.

    \b
    Examples:
      monoloc bench networks --json
    """
    _show(bench_networks(runs, ConsoleProgress(stderr)), json)


@app.command()
def tuning(
    source: SourceArgument,
    frames: FramesOption = "::",
    threads: Annotated[int, typer.Option("--threads", min=1, help="Of PyTorch.")] = 1,
    json: JsonOption = False,
) -> None:
    """Time a step of adaptation and a synthesised view, and the same without each optimisation.

    \b
    Examples:
      monoloc bench tuning 7scenes:redkitchen --frames 0:200:3
      ONEDNN_MAX_CPU_ISA=AVX2 ATEN_CPU_CAPABILITY=avx2 monoloc bench tuning 7scenes:redkitchen --frames 0:200:3
    """
    with training_extra():
        from monoloc_lab.bench.tuning_steps import TuningSizes, bench_tuning
    recording = open_source(source, frames)
    lacking = "no poses" if recording.poses is None else None if recording.has_depth else "no depth"
    if lacking is not None:
        raise DataError(recording.name, f"has {lacking}", "give a recording with camera poses and depth")
    _show(bench_tuning(recording, TuningSizes(), threads, ConsoleProgress(stderr)), json)


@app.command()
def pipeline(
    source: SourceArgument,
    bundle: Annotated[
        Path | None,
        typer.Option("--bundle", help=f"A bundle of the room. [built with {_NETWORK}, not adapted]"),
    ] = None,
    frames: FramesOption = "::",
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Time the whole step and its stages on a recording, on one core, in a separate process.

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
        room, _ = build_bundle(_build_frames(recording), config, seed, ConsoleProgress(stderr), network=_NETWORK)
        write_bundle(built, room)
        _show(bench_pipeline(built, source, frames, seed), json)


def _cloud(source: str | None, frames: str, rng: np.random.Generator) -> FloatArray:
    """The cloud of a recording, as a build makes it, or of a synthetic room."""
    if source is None:
        refuse_frames(frames, "a synthetic room")
        return synthetic_cloud(_CLOUD_POINTS, rng)
    return room_cloud(open_source(source, frames), None, BuildConfig(), ConsoleProgress(stderr))


def _build_frames(recording: Selection) -> Selection:
    """Every fourth frame of a recording, or all frames of a short one."""
    step = _BUILD_EVERY if len(recording) >= _BUILD_EVERY * _FEWEST_BUILD_FRAMES else 1
    return Selection(recording, range(0, len(recording), step))


def _show(figures: DataclassInstance, json: bool) -> None:
    content: dict[str, Any] = asdict(figures)
    left_out = [name for name, value in content.items() if value is None]
    if left_out:
        stderr.print(f"scikit-learn is not installed, so these are left out: {', '.join(left_out)}")
    shown = content if json else {name: value for name, value in content.items() if value is not None}
    print_figures("monoloc bench", shown, json)
