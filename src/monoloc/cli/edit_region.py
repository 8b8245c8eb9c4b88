"""Options of ``monoloc map edit`` that say where in the room: boxes, named regions and turns."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.bundle import Bundle
from monoloc.cli.common import warn
from monoloc.editing.box import Box, parse_box
from monoloc.editing.changed_region import read_changed_region
from monoloc.editing.paired_map import down_direction
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, so3_exp

_BOX = "X,Y,Z,X,Y,Z"
BoxOption = Annotated[
    str | None, typer.Option("--box", metavar=_BOX, help="Two opposite corners, world frame, metres.")
]
YawOption = Annotated[
    float, typer.Option("--yaw", help="Turn the box about the vertical through its centre, degrees, right-handed.")
]
ChangedOption = Annotated[
    Path | None,
    typer.Option("--changed", metavar="RUN.json", help="The region that localize --json named in place of a box."),
]
TurnOption = Annotated[float, typer.Option("--turn", help="About the vertical, degrees, right-handed.")]


def check_angle(degrees: float, option: str) -> None:
    if not np.isfinite(degrees):
        raise SettingError(option, f"is {degrees}", "give degrees, such as 90")


def corners_of(bundle: Path, box: str | None, changed: Path | None) -> tuple[FloatArray, FloatArray]:
    """Corners of the box that one of two options gives.

    Raises:
        DataError, BundleError: as :func:`monoloc.editing.changed_region.read_changed_region`.
        SettingError: both do, or neither.
    """
    if (box is None) == (changed is None):
        problem = "is missing" if box is None else "and --changed both name a region"
        raise SettingError("--box", problem, f"give one of --box {_BOX} and --changed RUN.json")
    if changed is not None:
        return read_changed_region(changed, bundle)
    assert box is not None
    return parse_box(box)


def box_of(bundle: Bundle, corners: tuple[FloatArray, FloatArray], yaw_deg: float) -> Box:
    return Box.between(*corners, _down_for(bundle, yaw_deg, "--yaw"), float(np.deg2rad(yaw_deg)))


def box_parameters(corners: tuple[FloatArray, FloatArray], yaw_deg: float, changed: Path | None) -> dict[str, object]:
    lower, upper = corners
    named = {} if changed is None else {"changed": str(changed)}
    return {"lower_m": lower.tolist(), "upper_m": upper.tolist(), "yaw_deg": yaw_deg, **named}


def turn_of(bundle: Bundle, turn_deg: float) -> FloatArray:
    """Rotation about the upward direction, (3, 3)."""
    return so3_exp(-np.deg2rad(turn_deg) * _down_for(bundle, turn_deg, "--turn"))


def _down_for(bundle: Bundle, turn_deg: float, option: str) -> FloatArray:
    """Down, (3,), and a warning where a turn is about an axis that may be tilted."""
    if turn_deg != 0.0 and bundle.down is None:
        problem = "is about the cameras' mean vertical, since the map does not give the direction of gravity"
        warn(option, f"{problem}; look at the map, and undo if it is tilted")
    return down_direction(bundle)
