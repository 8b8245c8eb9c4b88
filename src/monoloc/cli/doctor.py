"""``monoloc doctor``: check camera, room and autopilot before the first arm."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from monoloc.camera import Camera
from monoloc.cli.common import (
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    naming,
    print_json,
    say_written,
    stderr,
)
from monoloc.cli.findings import EXIT_CODES, print_findings
from monoloc.cli.flight_options import (
    FirmwareOption,
    MapOrFlightArgument,
    MavlinkOption,
    SettingsOption,
    check_autopilot,
    flight_of,
    map_of,
    note_of_mount,
    open_frames,
    starting_of,
)
from monoloc.cli.flight_outputs import check_flight_outputs
from monoloc.cli.output_checks import check_outputs
from monoloc.cli.start_option import UNKNOWN
from monoloc.errors import DataError, SettingError
from monoloc.files import json_text, write_whole
from monoloc.flight.autopilot import frames_of, tells_gravity
from monoloc.flight.bug_report import bug_report
from monoloc.flight.flight_file import FlightFile
from monoloc.flight.flight_inputs import OtherSensors
from monoloc.flight.flight_loop import Flight, FlightOutput, FlightSummary
from monoloc.flight.mount_check import MountCheck, MountErrors
from monoloc.flight.preflight import LinkReport, Preflight
from monoloc.live.opening import is_live
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.mavlink.link_port import BITS_PER_BYTE, parse_address
from monoloc.place.flown_map import FlownMap
from monoloc.recording_check.inspection import worst

_PARAMETERS_S = 5.0  # to wait for the autopilot's parameters


def doctor(
    room: MapOrFlightArgument = None,
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="SOURCE", help="As for monoloc fly; point the camera at the room.", show_default=False
        ),
    ] = None,
    intrinsics: IntrinsicsOption = None,
    settings: SettingsOption = None,
    mavlink: MavlinkOption = None,
    firmware: FirmwareOption = None,
    seconds: Annotated[float, typer.Option("--seconds", min=1.0, max=600.0, help="How long to observe.")] = 10.0,
    frames: FramesOption = "::",
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE.json", help="File to write for a bug report, without private paths."),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Check camera, map and autopilot, without sending a pose.

    The exit code is 0 if all is well, 1 with warnings, and 2 if something must be fixed before a flight.

    \b
    Examples:
      monoloc doctor room.monoloc camera:0 --camera cam.toml
      monoloc doctor house.place camera:0 --camera cam.toml
      monoloc doctor flight.toml --report report.json
      monoloc doctor room.monoloc camera:0 --camera cam.toml --mavlink serial:/dev/ttyAMA0:921600 --firmware px4
    """
    given: dict[str, object] = {"source": source, "camera": intrinsics, "mavlink": mavlink, "firmware": firmware}
    room, flight, names, stated = flight_of(room, settings, **given)
    inputs = room, flight.source, settings, flight.require_signature
    check_outputs({"--report": report}, inputs)
    with naming(names):
        check_flight_outputs(flight, inputs)
        check_autopilot(flight, align=False, fast=False)
        flown = map_of(room, flight)
        if not (flown.is_searched or flight.marker or flight.start != UNKNOWN):
            problem = "cannot be searched: neither scans nor landmarks find the camera in it"
            raise SettingError("ROOM", problem, "write a start or a marker into flight.toml")
    cv2.setNumThreads(1)  # as in a flight
    summary = FlightSummary()
    preflight = Preflight(
        flown.provenance,
        tells_gravity(flown, flight.settings),
        flown.scale_sd(),
        flown.has_landmarks(),
        flight.mount.roll_deg,
        flight.most_age_s,
        _faster(flight),
    )
    with naming(names), ExitStack() as opened:
        # The link first: it is looked at even where the camera fails.
        link = None if flight.mavlink is None else opened.enter_context(closing(AutopilotLink(flight.mavlink)))
        outputs: list[FlightOutput] = [preflight]
        mount = None
        for line in note_of_mount(flight, stated):
            stderr.print(line, soft_wrap=True)
        if link is not None and tells_gravity(flown, flight.settings):
            mount = MountCheck(frames_of(flown, flight.settings), link.attitude_at)
            outputs.append(mount)
        camera, failure = _look(flight, flown, frames, seconds, outputs, summary)
        errors = None if mount is None else mount.errors
        heard = None if link is None else _ask(link, flight, errors)
    findings = preflight.findings(summary, heard, failure)
    level = worst(findings)
    print_findings(f"{flight.source} in {room}", findings, level, json)
    content = {"level": level, "findings": [asdict(finding) for finding in findings], **summary.figures()}
    if report is not None:
        write_whole(report, json_text(bug_report(flight, flown.rooms(), camera, content)).encode() + b"\n")
        say_written(report)
    if json:
        print_json(content)
    return EXIT_CODES[level]


def _faster(flight: FlightFile) -> str:
    """What would make a step faster, of what the flight does not do already."""
    if flight.threads != 2:
        return "set threads = 2, then budget_ms"
    return "set budget_ms" if flight.budget_ms is None else "lower budget_ms, or the camera's rate"


def _look(
    flight: FlightFile,
    flown: FlownMap,
    frames: str,
    seconds: float,
    outputs: list[FlightOutput],
    summary: FlightSummary,
) -> tuple[Camera | None, DataError | None]:
    """Fly with the camera; its intrinsics, if it could be opened, and what ended the look too early.

    Raises:
        DataError: a recording cannot be read.
    """
    camera = None
    try:
        with ExitStack() as opened:
            frame_source, camera, first_pose, _ = open_frames(flight, frames, fast=False)
            opened.callback(frame_source.close)
            starting = starting_of(flight, flown.room, camera, first_pose, np.random.default_rng(0))
            made = flown.localizer(camera, starting.start, 0, flight.budget_ms, flight.threads)
            end_s = time.monotonic() + seconds
            Flight(
                made.localizer,
                camera,
                frame_source,
                outputs,
                flight.settings.most_age_s,
                starting,
                OtherSensors(),  # gravity by a wrong mount would turn the pose that the mount is checked by
                summary,
                made.in_place,
            ).run(lambda: time.monotonic() > end_s)
    except DataError as error:
        if not is_live(flight.source):
            raise
        return camera, error
    return camera, None


def _ask(link: AutopilotLink, flight: FlightFile, mount: MountErrors | None) -> LinkReport:
    """What the autopilot says of itself."""
    firmware, url = flight.firmware, flight.mavlink
    assert firmware is not None and url is not None  # check_autopilot
    is_stated = link.is_alive and link.firmware in (None, firmware)
    names = tuple(rule.name for rule in firmware.parameters)
    parameters = link.read_parameters(names, _PARAMETERS_S) if is_stated else {}
    address = parse_address(url)
    return LinkReport(
        firmware,
        link.firmware,
        link.is_alive,
        link.attitude_hz,
        link.round_trip_s,
        parameters,
        flight.settings,
        address.number / BITS_PER_BYTE if address.kind == "serial" else None,
        mount,
        link.hears_noise,
    )
