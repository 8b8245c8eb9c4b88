"""``monoloc calibrate``: measure a camera's intrinsics with a printed board."""

from __future__ import annotations

import re
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from monoloc.calibration.board import DEFAULT_SQUARE_MM, Board
from monoloc.calibration.board_pdf import Paper, write_board
from monoloc.calibration.board_source import read_views
from monoloc.calibration.intrinsics_solver import Calibration, calibrate_camera
from monoloc.calibration.sufficiency import assess, coverage_of, require_views
from monoloc.cli.common import (
    JsonOption,
    naming,
    print_json,
    print_table,
    say_written,
    stderr,
    warn,
)
from monoloc.cli.output_checks import check_outputs, check_picture, check_suffix
from monoloc.distortion import COEFFICIENTS, DistortionModel
from monoloc.errors import SettingError
from monoloc.io.camera_file import write_camera
from monoloc.live.opening import is_live
from monoloc.progress import ConsoleProgress
from monoloc.viz.coverage_drawing import plot_coverage

app = typer.Typer(help="Measure a camera's intrinsics with a printed board.", no_args_is_help=True)

SquareOption = Annotated[float, typer.Option("--square-mm", help="Side of a square on the printed board.")]


@app.command("board")
def board_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="PDF to write.")],
    square_mm: SquareOption = DEFAULT_SQUARE_MM,
    paper: Annotated[Paper, typer.Option("--paper", help="Size of the sheet.")] = "a4",
    json: JsonOption = False,
) -> None:
    """Write the board as a PDF, to be printed at actual size.

    \b
    Examples:
      monoloc calibrate board --out board.pdf
      monoloc calibrate board --out board.pdf --paper letter --square-mm 25
    """
    check_outputs({"--out": out})
    check_suffix(out, "--out", ".pdf", "a PDF")
    with naming({"square_mm": "--square-mm"}):
        board = Board(square_mm)
        write_board(out, board, paper)
    if json:
        print_json({"board": board.name, "paper": paper, "out": str(out)})
        return
    stderr.print(
        f"written: {out}; print it at 100 %, glue it to something flat, and measure a square", soft_wrap=True
    )


@app.command("camera")
def camera_command(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE", help="Folder of pictures of the board, a video, or camera:N.", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Camera file to write, for --camera.")],
    square_mm: SquareOption = DEFAULT_SQUARE_MM,
    model: Annotated[
        DistortionModel, typer.Option("--model", help="Distortion; fisheye beyond 120 degrees.")
    ] = "brown",
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw coverage and residuals.")
    ] = None,
    size: Annotated[
        str | None,
        typer.Option("--size", metavar="WxH", help="Image size that camera:N is asked for; 640x480 without it."),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option("--seconds", min=1.0, max=3600.0, help="How long camera:N is watched; 60 without it."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Calibrate a camera from at least ten sharp views of the board.

    Tilt the board by 30 to 45 degrees to all sides, fill the image with it, and bring it into all corners. Use the
    focus and the resolution of the flight. The size of a square changes the distances that are printed, but not the
    intrinsics.

    \b
    Examples:
      monoloc calibrate camera pictures --out cam.toml --square-mm 29.7 --plot coverage.png
      monoloc calibrate camera board.mp4 --out cam.toml --model fisheye
      monoloc calibrate camera camera:0 --out cam.toml --size 1280x720
    """
    check_outputs({"--out": out, "--plot": plot}, (source,))
    check_suffix(out, "--out", ".toml", "a camera file")  # --camera reads no other
    check_picture(plot, "--plot")
    if not is_live(source):
        for option, value in (("--size", size), ("--seconds", seconds)):
            if value is not None:
                raise SettingError(option, "has no meaning for pictures and videos", "leave it out")
    with naming({"square_mm": "--square-mm", "calibration": source}):
        board = Board(square_mm)
        size_px = _parse_size(size or "640x480")
        found = read_views(source, board, ConsoleProgress(stderr), size_px, 60.0 if seconds is None else seconds)
        require_views(source, found)
        calibration = calibrate_camera(found.views, board, found.size, model)
    warnings = assess(source, calibration)
    write_camera(out, calibration.camera, _provenance(calibration, board))
    if plot is not None:
        plot_coverage(plot, calibration, board, title=source)
    for warning in warnings:
        warn(source, warning)
    say_written(out, plot)
    if json:
        print_json({**_figures(calibration, found.images), "warnings": warnings, "out": str(out)})
    else:
        _show(source, calibration, found.images)


def _parse_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{1,4})x([1-9]\d{1,4})", text)
    if match is None:
        raise SettingError("--size", f"is {text!r}", "write width and height in pixels, such as 1280x720")
    return int(match[1]), int(match[2])


def _provenance(calibration: Calibration, board: Board) -> dict[str, float | int | str]:
    names = ("fx", "fy", "cx", "cy", *COEFFICIENTS[calibration.camera.distortion_model])
    return {
        "date": date.today().isoformat(),
        "board": board.name,
        "views": len(calibration.views),
        "rms_px": round(calibration.rms_px, 4),
        "held_out_rms_px": round(calibration.held_out_rms_px, 4),
        **{f"sd_{name}": float(f"{sd:.4g}") for name, sd in zip(names, calibration.sd, strict=True)},
    }


def _figures(calibration: Calibration, images: int) -> dict[str, Any]:
    camera = calibration.camera
    names = ("fx", "fy", "cx", "cy", *COEFFICIENTS[camera.distortion_model])
    return {
        "camera": asdict(camera),
        "sd": dict(zip(names, calibration.sd.tolist(), strict=True)),
        "images": images,
        "views": len(calibration.views),
        "rms_px": calibration.rms_px,
        "held_out_rms_px": calibration.held_out_rms_px,
        "distance_m": [float(calibration.distances_m.min()), float(calibration.distances_m.max())],
        "coverage": float(np.mean(coverage_of(calibration.views, (camera.width, camera.height)) > 0)),
    }


def _show(source: str, calibration: Calibration, images: int) -> None:
    """Print the intrinsics with their standard deviations, and what they are worth."""
    figures, camera, sd = _figures(calibration, images), calibration.camera, calibration.sd
    names, values = list(figures["sd"]), [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
    digits = [2] * 4 + [5] * len(camera.distortion)
    rows = [
        [name, f"{value:.{places}f}", f"{spread:.{places}f}" if spread > 0.0 else "left out"]
        for name, value, spread, places in zip(names, values, sd, digits, strict=True)
    ]
    print_table(f"{source}: {camera.distortion_model}, {camera.width}x{camera.height}", ["", "", "±"], rows)
    nearest_m, farthest_m = figures["distance_m"]
    stderr.print(
        f"{figures['views']} views of {images} images, {nearest_m:.2f} to {farthest_m:.2f} m away; RMS "
        f"{calibration.rms_px:.2f} px, held out {calibration.held_out_rms_px:.2f} px; corners cover "
        f"{figures['coverage']:.0%} of the image",
        soft_wrap=True,
    )
