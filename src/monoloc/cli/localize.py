"""``monoloc localize``: estimate the poses of a recording with a bundle."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, get_args

import cv2
import numpy as np
import typer

from monoloc.bundle import Bundle, digest_of, read_bundle
from monoloc.cli.common import (
    BudgetOption,
    DepthScaleOption,
    FixDepthOption,
    FixPosesOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    RecordOption,
    SeedOption,
    SourceArgument,
    ThreadsOption,
    ViewOption,
    naming,
    note,
    open_source,
    print_json,
    print_table,
    say_written,
    stderr,
    warn,
)
from monoloc.cli.motion_options import (
    GyroscopeOption,
    MountOption,
    OdometryDelayOption,
    OdometryOption,
    measured_motions,
)
from monoloc.cli.output_checks import check_outputs, check_picture, check_viewing
from monoloc.cli.pose_warning import warn_of_poses
from monoloc.cli.run_doubts import doubts_of
from monoloc.cli.signature import RequireSignatureOption
from monoloc.cli.start_option import (
    METAVAR,
    UNKNOWN,
    StartErrorCmOption,
    StartErrorDegOption,
    check_start_errors,
    start_of,
)
from monoloc.config import override
from monoloc.editing.edit_history import drawn_edits
from monoloc.errors import MonolocError
from monoloc.io.upright import quarter_turns_of
from monoloc.localizer_config import PARTS
from monoloc.parts import parse_parts
from monoloc.progress import ConsoleProgress
from monoloc.run import Run, localize
from monoloc.sensor_depth import sensor_bundle
from monoloc.start import START_ERROR_DEG, START_ERROR_M
from monoloc.step_budget import budget_line
from monoloc.supervision.state import State
from monoloc.trajectory_output import WritingViewer, check_trajectory, is_without_lost, trajectory_output
from monoloc.version import commit
from monoloc.viz.plots import plot_localization
from monoloc.viz.run_drawing import DrawnRun
from monoloc.viz.viewer import run_viewer


def localize_command(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="Bundle from monoloc build.", show_default=False)],
    source: SourceArgument,
    frames: FramesOption = "::",
    require_signature: RequireSignatureOption = None,
    start: Annotated[
        str,
        typer.Option(
            "--start",
            metavar=METAVAR,
            help="First camera pose in the world frame; 'unknown' searches the room; 'truth' takes the recording's "
            "first pose with a random error.",
        ),
    ] = UNKNOWN,
    start_error_cm: StartErrorCmOption = None,
    start_error_deg: StartErrorDegOption = None,
    motion: Annotated[
        Literal["visual", "random-walk"] | None, typer.Option("--motion", help="Motion model. [visual]")
    ] = None,
    gyroscope: GyroscopeOption = None,
    odometry: OdometryOption = None,
    odometry_delay: OdometryDelayOption = 0.0,
    mount: MountOption = None,
    without: Annotated[
        str | None,
        typer.Option(
            "--without", metavar="PART,...", help=f"Parts of the localizer to leave out: {', '.join(PARTS)}."
        ),
    ] = None,
    depth: Annotated[
        Literal["predicted", "sensor"],
        typer.Option("--depth", help="Depth of the network or of the recording's sensor (upper bound)."),
    ] = "predicted",
    particles: Annotated[int | None, typer.Option("--particles", help="Number of particles. [the bundle's]")] = None,
    scan_points: Annotated[int | None, typer.Option("--scan-points", help="Points per scan. [the bundle's]")] = None,
    budget_ms: BudgetOption = None,
    threads: ThreadsOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Trajectory to write: .csv or .mcap (ROS 2) with covariance and state, or .txt or .tum, which leave "
            "out lost frames.",
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="PNG to write: trajectory over the map, and errors.")
    ] = None,
    view: ViewOption = False,
    record: RecordOption = None,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    fix_poses: FixPosesOption = None,
    fix_depth: FixDepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Estimate a camera's poses from its colour images.

    \b
    Examples:
      monoloc localize kitchen.monoloc 7scenes:redkitchen --out trajectory.txt --plot trajectory.png
      monoloc localize kitchen.monoloc 7scenes:redkitchen --frames 0:400 --out trajectory.csv --json
      monoloc localize room.monoloc flight.mp4 --camera 640,480,525,525,319.5,239.5 --out trajectory.txt
      monoloc localize room.monoloc flight.mp4 --camera 640,480,525,525,319.5,239.5 --start 0.5,0.2,1.1,0,0,0,1
      monoloc localize room.monoloc tum:fr1_room --start truth --motion random-walk
      monoloc localize room.monoloc tum:fr1_room --start truth --without landmarks,bias     (depth and odometry)
      monoloc localize room.monoloc folder:flight --gyroscope flight/imu.csv --mount flight.toml
      monoloc localize room.monoloc folder:flight --odometry wheels.txt --odometry-delay 0.08
      monoloc localize room.monoloc my-recording --fix-poses opengl     (poses with axes of OpenGL)
      monoloc localize kitchen.monoloc 7scenes:redkitchen --view --record trajectory.rrd
    """
    read = (bundle, source, require_signature, gyroscope, odometry, mount)
    check_outputs({"--out": out, "--plot": plot, "--record": record}, read)
    if out is not None:
        check_trajectory(out)
    check_picture(plot, "--plot")
    check_viewing(view, record)
    errors = {"start_error_cm": start_error_cm, "start_error_deg": start_error_deg}
    check_start_errors(start, {name for name, value in errors.items() if value is not None})
    left_out = () if without is None else parse_parts(without)
    room, digest = read_bundle(bundle, require_signature), digest_of(bundle)
    recording = open_source(source, frames, intrinsics, depth_scale, fix_poses=fix_poses, fix_depth=fix_depth)
    turns = quarter_turns_of(recording)
    motions = measured_motions(recording.timestamps_s, gyroscope, odometry, odometry_delay, mount, turns)
    given: dict[str, object] = {"motion": motion, "particles": particles, "scan_points": scan_points}
    given |= {"budget_ms": budget_ms, "threads": threads}
    with naming({name: "--" + name.replace("_", "-") for name in given}):
        config = override(room.settings, **given)
    # Names are checked, so the list needs no validation.
    config = config.model_copy(update={"without": tuple(dict.fromkeys((*config.without, *left_out)))})
    room = replace(room, settings=config)
    rng = np.random.default_rng(seed)
    used = sensor_bundle(room) if depth == "sensor" else room
    first_pose = None if recording.poses is None else recording.poses[0]
    error_m = START_ERROR_M if start_error_cm is None else start_error_cm / 100.0
    error_rad = float(np.deg2rad(START_ERROR_DEG if start_error_deg is None else start_error_deg))
    begin = start_of(start, used, first_pose, error_m, error_rad, rng)
    warn_of_poses(recording)  # takes a second, so all that can be refused has been
    name = f"{bundle.name}: {recording.name}"
    cv2.setNumThreads(1)  # more do not speed up small images, and the drone needs its other cores
    with ExitStack() as writing, ExitStack() as viewing:
        viewer = viewing.enter_context(run_viewer(name, view, record))
        trajectory = None if out is None else trajectory_output(out, used, recording.camera)
        if trajectory is not None:
            writing.enter_context(closing(trajectory))
            viewer = WritingViewer(viewer, trajectory)
        show_progress, sensor = ConsoleProgress(stderr), depth == "sensor"
        run = localize(room, recording, begin, rng, show_progress, sensor, viewer=viewer, motions=motions)
        writers: list[tuple[Path | None, Callable[[Path], None]]] = [
            (plot, lambda path: draw(path, run, room, name)),
            (record, lambda _: viewing.close()),
        ]
        if trajectory is not None:
            write_trajectory = trajectory.write
            writers.insert(0, (out, lambda _: write_trajectory()))
        written, failures = _write_each(writers)
    metrics = run.metrics()
    if json:
        source_of_depth = "sensor" if depth == "sensor" else "network"
        what = {"bundle": str(bundle), "digest": digest, "commit": commit(), "source": source, "selection": frames}
        print_json({**what, "start": start, "seed": seed, "depth": source_of_depth, **metrics})
    else:
        show(metrics)
        say_written(*written)
    if out is not None and out in written and is_without_lost(out) and (lost := run.states.count("lost")):
        note(out, f"leaves out {lost} of {len(run.poses)} frames, which are lost; a .csv has all")
    for doubt in doubts_of(run, metrics, room):
        warn(recording.name, doubt)
    if failures:
        raise MonolocError("; ".join(map(str, failures)))


def _write_each(
    writers: Iterable[tuple[Path | None, Callable[[Path], None]]],
) -> tuple[list[Path], list[MonolocError]]:
    """Write all requested files, even if one fails; return the written files and the errors."""
    written, failures = [], []
    for path, write in writers:
        if path is None:
            continue
        try:
            write(path)
        except MonolocError as error:
            failures.append(error)
        else:
            written.append(path)
    return written, failures


def draw(path: Path, run: Run, room: Bundle, title: str) -> None:
    """Write the plot of a run over its map."""
    drawn = DrawnRun(
        estimated=run.poses,
        timestamps_s=run.recording.timestamps_s,
        truth=run.truth,
        covariances=run.covariances,
        odometry=run.odometry,
        unseen=run.unseen,
        states=run.states,
        mixture=(room.adapted.means, room.adapted.covariances),
        edits=drawn_edits(room, np.random.default_rng(0)),
    )
    plot_localization(path, drawn, title)


def show(metrics: dict[str, object]) -> None:
    """Print the most important metrics as a table."""
    rows = []
    for prefix, label in (("", "all"), ("unseen_", "unseen")):
        if f"{prefix}ate_median_m" not in metrics:
            continue
        figure = partial(_figure, metrics, prefix)
        rows.append(
            [
                label,
                figure("ate_median_m", 100.0, " cm"),
                figure("ate_rmse_m", 100.0, " cm"),
                figure("ate_max_m", 100.0, " cm"),
                figure("rot_median_deg", 1.0, "°"),
                figure("within_5cm_5deg", 100.0, " %"),
                figure("coverage_95", 100.0, " %"),
                figure("depth_absrel", 100.0, " %"),
            ]
        )
    if rows:
        columns = ["frames", "median", "RMSE", "max", "rotation", "in 5 cm, 5°", "coverage", "depth error"]
        print_table("Accuracy", columns, rows)
    states = metrics["states"]
    assert isinstance(states, dict)
    counts = ", ".join(f"{states.get(state, 0)} {state}" for state in get_args(State))
    stderr.print(
        f"{metrics['frames']} frames: {counts}; "
        f"{metrics['step_ms_median']:.1f} ms a frame (95 %: {metrics['step_ms_p95']:.1f} ms)",
        soft_wrap=True,
    )
    reasons = metrics["reasons"]
    assert isinstance(reasons, dict)
    if reasons:
        why = ", ".join(f"{reason} ({count})" for reason, count in reasons.items())
        stderr.print(f"not tracking because: {why}", soft_wrap=True)
    levels = metrics["levels"]
    assert isinstance(levels, dict)
    if metrics["budget_ms"] is not None:
        stderr.print(budget_line(levels), soft_wrap=True)


def _figure(metrics: dict[str, object], prefix: str, name: str, factor: float, unit: str) -> str:
    value = metrics.get(prefix + name)
    return f"{factor * value:.1f}{unit}" if isinstance(value, float) else "-"
