"""``monoloc fly``: localise a live camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from monoloc.cli.common import (
    BudgetOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    SeedOption,
    ThreadsOption,
    naming,
    stderr,
)
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
from monoloc.cli.flight_outputs import check_flight_outputs, check_view, logs, notes_of_earlier, report
from monoloc.cli.signature import RequireSignatureOption
from monoloc.cli.start_option import METAVAR
from monoloc.cli.stop_signals import stopped_by_signals
from monoloc.errors import MonolocError
from monoloc.flight.autopilot import (
    down_world,
    frames_of,
    gravity_of,
    link_to,
    obstacle_frames,
    senders,
    turns_of,
)
from monoloc.flight.flight_file import FlightFile
from monoloc.flight.flight_inputs import OtherSensors
from monoloc.flight.flight_loop import Flight, FlightOutput, FlightSummary
from monoloc.flight.flight_recording import FlightHeader, FlightRecorder, RecordedStart
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.line_writer import LineWriter
from monoloc.flight.link_watch import LinkWatch
from monoloc.flight.mount_check import MountCheck
from monoloc.flight.north_measurement import NorthMeasurement
from monoloc.flight.preflight import GOOD_SCALE_SD
from monoloc.flight.status_output import StatusOutput
from monoloc.flight.watchdog_output import WatchdogOutput
from monoloc.place.flown_map import FlownMap, digest_of_map
from monoloc.viz.flight_view import flight_view


def fly(
    room: MapOrFlightArgument = None,
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="SOURCE",
            help="camera:0, picamera, realsense, oak, rtsp://..., - (motion JPEG on standard input), or a recording. "
            "[the file's, else camera:0]",
            show_default=False,
        ),
    ] = None,
    intrinsics: IntrinsicsOption = None,
    settings: SettingsOption = None,
    require_signature: RequireSignatureOption = None,
    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            metavar=METAVAR,
            help="First camera pose in a room; 'unknown', as without it, searches the map; 'truth' takes the "
            "recording's first pose.",
        ),
    ] = None,
    start_error_cm: Annotated[
        float | None, typer.Option("--start-error-cm", help="Position error of the start; 10 without it.")
    ] = None,
    start_error_deg: Annotated[
        float | None, typer.Option("--start-error-deg", help="Rotation error of the start; 3 without it.")
    ] = None,
    mavlink: MavlinkOption = None,
    firmware: FirmwareOption = None,
    align: Annotated[
        bool, typer.Option("--align", help="Only measure north_deg by the autopilot's yaw, and end.")
    ] = False,
    budget_ms: BudgetOption = None,
    threads: ThreadsOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            help="CSV to write: pose, covariance, state, reasons of each frame; %Y%m%d-%H%M%S stands for the start. "
            "An earlier file is kept as NAME-1.csv.",
        ),
    ] = None,
    mcap: Annotated[
        Path | None,
        typer.Option(
            "--mcap", metavar="FILE", help="MCAP to write (ROS 2): pose, transforms, state, obstacles, images."
        ),
    ] = None,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="DIR", help="Folder to write, for monoloc replay.")
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Show the flight in Rerun's window.")] = False,
    view_port: Annotated[
        int | None,
        typer.Option(
            "--view-port",
            min=1024,
            max=65534,
            metavar="PORT",
            help="Serve the flight to browsers, also on other computers.",
        ),
    ] = None,
    fast: Annotated[
        bool, typer.Option("--fast", help="Take every frame of a recording, as fast as possible.")
    ] = False,
    frames: FramesOption = "::",
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Localise a live camera, and send its pose to an autopilot.

    Ctrl-C, SIGTERM and a terminal that hangs up end a flight; its files are then complete. A flight file can hold
    all options but --settings, --align and those from --view on; options on the command line take precedence. In a
    place of several rooms, the camera is found in one of them and followed through doors.

    \b
    Examples:
      monoloc fly room.monoloc camera:0 --camera 640,480,525,525,319.5,239.5
      monoloc fly room.monoloc camera:0 --camera cam.toml --mavlink serial:/dev/ttyAMA0:921600 --firmware px4
      monoloc fly room.monoloc camera:0 --camera cam.toml --mavlink udpin:0.0.0.0:14550 --firmware ardupilot --align
      monoloc fly house.place camera:0 --camera cam.toml --out poses.csv
      monoloc fly flight.toml
      monoloc fly flight.toml rtsp://192.168.1.20/stream --record flight-%Y%m%d-%H%M%S
      monoloc fly room.monoloc 7scenes:redkitchen --frames 0:400 --out poses.csv --mcap flight.mcap
    """
    room, flight, names, stated = flight_of(
        room,
        settings,
        source=source,
        camera=intrinsics,
        require_signature=require_signature,
        start=start,
        start_error_cm=start_error_cm,
        start_error_deg=start_error_deg,
        mavlink=mavlink,
        firmware=firmware,
        budget_ms=budget_ms,
        threads=threads,
        out=out,
        mcap=mcap,
        record=record,
    )
    check_view(view, view_port)
    with naming(names):
        check_flight_outputs(flight, (room, flight.source, settings, flight.require_signature))
        check_autopilot(flight, align, fast)
        flown = map_of(room, flight)
    flight_settings, firmware = flight.settings, flight.firmware
    rng = np.random.default_rng(seed)
    cv2.setNumThreads(1)  # more do not speed up small images, and the drone needs its other cores
    summary, north = FlightSummary(), None
    with naming(names), stopped_by_signals() as stop, _lines() as say:
        status = StatusOutput(say, stderr.is_terminal, summary)
        outputs: list[FlightOutput] = [status]
        with ExitStack() as opened:
            frame_source, camera, first_pose, are_upright = open_frames(flight, frames, fast)
            opened.callback(frame_source.close)
            starting = starting_of(flight, flown.room, camera, first_pose, rng)
            made = flown.localizer(camera, starting.start, seed, flight.budget_ms, flight.threads)
            if firmware is not None:
                _check_map(flown, flight_settings, say)  # before anything is written, as the link and the view
            address = flight.mavlink
            link = None if address is None else opened.enter_context(closing(link_to(address, flight_settings)))
            if view or view_port is not None:
                shown = flight_view(
                    f"{room}: {frame_source.name}",  # anyone may look, and a source may hold a password
                    view_port,
                    flown.room,
                    camera,
                    obstacle_frames(flown, flight_settings),
                    made.particles,
                )
                output, remark = opened.enter_context(shown)
                outputs.append(output)
                say(remark)
            _say_all((*note_of_mount(flight, stated, align), *notes_of_earlier(flight)), say)
            waits_for_marker = starting.begins == "waiting"
            if flight.record is not None:
                header = FlightHeader(
                    bundle=str(room.resolve()),
                    digest=digest_of_map(room),
                    camera=camera,
                    start=RecordedStart.of(starting.start),
                    seed=seed,
                    settings=flight_settings,
                    firmware=None if align else firmware,
                    stands_upright=are_upright,
                    waits_for_marker=waits_for_marker,
                )
                outputs.append(FlightRecorder(flight.record, header, flown.is_place))
            clock_offset_s = 0.0 if fast else time.time() - frame_source.now_s()
            outputs += logs(flight, flown, camera, clock_offset_s, summary.unwritten)
            if link is not None and align:
                T_body_camera = flight_settings.mount.T_body_camera
                north = NorthMeasurement(T_body_camera, down_world(flown, flight_settings), link.attitude_at)
                outputs.append(north)
            elif firmware is not None:
                # The autopilot first: what is written may wait for a disk.
                outputs[:0] = senders(
                    link,
                    flight.record,
                    flown,
                    flown.room,
                    firmware,
                    flight_settings,
                    summary,
                    waits_for_marker,
                )
            if link is not None and firmware is not None:
                mount = MountCheck(frames_of(flown, flight_settings), link.attitude_at)
                outputs.append(LinkWatch(link, firmware, mount, status.say))
            # The watchdog last, which so is closed first: systemd must not count while the others write the rest.
            outputs.append(WatchdogOutput(summary))
            for output in outputs:
                opened.callback(_close, output, summary)
            loop = Flight(
                made.localizer,
                camera,
                frame_source,
                outputs,
                flight_settings.most_age_s,
                starting,
                OtherSensors(gravity_of(flown, link, flight_settings), turns_of(link)),
                summary,
                made.in_place,
            )
            _run(loop, lambda: stop() or (north is not None and north.is_done), summary)
        if north is not None and not summary.failures:
            north_deg, sd_deg = north.north_deg()
            say(f"north_deg = {north_deg:.1f}     (write it into flight.toml; varied by {sd_deg:.1f}°)")
        report(summary, frame_source, link, say, json)
        _say_written(flight, summary, say)
    if summary.failures:
        raise summary.failures[0]


def _say_all(lines: Iterable[str], say: Callable[[str], None]) -> None:
    for line in lines:
        say(line)


def _say_written(flight: FlightFile, summary: FlightSummary, say: Callable[[str], None]) -> None:
    """Name what was written, as all commands do; where an output failed, its error names it."""
    for path in () if summary.failures else (flight.out, flight.mcap, flight.record):
        if path is not None:
            say(f"written: {path}")


def _run(flight: Flight, stop: Callable[[], bool], summary: FlightSummary) -> None:
    """Fly. An error that ends a flight after its first frame is kept, to be raised once its summary is printed."""
    try:
        flight.run(stop)
    except MonolocError as error:
        if summary.frames == 0:
            raise
        summary.failures.insert(0, error)


def _close(output: FlightOutput, summary: FlightSummary) -> None:
    """Close an output. An error of its last writes is kept, as in :func:`_run`."""
    try:
        output.close()
    except MonolocError as error:
        summary.failures.append(error)


def _check_map(flown: FlownMap, settings: FlightSettings, say: Callable[[str], None]) -> None:
    """Whether the poses of a map are for an autopilot; raises as :func:`down_world`, warns of its scale."""
    down_world(flown, settings)
    scale_sd = flown.scale_sd()
    if scale_sd > GOOD_SCALE_SD:
        problem = f"the map's scale is known to {scale_sd:.0%}, and so are the distances in its messages"
        say(f"warning: {flown.path}: {problem}; build with --scale")


@contextmanager
def _lines() -> Iterator[Callable[[str], None]]:
    """Takes lines for standard error, which may be full or gone: a flight does not wait for it."""
    writer = LineWriter(stderr.file.fileno())
    try:
        yield writer.write
    finally:
        writer.close()
