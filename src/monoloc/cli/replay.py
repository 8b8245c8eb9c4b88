"""``monoloc replay``: compute a recorded flight again."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated

import cv2
import typer

from monoloc.cli.common import (
    BudgetOption,
    JsonOption,
    PlainConsole,
    naming,
    note,
    print_json,
    stderr,
)
from monoloc.cli.output_checks import check_outputs, check_suffix
from monoloc.errors import DataError
from monoloc.files import read_regular, write_whole
from monoloc.flight.autopilot import senders
from monoloc.flight.earlier_flight import earlier_name, keep_earlier
from monoloc.flight.flight_loop import FlightOutput, FlightSummary
from monoloc.flight.flight_recording import MESSAGES, POSES, FlightHeader, read_header
from monoloc.flight.pose_log import PoseLog
from monoloc.flight.recomputation import recompute
from monoloc.place.flown_map import FlownMap, digest_of_map, is_place, open_map
from monoloc.progress import ConsoleProgress
from monoloc.version import __version__


def replay(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder that monoloc fly recorded.", show_default=False)
    ],
    room: Annotated[
        Path | None,
        typer.Option("--room", help="The bundle or place, where it has moved since the flight."),
    ] = None,
    budget_ms: BudgetOption = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="CSV of the poses to write. An earlier file is kept as NAME-1.csv."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Compute a recorded flight again, and compare both.

    On the same machine, with the same version and map, poses and messages are what the flight computed and sent,
    to the last bit; what the flight left out to keep its budget is left out again. With --budget-ms, this budget
    decides instead.

    \b
    Examples:
      monoloc replay flight-1
      monoloc replay flight-1 --room copies/room.monoloc --out poses.csv
    """
    check_outputs({"--out": out}, (folder, room))
    check_suffix(out, "--out", ".csv", "a table")
    header = read_header(folder)
    flown = _map_of(header, room)
    recorded = _lines(folder / POSES)
    cv2.setNumThreads(1)  # as in the flight
    with tempfile.TemporaryDirectory() as made, ExitStack() as opened:
        again = Path(made)
        outputs: list[FlightOutput] = [PoseLog(again / POSES, flown.is_place)]
        if header.firmware is not None:
            outputs += senders(
                None,
                again,
                flown,
                flown.room,
                header.firmware,
                header.settings,
                FlightSummary(),
                header.waits_for_marker,
            )
        for output in outputs:
            opened.enter_context(closing(output))
        with (
            naming({"budget_ms": "--budget-ms"}),
            ConsoleProgress(stderr).task("replay", max(1, len(recorded) - 1)) as show,
        ):
            start = None if header.start is None else header.start.start
            fresh = flown.localizer(header.camera, start, header.seed, budget_ms)
            frames = recompute(folder, header, fresh.localizer, outputs, show, budget_ms is None, fresh.in_place)
        pairs = list(zip(recorded[1:], _lines(again / POSES)[1:], strict=False))
        if not pairs:
            raise DataError(folder / POSES, "holds no pose", "give another flight")
        different = [index for index, (before, now) in enumerate(pairs) if before != now]
        breaks_off = len(recorded) - 1 not in (frames, frames + 1)  # after a kill, the last pose may have no frame
        same_messages = None
        if header.firmware is not None:
            same_messages = _begins_with(folder / MESSAGES, again / MESSAGES, breaks_off)
        if out is not None:
            if (earlier := earlier_name(out)) is not None:  # perhaps the flight's own
                note(out, f"is there already, and is kept as {earlier.name}")
            keep_earlier(out)
            write_whole(out, read_regular(again / POSES))
    if breaks_off:
        found = f"holds {frames} whole frames and {len(recorded) - 1} poses: it was cut short, or not copied whole"
        note(folder, f"{found}; what both have is compared")
    _report(len(pairs), different, same_messages, header, json)


def _map_of(header: FlightHeader, room: Path | None) -> FlownMap:
    """The bundle or place of a flight: ``room``, or where it was then.

    Raises:
        BundleError, DataError: as :func:`open_map`, or there is nothing, or another one.
    """
    path = Path(header.bundle) if room is None else room
    kind = "place" if is_place(path) else "bundle"
    if room is None and not path.exists():
        raise DataError(
            path, f"was the {kind} of this flight, and is no longer there", "give its new path with --room"
        )
    if digest_of_map(path) != header.digest:
        raise DataError(path, f"is not the {kind} of this flight", "give that one with --room")
    return open_map(path)


def _lines(path: Path) -> list[bytes]:
    """Whole lines of a table; a last line that was cut is left out."""
    try:
        return [line for line in read_regular(path).splitlines(keepends=True) if line.endswith(b"\n")]
    except (OSError, ValueError) as error:
        raise DataError(path, "cannot be read", "give another flight") from error


def _begins_with(recorded: Path, again: Path, breaks_off: bool) -> bool:
    """Whether a file begins with another's content: after a kill, the last messages have no frame.

    Args:
        breaks_off: whether the recording does, so that its messages may be fewer.
    """
    try:
        before, now = read_regular(recorded), read_regular(again)
    except (OSError, ValueError) as error:
        raise DataError(recorded, "cannot be read", "give another flight") from error
    return before.startswith(now) or (breaks_off and before != b"" and now.startswith(before))


def _report(frames: int, different: list[int], same_messages: bool | None, header: FlightHeader, json: bool) -> None:
    if json:
        first = different[0] if different else None
        figures = {"frames": frames, "different_frames": len(different), "first_different_frame": first}
        print_json({**figures, "same_messages": same_messages})
        return
    console, version = PlainConsole(), header.monoloc_version
    other = "" if version == __version__ else f" (monoloc {version} computed it)"
    if different:
        console.print(f"{frames} frames: {len(different)} differ from the flight{other}, the first is {different[0]}")
    else:
        console.print(f"{frames} frames: every pose is the same to the last bit")
    if same_messages is not None:
        console.print("messages: the same to the last bit" if same_messages else f"messages: not the same{other}")
