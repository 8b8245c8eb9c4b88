"""``monoloc doctor``: check camera, room and autopilot before the first arm."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import cv2
import typer

from monoloc.bundle import read_bundle
from monoloc.cli.common import FramesOption, IntrinsicsOption, JsonOption, print_json
from monoloc.cli.findings import EXIT_CODES, print_findings
from monoloc.cli.fly import check_autopilot, open_frames
from monoloc.config import load_settings
from monoloc.errors import SettingError
from monoloc.flight.autopilot import gravity_of
from monoloc.flight.flight_loop import Flight, FlightSummary
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.preflight import LinkReport, Preflight
from monoloc.localizer import Localizer
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.mavlink.firmware import Firmware
from monoloc.recording_check.inspection import worst

_PARAMETERS_S = 5.0  # to wait for the autopilot's parameters


def doctor(
    room: Annotated[Path, typer.Argument(metavar="ROOM", help="Bundle from monoloc build.", show_default=False)],
    source: Annotated[
        str, typer.Argument(metavar="SOURCE", help="As for monoloc fly; the camera sees the room.")
    ] = "camera:0",
    intrinsics: IntrinsicsOption = None,
    settings: Annotated[Path | None, typer.Option("--settings", help="TOML file, as for monoloc fly.")] = None,
    mavlink: Annotated[str | None, typer.Option("--mavlink", metavar="URL", help="As for monoloc fly.")] = None,
    firmware: Annotated[Firmware | None, typer.Option("--firmware", help="The autopilot's firmware.")] = None,
    seconds: Annotated[float, typer.Option("--seconds", min=1.0, max=600.0, help="How long to look.")] = 10.0,
    frames: FramesOption = "::",
    json: JsonOption = False,
) -> int:
    """Check camera, room and autopilot, without sending a pose.

    The exit code is 0 if all is well, 1 with warnings, and 2 if something must be mended before a flight.

    \b
    Examples:
      monoloc doctor room.monoloc camera:0 --camera cam.toml
      monoloc doctor room.monoloc camera:0 --camera cam.toml --mavlink serial:/dev/ttyAMA0:921600 --firmware px4
    """
    check_autopilot(mavlink, firmware, align=False, fast=False)
    flight_settings = FlightSettings() if settings is None else load_settings(settings, FlightSettings)
    bundle = read_bundle(room)
    if not bundle.supports_relocalization:
        problem = "cannot be searched: neither scans nor landmarks find the camera in it"
        raise SettingError("ROOM", problem, "fly it with --start; the doctor has no start")
    cv2.setNumThreads(1)  # as in a flight
    summary, preflight = FlightSummary(), Preflight()
    with ExitStack() as opened:
        frame_source, camera, _ = open_frames(source, frames, intrinsics, fast=False)
        opened.callback(frame_source.close)
        link = None if mavlink is None else opened.enter_context(closing(AutopilotLink(mavlink)))
        end_s = time.monotonic() + seconds
        Flight(
            Localizer(bundle, camera),
            camera,
            frame_source,
            [preflight],
            flight_settings.most_age_s,
            gravity_of(bundle, link, flight_settings),
            lambda: time.monotonic() > end_s,
            summary,
        ).run()
        report = None if link is None or firmware is None else _ask(link, firmware)
    findings = preflight.findings(summary, report)
    level = worst(findings)
    print_findings(f"{source} in {room}", findings, level)
    if json:
        content = {"level": level, "findings": [asdict(finding) for finding in findings]}
        print_json({**content, **summary.figures()})
    return EXIT_CODES[level]


def _ask(link: AutopilotLink, firmware: Firmware) -> LinkReport:
    """What the autopilot says of itself."""
    names = tuple(rule.name for rule in firmware.parameters)
    parameters = link.read_parameters(names, _PARAMETERS_S) if link.is_alive else {}
    has_attitude = link.attitude_at(time.monotonic()) is not None
    return LinkReport(firmware, link.is_alive, has_attitude, link.round_trip_s, parameters)
