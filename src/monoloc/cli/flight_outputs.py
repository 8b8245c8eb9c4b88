"""What a flight writes, shows, and says at its end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import get_args

from monoloc.camera import Camera
from monoloc.cli.common import print_json
from monoloc.cli.output_checks import check_apart, check_folder, check_outputs, check_suffix, check_viewing
from monoloc.errors import SettingError
from monoloc.extras import require_extra
from monoloc.files import target_of
from monoloc.flight.earlier_flight import earlier_name, keep_earlier
from monoloc.flight.flight_file import FlightFile
from monoloc.flight.flight_loop import FlightOutput, FlightSummary
from monoloc.flight.mcap_log import McapLog, step_recorder
from monoloc.flight.pose_log import BackgroundPoseLog
from monoloc.live.frame_source import FrameSource
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.obstacles import tells_obstacles
from monoloc.place.flown_map import FlownMap
from monoloc.step_budget import Level, budget_line, level_counts
from monoloc.supervision.state import State


def check_view(view: bool, port: int | None) -> None:
    """Check that a viewer can be shown, before anything is opened."""
    if view and port is not None:
        raise SettingError("--view-port", "is given beside --view", "choose between a window and a browser")
    check_viewing(view, instead="give --view-port PORT and open its page in a browser")
    if port is not None:
        require_extra("view")


def check_flight_outputs(flight: FlightFile, inputs: Sequence[str | Path | None]) -> None:
    """Check that what a flight is to write can be written, before anything is opened.

    Args:
        flight: names the outputs.
        inputs: see :func:`~monoloc.cli.output_checks.check_apart`.

    Raises:
        SettingError: an output is rejected; the error names the option.
        MissingExtraError: the library that writes MCAP is not installed.
    """
    check_suffix(flight.out, "--out", ".csv", "a table")
    check_suffix(flight.mcap, "--mcap", ".mcap", "MCAP")
    files = {"--out": flight.out, "--mcap": flight.mcap}
    check_outputs(files, inputs)
    if flight.mcap is not None:
        require_extra("mcap")
    if flight.record is not None:
        check_folder(flight.record, "--record")
        check_apart(flight.record, "--record", inputs)
        if flight.record.exists() and any(flight.record.iterdir()):
            raise SettingError("--record", f"{flight.record} is not empty", "name a new folder for this flight")
        record = target_of(flight.record)
        for option, path in files.items():  # the recording has a poses.csv of its own
            if path is not None and record == target_of(path):
                raise SettingError("--record", f"{flight.record} is what {option} writes", "name another folder")
            if path is not None and record in target_of(path).parents:
                raise SettingError(option, f"{path} lies in the folder of --record", "name another place")


def logs(
    flight: FlightFile, flown: FlownMap, camera: Camera, clock_offset_s: float, unwritten: Counter[str]
) -> Iterator[FlightOutput]:
    """What a flight writes of its results, beside a recording of it.

    Args:
        flight, flown, camera: of the flight.
        clock_offset_s: of the clock that counts from 1970, against that of the times of capture.
        unwritten: counts what the disk was too slow for.

    Raises:
        DataError: a file cannot be written.
        SettingError: the direction of gravity is along the room's x axis.
    """
    if flight.out is not None:
        yield BackgroundPoseLog(flight.out, unwritten, flown.is_place)
    if flight.mcap is not None:
        keep_earlier(flight.mcap)
        with_obstacles = flown.room is None or tells_obstacles(flown.room)
        recorder = step_recorder(flight.mcap, True, flown, camera, flight.settings, with_obstacles)
        yield McapLog(recorder, clock_offset_s, unwritten)


def notes_of_earlier(flight: FlightFile) -> Iterator[str]:
    """What is said before a flight whose tables or MCAP files are there already."""
    for path in (flight.out, flight.mcap):
        if path is not None and (name := earlier_name(path)) is not None:
            yield f"note: {path}: is there already, and is kept as {name.name}"


def report(
    summary: FlightSummary, source: FrameSource, link: AutopilotLink | None, say: Callable[[str], None], json: bool
) -> None:
    """Say what a flight came to, or print it as JSON."""
    figures = {**summary.figures(), "reconnections": source.reconnections}
    if link is not None:
        figures["autopilot"] = dict(link.counts)
    if json:
        print_json(figures)
        return
    states = ", ".join(f"{summary.states[state]} {state}" for state in get_args(State))
    rate_hz, median_s, most_s = summary.rate_hz, summary.latency_s(50.0), summary.latency_s(95.0)
    how = "" if rate_hz is None else f"; {rate_hz:.1f} Hz"
    if median_s is not None and most_s:  # else nothing took time: --fast
        how += f", {1e3 * median_s:.0f} ms after capture (95 %: {1e3 * most_s:.0f} ms)"
    say(f"{summary.frames} frames: {states}{how}")
    if summary.rooms is not None:
        rooms = ", ".join(f"{count} in {room}" for room, count in summary.rooms.items())
        say(f"rooms: {rooms or 'none found'}; entries: {len(summary.switches)}")
    dropped = ", ".join(f"{count} {reason}" for reason, count in summary.dropped.items() if count)
    say(f"dropped: {dropped or 'none'}; reconnections of the camera: {source.reconnections}")
    if poses := ", ".join(f"{count} {what}" for what, count in summary.poses.items() if count):
        say(f"poses for the autopilot: {poses}")
    if set(summary.levels) - {Level.FULL}:
        say(budget_line(level_counts(summary.levels)))
    if unwritten := ", ".join(f"{count} {what}" for what, count in summary.unwritten.items() if count):
        say(f"not written, since the disk was too slow: {unwritten}")
    if link is not None:
        messages = ", ".join(f"{count} {what}" for what, count in sorted(link.counts.items()))
        say(f"messages of the link to the autopilot: {messages or 'none'}")
