"""A flight from the options of a command and the file that may hold them: what is given on the command line wins."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.cli.common import (
    naming,
    open_source,
    parse_intrinsics,
    refuse_frames,
    stderr,
)
from monoloc.cli.start_option import UNKNOWN, check_start_errors, start_of
from monoloc.config import override
from monoloc.errors import DataError, SettingError
from monoloc.flight.flight_file import FlightFile, read_flight_file
from monoloc.flight.flight_inputs import Starting
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray
from monoloc.image_turns import T_camera_turned, in_words
from monoloc.io.upright import is_upright
from monoloc.live.frame_source import FrameSource
from monoloc.live.opening import is_live, open_live
from monoloc.live.replayed_recording import PacedRecording, UnpacedRecording
from monoloc.live.turned_frames import TurnedFrames
from monoloc.mavlink.firmware import Firmware
from monoloc.place.flown_map import FlownMap, is_place, open_map
from monoloc.relocalization.marker import MarkerLocalizer
from monoloc.start import Start

MapOrFlightArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="ROOM|PLACE|FLIGHT.toml",
        help="Bundle of a room, place of several rooms, or a file with either and all other settings of a flight.",
        show_default=False,
    ),
]
SettingsOption = Annotated[
    Path | None,
    typer.Option("--settings", metavar="FLIGHT.toml", help="Flight file, if the first argument is not one."),
]
MavlinkOption = Annotated[
    str | None,
    typer.Option(
        "--mavlink",
        metavar="URL",
        help="Autopilot: udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD.",
    ),
]
FirmwareOption = Annotated[
    Firmware | None, typer.Option("--firmware", help="The autopilot's firmware, with --mavlink.")
]


class AskedFlight(NamedTuple):
    """A flight that a user asks for.

    Attributes:
        room: bundle or place.
        flight: with the defaults of what is not stated.
        names: of what the file sets, for :func:`monoloc.cli.common.naming`: without it, errors about what the file
            says would name the options that say the same.
        stated: fields of the flight that the file or an option sets.
    """

    room: Path
    flight: FlightFile
    names: Mapping[str, str]
    stated: Set[str]


def flight_of(room: Path | None, settings: Path | None, **options: object) -> AskedFlight:
    """The flight that a user asks for.

    Args:
        room: first argument, a bundle, a place or a file.
        settings: value of ``--settings``.
        options: fields of the file by name; None takes the file's value.

    Raises:
        DataError: the file cannot be used.
        SettingError: neither bundle nor place is named, two files are named, or a setting is invalid or in vain.
    """
    if room is not None and room.suffix.lower() == ".toml" and not room.is_dir():
        if not room.exists():
            raise DataError(room, "there is no such flight file", "check the path")
        if settings is not None:
            raise SettingError("--settings", f"is given beside {room}", "name one file")
        room, settings = None, room
    file = FlightFile() if settings is None else read_flight_file(settings)
    with naming({name: "--" + name.replace("_", "-") for name in options}):
        flight = override(file, room=room, **options)
    given = {name for name, value in {"room": room, **options}.items() if value is not None}
    names = {} if settings is None else _names_in(settings, given)
    with naming(names):
        # A start of the file that the command line takes back needs no other file, so its errors are left alone.
        check_start_errors(flight.start, given | (file.model_fields_set if file.start == UNKNOWN else set()))
    bundle = flight.room
    if bundle is None:
        where = "" if settings is None else f" and {settings} has no room"
        raise SettingError("ROOM", f"is missing{where}", "name a bundle of monoloc build")
    timed = {name: getattr(flight, name) for name in ("out", "mcap", "record")}
    changes = {name: Path(time.strftime(str(path))) for name, path in timed.items() if path and "%" in str(path)}
    return AskedFlight(bundle, flight.model_copy(update=changes), names, given | file.model_fields_set)


def note_of_mount(flight: FlightFile, stated: Set[str], measures_north: bool = False) -> Iterator[str]:
    """What is said before a flight whose messages rest on a mount or a heading that nobody stated.

    Args:
        flight, stated: as :class:`AskedFlight`.
        measures_north: whether the flight is to find the heading.
    """
    assumed = {}
    if "mount" not in stated and (flight.mavlink is not None or flight.mcap is not None):
        assumed["[mount]"] = "the camera is taken to look forward, upright, from the body's origin"
    if flight.mavlink is not None and "north_deg" not in stated and not measures_north:
        assumed["north_deg"] = "the map's x axis is taken to point north"
    if assumed:
        what = " and no ".join(assumed)
        yield f"note: no {what}: {', and '.join(assumed.values())}; write {' and '.join(assumed)} into flight.toml"


def _names_in(settings: Path, given: Set[str]) -> dict[str, str]:
    """The file and its field, by what an error names, of fields that the command line does not set."""
    arguments = {"room": "ROOM", "source": "SOURCE", "down": "down", "marker": "marker"}
    named = {arguments.get(field, "--" + field.replace("_", "-")): field for field in FlightFile.model_fields}
    return {name: f"{settings}: {field}" for name, field in named.items() if field not in given}


def check_autopilot(flight: FlightFile, align: bool, fast: bool) -> None:
    """Check that options for an autopilot come together.

    Raises:
        SettingError: one is missing, or contradicts another.
    """
    names = ", ".join(each.value for each in Firmware)
    if flight.mavlink is not None and flight.firmware is None:
        raise SettingError("--firmware", "is missing: each expects another frame", f"choose from {names}")
    if flight.mavlink is None and flight.firmware is not None:
        raise SettingError(
            "--firmware", "is given without an autopilot", "give the autopilot's address (mavlink) too"
        )
    if align and flight.mavlink is None:
        raise SettingError("--align", "needs the autopilot's yaw", "give its address with --mavlink")
    if fast and flight.mavlink is not None:
        raise SettingError("--fast", "takes the recording's clock, not the autopilot's", "leave it out")


def map_of(path: Path, flight: FlightFile) -> FlownMap:
    """The room or the place of a flight.

    Args:
        path: of the bundle or the place.
        flight: what was asked for.

    Raises:
        DataError, MissingExtraError: as :func:`monoloc.place.flown_map.open_map`.
        SettingError: a place is given a start or a marker, whose poses would be in the world of one room.
    """
    if is_place(path):
        _check_start(flight)
    return open_map(path, flight.require_signature)


def _check_start(flight: FlightFile) -> None:
    if flight.start != UNKNOWN:
        problem = f"is {flight.start!r}, but a place is searched for the camera"
        raise SettingError("--start", problem, "leave it out, or name the bundle of one room")
    if flight.marker:
        problem = "is given, but a place is searched for the camera"
        raise SettingError("marker", problem, "leave markers out, or name the bundle of one room")


def starting_of(
    flight: FlightFile, bundle: Bundle | None, camera: Camera, first_pose: FloatArray | None, rng: np.random.Generator
) -> Starting:
    """How the flight begins that a user asks for.

    Args:
        flight: what was asked for.
        camera: of the images.
        bundle: the room, which may be searched; None in a place, which is.
        first_pose, rng: as :func:`monoloc.cli.start_option.start_of`.

    Raises:
        SettingError: as :func:`monoloc.cli.start_option.start_of`.
    """
    if bundle is None:
        return Starting(None, begins="searching")
    markers = flight.markers
    find = (lambda color: None) if markers is None else MarkerLocalizer(markers, camera).start
    if flight.start == UNKNOWN and markers is not None and not bundle.supports_relocalization:
        return Starting(Start(np.eye(4)), find, "waiting")
    error_m, error_rad = flight.start_error_cm / 100.0, float(np.deg2rad(flight.start_error_deg))
    start = start_of(flight.start, bundle, first_pose, error_m, error_rad, rng)
    return Starting(start, find, "searching" if start is None else "known")


def open_frames(flight: FlightFile, frames: str, fast: bool) -> tuple[FrameSource, Camera, FloatArray | None, bool]:
    """The source, its camera, the first pose, (4, 4), of a recording with poses, and whether images stand upright.

    Images of a camera that is mounted on its side or upside down are turned upright, and camera and pose with them;
    those of a recording that tells gravity stand upright already. Without either, nothing is known of them.

    Raises:
        DataError, SettingError: from the reader or the camera, or an option is invalid.
    """
    source, camera, first_pose, are_upright = _frames_of(flight.source, frames, flight.camera, fast)
    turns = flight.mount.quarter_turns
    if turns == 0 or are_upright:
        return source, camera, first_pose, are_upright or flight.mount != Mount()
    stderr.print(f"note: [mount] turns the camera: its images are turned by {in_words(turns)}, to stand upright")
    first_pose = None if first_pose is None else first_pose @ T_camera_turned(turns)
    return TurnedFrames(source, turns), camera.turned(turns), first_pose, True


def _frames_of(
    source: str, frames: str, intrinsics: str | None, fast: bool
) -> tuple[FrameSource, Camera, FloatArray | None, bool]:
    """As :func:`open_frames`, before the mount turns them; the last value is by the recording alone."""
    if not is_live(source):
        recording = open_source(source, frames, intrinsics)
        paced = UnpacedRecording(recording) if fast else PacedRecording(recording)
        first_pose = None if recording.poses is None else recording.poses[0]
        return paced, recording.camera, first_pose, is_upright(recording)
    refuse_frames(frames, "a live camera")
    if fast:
        raise SettingError("--fast", "has no meaning for a live camera", "leave it out")
    if intrinsics is None:
        problem = "is missing: a live camera does not state its intrinsics"
        raise SettingError("--camera", problem, "name the file that monoloc calibrate wrote")
    camera = parse_intrinsics(intrinsics)[0]
    return open_live(source, camera), camera, None, False
