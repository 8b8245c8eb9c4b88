"""Options of ``monoloc localize`` for sensors beside the camera that measure its motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.errors import DataError, SettingError
from monoloc.flight.flight_file import read_flight_file
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray
from monoloc.image_turns import T_camera_turned
from monoloc.io.gyroscope_file import read_gyroscope
from monoloc.io.pose_files import read_tum
from monoloc.odometry.external import ExternalOdometry
from monoloc.odometry.gyroscope import Gyroscope
from monoloc.odometry.motion import Motion, MotionSource, motions_between

_MOST_DELAY_S = 60.0

GyroscopeOption = Annotated[
    Path | None,
    typer.Option(
        "--gyroscope",
        metavar="FILE.csv",
        help="Angular velocity, t_s,wx,wy,wz in rad/s about the body's axes forward, left, up, by the clock of the "
        "frames.",
    ),
]
OdometryOption = Annotated[
    Path | None,
    typer.Option(
        "--odometry",
        metavar="FILE.txt",
        help="TUM trajectory of another odometry, by the clock of the frames: of the camera, or with --mount of the "
        "body (forward, left, up).",
    ),
]
OdometryDelayOption = Annotated[
    float, typer.Option("--odometry-delay", metavar="SECONDS", help="Delay of the time stamps of --odometry.")
]
MountOption = Annotated[
    Path | None,
    typer.Option(
        "--mount",
        metavar="FLIGHT.toml",
        help="File whose [mount] says how the camera is mounted on the body of --gyroscope and --odometry. "
        "[looks forward]",
    ),
]

_T_FLU_FRD = np.diag([1.0, -1.0, -1.0, 1.0])  # the body's axes forward, left, up from forward, right, down


def measured_motions(
    times_s: FloatArray,
    gyroscope: Path | None,
    odometry: Path | None,
    delay_s: float,
    mount: Path | None,
    quarter_turns: int = 0,
) -> list[Motion | None] | None:
    """Motions between frames (N,) by the files' sensors, N; the odometry's where it tells one; None without files.

    Where images were turned upright, motions are those of the upright camera; trajectory and mount, of the camera.

    Args:
        quarter_turns: by which images were turned when they were read.

    Raises:
        DataError: a file cannot be used, or tells nothing of the frames.
        SettingError: an option has no meaning without another.
    """
    if mount is not None and gyroscope is None and odometry is None:
        raise SettingError("--mount", "is given without a sensor", "add --gyroscope or --odometry, or leave it out")
    if delay_s != 0.0 and odometry is None:
        raise SettingError("--odometry-delay", "is given without --odometry", "leave it out")
    if not abs(delay_s) <= _MOST_DELAY_S:
        raise SettingError("--odometry-delay", f"is {delay_s:g}", f"give seconds, {_MOST_DELAY_S:g} at most")
    mounted = Mount() if mount is None else read_flight_file(mount).mount
    mounted = mounted.upright if quarter_turns else mounted
    T_body_camera = _T_FLU_FRD @ mounted.T_body_camera
    sources: list[MotionSource] = []
    if odometry is not None:
        T = T_camera_turned(quarter_turns) if mount is None else T_body_camera
        sources.append(_telling(odometry, _odometry(odometry, T, delay_s), times_s))
    if gyroscope is not None:
        sources.append(_telling(gyroscope, _gyroscope(gyroscope, T_body_camera[:3, :3]), times_s))
    return motions_between(times_s, sources) if sources else None


def _odometry(path: Path, T_body_camera: FloatArray, delay_s: float) -> MotionSource:
    source = ExternalOdometry(T_body_camera, delay_s, memory_s=np.inf)
    for stamp_s, pose in zip(*read_tum(path), strict=True):
        source.add(float(stamp_s), pose)
    return source


def _gyroscope(path: Path, R_body_camera: FloatArray) -> MotionSource:
    source = Gyroscope(R_body_camera.T, memory_s=np.inf)
    for time_s, rate in zip(*read_gyroscope(path), strict=True):
        source.add(float(time_s), rate)
    return source


def _telling(path: Path, source: MotionSource, times_s: FloatArray) -> MotionSource:
    """The source, if it tells a motion between any two frames.

    Raises:
        DataError: it tells none.
    """
    if len(times_s) > 1 and not any(motions_between(times_s, [source])):
        problem = f"gives no motion between frames of {times_s[0]:.3f} to {times_s[-1]:.3f} s"
        raise DataError(path, problem, "bring its time stamps to the clock of the frames")
    return source
