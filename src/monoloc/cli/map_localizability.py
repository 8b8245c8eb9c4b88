"""``monoloc map localizability``: from where in a room, and in which directions, a lost camera is found."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.bundle import Bundle, read_bundle
from monoloc.cli.common import JsonOption, naming, print_figures, stderr
from monoloc.cli.map_looking import BundleArgument, warn_of_up
from monoloc.cli.output_checks import check_outputs
from monoloc.errors import SettingError
from monoloc.extras import require_extra
from monoloc.files import write_whole
from monoloc.geometry import transform
from monoloc.level_map import T_map_world
from monoloc.localizability import Localizability, localizability
from monoloc.map.surface import surface_points
from monoloc.progress import ConsoleProgress
from monoloc.viz.localizability_drawing import plot_localizability

_CELL_M = 0.25
_DRAWN_POINTS = 40_000
_MOST_PITCH_DEG = 89.0
_COLUMNS = "x_m,y_m,z_m,heading_deg,landmarks,probability"


def command(
    bundle: BundleArgument,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help=".png: picture from above; .csv: a row for each view.")
    ] = None,
    height: Annotated[
        float | None,
        typer.Option("--height", help="Height of the places, metres, in ROS's map frame. [median of the cameras']"),
    ] = None,
    pitch: Annotated[
        float | None,
        typer.Option("--pitch", help="Degrees by which the camera looks up from level. [median of the cameras']"),
    ] = None,
    cell: Annotated[float, typer.Option("--cell", help="Distance between places, metres.")] = _CELL_M,
    json: JsonOption = False,
) -> None:
    """Predict from where in a room, and in which directions, one image is enough to find a lost camera.

    The prediction needs only the bundle: which of its landmarks the build found, from which views.

    \b
    Examples:
      monoloc map localizability kitchen.monoloc --out where.png
      monoloc map localizability kitchen.monoloc --height 1.2 --pitch -20 --json
    """
    _check_numbers(height, pitch)
    check_outputs({"--out": out}, (bundle,))
    if out is not None and out.suffix.lower() not in (".png", ".csv"):
        raise SettingError("--out", f"ends in {out.suffix or 'nothing'}", "choose from .png, .csv")
    if out is not None and out.suffix.lower() == ".png":
        require_extra("report")
    room = read_bundle(bundle)
    warn_of_up(room, bundle.name)
    pitch_rad = None if pitch is None else float(np.deg2rad(pitch))
    with naming({"voxel_m": "--cell", "height_m": "--height"}):
        views = localizability(room, str(bundle), cell, height, pitch_rad, ConsoleProgress(stderr))
    if out is not None:
        _write(out, views, room, bundle.name)
    print_figures(str(bundle), {**views.figures(), **({} if out is None else {"written": str(out)})}, json)


def _check_numbers(height: float | None, pitch: float | None) -> None:
    if height is not None and not np.isfinite(height):
        raise SettingError("--height", f"is {height}", "give metres")
    if pitch is not None and not abs(pitch) <= _MOST_PITCH_DEG:
        fix = f"give degrees from -{_MOST_PITCH_DEG:g} to {_MOST_PITCH_DEG:g}"
        raise SettingError("--pitch", f"is {pitch:g}", fix)


def _write(path: Path, views: Localizability, room: Bundle, name: str) -> None:
    if path.suffix.lower() == ".png":
        T = T_map_world(room)
        cloud = transform(T, surface_points(room.original, _DRAWN_POINTS, np.random.default_rng(0)))
        plot_localizability(path, views, cloud, (T @ room.reference_poses.poses)[:, :3, 3], name)
        return
    headings_deg = np.degrees(views.headings_rad)
    rows = [
        f"{x:.3f},{y:.3f},{z:.3f},{heading:.0f},{count:.1f},{share:.3f}"
        for (x, y, z), counts, shares in zip(views.positions, views.landmarks, views.probability, strict=True)
        for heading, count, share in zip(headings_deg, counts, shares, strict=True)
    ]
    write_whole(path, "\n".join([_COLUMNS, *rows, ""]).encode())
