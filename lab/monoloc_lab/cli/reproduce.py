"""``monoloc reproduce``: the figures and the table of the paper, and further ones, on a chosen room."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from monoloc.cli.common import (
    JsonOption,
    naming,
    print_json,
    print_table,
    stderr,
)
from monoloc.cli.output_checks import check_folder
from monoloc.errors import DataError, SettingError
from monoloc.extras import require_extra, training_extra
from monoloc.io.registry import absolute_source, open_recording

if TYPE_CHECKING:
    from monoloc_lab.experiments.study import Study
    from monoloc_lab.experiments.task import Task

_BUILTIN, _RENDERED = "builtin", "rendered:"


def reproduce(
    figures: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="FIGURE",
            help="Such as fig4d. [all but ablation, adapt-settings, robustness, ladder, claims-by-method, posenets]",
        ),
    ] = None,
    data: Annotated[
        str,
        typer.Option(
            "--data",
            help=f"{_BUILTIN}, the rendered room of the package; {_RENDERED}FOLDER, another one, as "
            "python -m monoloc_lab.make.rendered_room writes it; or a SOURCE with poses and depth.",
        ),
    ] = _BUILTIN,
    build_frames: Annotated[
        str | None,
        typer.Option(
            "--build-frames",
            metavar="START:STOP:STEP",
            help="Build frames of the extrapolation split, whose test frames begin at STOP; every third of three "
            "quarters by default.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for results, pictures and the report.")] = Path(
        "reproduction"
    ),
    quick: Annotated[
        bool, typer.Option("--quick", help="Two sizes, shorter training, without the most expensive parts.")
    ] = False,
    builds: Annotated[
        int | None,
        typer.Option(
            "--builds",
            min=1,
            help="Number of builds of the room; 5 by default, 1 with --quick.",
            show_default=False,
        ),
    ] = None,
    size: Annotated[
        list[str] | None,
        typer.Option(
            "--size", help="Network size; may be repeated. All four by default, two with --quick.", show_default=False
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", min=1, help="Processes of one thread each; one per core by default.", show_default=False
        ),
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            "--dask", metavar="ADDRESS", help="Dask scheduler whose workers execute the tasks, tcp://HOST:8786."
        ),
    ] = None,
    encoder: Annotated[
        Path | None,
        typer.Option(
            "--encoder",
            help="Initial MobileNetV2 weights (.npz) of PoseNets; by default the encoder of the depth network.",
        ),
    ] = None,
    benchmark: Annotated[
        str | None,
        typer.Option(
            "--benchmark",
            metavar="7scenes|12scenes",
            help="Instead of figures, one row per scene on the published split; --data is the data set's folder.",
        ),
    ] = None,
    scene: Annotated[
        list[str] | None,
        typer.Option(
            "--scene",
            metavar="NAME",
            help="Scene of the benchmark; may be repeated. All by default.",
            show_default=False,
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Reproduce the paper's figures and table.

    Its claims are compared with the measurements. Results in --out are reused, so a stopped run continues, and
    figures can be requested one by one. With --dask, all machines need the same monoloc, the same data and
    the folder --out.

    With --benchmark, scenes are built from their training sequences, and test sequences are flown without a start.

    \b
    Examples:
      monoloc reproduce --quick
      monoloc reproduce fig4d fig5b --data 7scenes:redkitchen --out kitchen
      monoloc reproduce --data 7scenes:redkitchen --builds 1 --size full --size one-third --out kitchen --json
      monoloc reproduce ladder --data folder:desk --build-frames 0:350:7 --size full --out desk
      monoloc reproduce --dask tcp://head:8786 --out /shared/reproduction
      monoloc reproduce --benchmark 7scenes --data 7scenes --out rows
      monoloc reproduce --benchmark 12scenes --data 12scenes --scene apt1/kitchen --out rows
    """
    with training_extra():
        import torch  # noqa: F401
    from monoloc_lab.cli.study_run import carry_out_shown
    from monoloc_lab.experiments.engine import check_scheduler
    from monoloc_lab.experiments.figures import chosen_figures, draw_figure
    from monoloc_lab.experiments.report import write_report

    started = time.perf_counter()
    if workers is not None and dask is not None:
        raise SettingError("--workers", "is for this machine, and --dask for others", "leave one of them out")
    processes = workers or len(os.sched_getaffinity(0))
    if benchmark is not None:
        from monoloc_lab.cli.reproduce_benchmark import reproduce_benchmark

        _refuse({"FIGURE": figures, "--build-frames": build_frames, "--builds": builds, "--encoder": encoder}, "with")
        folder = None if data == _BUILTIN else Path(data)
        reproduce_benchmark(benchmark, folder, scene or (), out, quick, size or (), processes, dask, json)
        return
    _refuse({"--scene": scene}, "without")
    chosen = chosen_figures(figures or [])
    check_folder(out, "--out")
    require_extra("report")
    study = _study(data, build_frames, quick, builds, size, encoder)
    if dask is not None:
        check_scheduler(dask)
    requested = [(figure, figure.tasks(study)) for figure in chosen]
    drawable = [(figure, tasks) for figure, tasks in requested if tasks is not None]
    left_out = [figure for figure, tasks in requested if tasks is None]
    if not drawable:
        names = ", ".join(figure.name for figure in left_out)
        raise SettingError("--quick", f"leaves out {names}, and nothing else is requested", "run without it")
    tasks = [task for _, tasks in drawable for task in tasks]
    _check_length(tasks)
    out = out.resolve()
    out.mkdir(exist_ok=True)
    results = carry_out_shown(tasks, out, processes, dask)
    drawn = [(figure, draw_figure(figure, study, results, out)) for figure, _ in drawable]
    worked_s = sum(result.seconds for result in results.values())
    content = write_report(out, study, drawn, left_out, time.perf_counter() - started, worked_s)
    if json:
        print_json({name: content[name] for name in ("claims", "figures", "report", "seconds")})
        return
    if content["claims"]:
        print_table(
            f"{study.title}: claims of the paper",
            ["", "bound satisfied", "over builds", "measured"],
            [
                [claim["name"], "yes" if claim["holds"] else "no", claim["verdict"], claim["figure"]]
                for claim in content["claims"]
            ],
        )
    stderr.print(f"{content['seconds']:.0f} s; report: {content['report']}")


def _refuse(options: dict[str, object], how: str) -> None:
    """Refuse options that are given and have no meaning with, or without, ``--benchmark``."""
    for option, value in options.items():
        if value is not None:
            raise SettingError(option, f"has no meaning {how} --benchmark", "leave it out")


def _study(
    data: str,
    build_frames: str | None,
    quick: bool,
    builds: int | None,
    sizes: list[str] | None,
    encoder: Path | None,
) -> Study:
    """The study of the options.

    Raises:
        DataError, SettingError: the source cannot be read or has no poses or no depth, the weights do not fit,
            there are more builds than seeds, or a size is unknown.
    """
    from dataclasses import replace

    from monoloc_lab.experiments.study import SIZES, builtin, recorded

    if data == _BUILTIN or data.startswith(_RENDERED):
        if build_frames is not None:
            raise SettingError("--build-frames", "has no meaning for a rendered room", "leave it out")
        study = builtin(quick) if data == _BUILTIN else _rendered(data, quick)
    else:
        with naming({"SOURCE": "--data"}):
            source = absolute_source(data)
            recording = open_recording(source)
        lacking = "no poses" if recording.poses is None else None if recording.has_depth else "no depth"
        if lacking is not None:
            raise DataError(recording.name, f"has {lacking}", f"give --data {_BUILTIN}, or one with poses and depth")
        if build_frames is not None:
            _check_build_frames(build_frames, len(recording))
        study = recorded(source, recording.name, len(recording), quick, build_frames)
    if builds is not None:
        if builds > study.seeds:
            raise SettingError(
                "--builds", f"is {builds}, and runs have {study.seeds} seeds", "give at most that many"
            )
        study = replace(study, builds=builds)
    if sizes:
        unknown = next((size for size in sizes if size not in SIZES), None)
        if unknown is not None:
            raise SettingError("--size", f"is {unknown!r}", f"choose from {', '.join(SIZES)}")
        study = replace(study, sizes=tuple(size for size in SIZES if size in sizes))
    if encoder is None:
        return study
    _check_encoder(encoder, study.sizes)
    return replace(study, encoder_weights=str(encoder.resolve()))


def _check_encoder(encoder: Path, sizes: tuple[str, ...]) -> None:
    """Check that the weights fit the PoseNets, which are trained hours later.

    Raises:
        SettingError: there is no such file, or it is no .npz.
        DataError: as :func:`monoloc.depth.training.mobilenet.load_encoder_weights`.
    """
    from monoloc.depth.training.mobilenet import load_encoder_weights
    from monoloc_lab.baselines.posenet import PoseNet, posenet_config
    from monoloc_lab.experiments.study import WIDTH

    if not encoder.is_file() or encoder.suffix != ".npz":
        problem = "is no .npz" if encoder.is_file() else "does not exist"
        raise SettingError("--encoder", f"{encoder} {problem}", "give MobileNetV2 weights as .npz")
    for size in sizes:
        load_encoder_weights(PoseNet(posenet_config(size, WIDTH)), encoder)


def _rendered(data: str, quick: bool) -> Study:
    """The study of another rendered room.

    Raises:
        DataError: the folder is none, or a recording in it cannot be read.
    """
    from monoloc_lab.experiments.study import rendered

    folder = Path(data.removeprefix(_RENDERED)).resolve()
    if not (folder / "build").is_dir():
        raise DataError(folder, "has no folder build", "give the --out of python -m monoloc_lab.make.rendered_room")
    study = rendered(folder, f"room {folder.name}", quick)
    for split in study.splits:
        for source in (split.source, *(each.source for each in split.recordings.values())):
            open_recording(source)
    return study


def _check_build_frames(text: str, frames: int) -> None:
    """Refuse what does not leave frames of a recording to evaluate.

    Raises:
        SettingError: it is not START:STOP:STEP with STOP within the recording.
    """
    parts = text.split(":")
    if len(parts) != 3 or not all(part.isdecimal() for part in parts):
        raise SettingError("--build-frames", f"is {text!r}", "write START:STOP:STEP, three numbers")
    start, stop, step = map(int, parts)
    if not start < stop < frames or step < 1:
        raise SettingError("--build-frames", f"is {text}, and there are {frames} frames", "leave some after STOP")


def _check_length(tasks: Sequence[Task]) -> None:
    """Refuse a recording that is too short for the requested PoseNets, before any work is done.

    Raises:
        DataError: with the number of frames that it needs.
    """
    from monoloc_lab.baselines.posenet_training import PoseNetTraining
    from monoloc_lab.experiments.engine import in_order
    from monoloc_lab.experiments.study import FRAMES_PER_BUILD_FRAME

    for task in in_order(tasks):
        if task.kind == "posenet-search":
            build = task.settings["build"]
            least = PoseNetTraining.model_validate(task.settings["training"]).least_frames
            if build["length"] < least:
                problem = f"gives {build['length']} build frames, and PoseNets need {least}"
                fix = f"give one of {FRAMES_PER_BUILD_FRAME * least} frames or more, or omit figures with PoseNets"
                raise DataError(build["name"], problem, fix)
