"""The option ``--start``: the first pose of a flight, or a search of the room."""

from __future__ import annotations

import math
from collections.abc import Set
from typing import Annotated

import numpy as np
import typer

from monoloc.bundle import Bundle
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, make_pose, quaternion_to_rotation
from monoloc.io.pose_files import UNIT_TOLERANCE
from monoloc.start import Start

METAVAR = "TX,TY,TZ,QX,QY,QZ,QW"
UNKNOWN, TRUTH = "unknown", "truth"
"""Values of the option beside a pose."""

StartErrorCmOption = Annotated[
    float | None,
    typer.Option("--start-error-cm", min=0.0, max=1e5, help="Position error of the start; 10 without it."),
]
StartErrorDegOption = Annotated[
    float | None,
    typer.Option("--start-error-deg", min=0.0, max=180.0, help="Rotation error of the start; 3 without it."),
]

_MIN_ERROR_M, _MIN_ERROR_RAD = 0.03, 0.015  # lower bounds of the error of a start
_MAX_COORDINATE_M = 1e6  # of a start; no map is larger
_MOST_BEYOND_M = 10.0  # from the map to a start that is given as numbers


def check_start_errors(start: str, given: Set[str]) -> None:
    """Refuse an error of a start where there is none.

    Args:
        start: as for :func:`start_of`.
        given: names of the settings that are given.

    Raises:
        SettingError: an error would have no effect.
    """
    for name in ("start_error_cm", "start_error_deg"):
        if start == UNKNOWN and name in given:
            option = "--" + name.replace("_", "-")
            raise SettingError(option, "has no effect without a start", "give a start too, or leave it out")


def start_of(
    text: str,
    room: Bundle,
    first_pose: FloatArray | None,
    error_m: float,
    error_rad: float,
    rng: np.random.Generator,
) -> Start | None:
    """The start that a user asks for; None searches the room.

    Args:
        text: a pose, ``unknown``, or ``truth`` for the recording's first pose with an error in a random direction.
        room: is searched.
        first_pose: ``T_world_camera`` of the recording's first frame, (4, 4); None where it is not known.
        error_m, error_rad: of the start.
        rng: draws the direction.

    Raises:
        SettingError: the text is none of these, or a pose far from the room, or the room cannot be searched.
    """
    errors = max(_MIN_ERROR_M, error_m), max(_MIN_ERROR_RAD, error_rad)
    if text == TRUTH:
        if first_pose is None:
            raise SettingError("--start", "is truth, but the recording has no poses", f"write {METAVAR} or {UNKNOWN}")
        return Start(Start.disturbed(first_pose, rng, error_m, error_rad).pose, *errors)
    if text != UNKNOWN:
        pose = parse_pose(text)
        beyond_m = room.original.beyond_m(pose[None, :3, 3])
        if beyond_m > _MOST_BEYOND_M:
            problem = f"is {text!r}, {beyond_m:.4g} m beyond the map"
            raise SettingError("--start", problem, "are these millimetres? give metres, in the map's world")
        return Start(pose, *errors)
    if not room.supports_relocalization:
        problem = "is unknown, and neither scans nor landmarks can find the camera in this room"
        if "relocalization" in room.settings.without:
            problem = "is unknown, and the search for the camera is left out"
        fix = f"write {METAVAR}" + ("" if first_pose is None else f", or {TRUTH} for the recording's first pose")
        raise SettingError("--start", problem, fix)
    return None


def parse_pose(text: str, option: str = "--start") -> FloatArray:
    """``T_world_camera``, (4, 4), from the text of an option.

    Raises:
        SettingError: the text is no pose.
    """
    try:
        values = np.array([float(part) for part in text.split(",")])
        if values.shape != (7,) or not np.all(np.isfinite(values)):
            raise ValueError
    except ValueError as error:
        fix = f"write {METAVAR} in metres" + (f", {UNKNOWN}, or {TRUTH}" if option == "--start" else "")
        raise SettingError(option, f"is {text!r}", fix) from error
    far_m, length = float(np.abs(values[:3]).max()), math.hypot(*values[3:])
    if far_m > _MAX_COORDINATE_M:
        raise SettingError(option, f"is {text!r}, {far_m:.3g} m away", "write TX,TY,TZ,QX,QY,QZ,QW in metres")
    if abs(length - 1.0) > UNIT_TOLERANCE:
        fix = "write TX,TY,TZ,QX,QY,QZ,QW, the last four of length 1"
        raise SettingError(option, f"is {text!r}, with a quaternion of length {length:.3g}", fix)
    return make_pose(quaternion_to_rotation(values[3:]), values[:3])
