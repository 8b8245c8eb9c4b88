"""A camera's intrinsics as a TOML file, as ``monoloc calibrate`` writes it and ``--camera`` reads it.

::

    width = 640
    height = 480
    fx = 525.1
    fy = 524.8
    cx = 319.2
    cy = 240.6
    distortion_model = "brown"                # or "rational", "fisheye"; with distortion
    distortion = [-0.08, 0.02, 0.0, 0.0, 0.0] # optional, in OpenCV's order

    [calibration]                             # optional: how it was measured
    rms_px = 0.21
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from monoloc.camera import Camera
from monoloc.config import load_settings
from monoloc.distortion import DistortionModel
from monoloc.errors import DataError, SettingError
from monoloc.files import write_whole
from monoloc.io.file_access import require_file


class _CameraFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: DistortionModel = "brown"
    distortion: tuple[float, ...] = ()
    calibration: dict[str, Any] = {}


def read_camera(path: Path) -> Camera:
    """Read the intrinsics of a camera.

    Raises:
        DataError: the file is missing or not TOML, a field is missing, unknown or of another type, or the values are
            those of no camera.
    """
    require_file(path, "give a file that monoloc calibrate wrote")
    content = load_settings(path, _CameraFile)
    try:
        return Camera(**content.model_dump(exclude={"calibration"}))
    except SettingError as error:
        raise DataError(path, f"{error.field.removeprefix('camera.')} {error.problem}", error.fix) from error


def write_camera(path: Path, camera: Camera, calibration: Mapping[str, float | int | str]) -> None:
    """Write the intrinsics of a camera, and how they were measured.

    Raises:
        DataError: the file cannot be written.
    """
    coefficients = ", ".join(repr(value) for value in camera.distortion)
    lines = [
        f"width = {camera.width}",
        f"height = {camera.height}",
        *(f"{name} = {getattr(camera, name)!r}" for name in ("fx", "fy", "cx", "cy")),
        f'distortion_model = "{camera.distortion_model}"',
        f"distortion = [{coefficients}]",
        "",
        "[calibration]",
        *(f"{name} = {_toml(value)}" for name, value in calibration.items()),
    ]
    write_whole(path, "\n".join([*lines, ""]).encode())


def _toml(value: float | int | str) -> str:
    if not isinstance(value, str):
        return repr(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # else JSON's escapes are those of TOML
