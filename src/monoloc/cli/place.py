"""``monoloc place``: several rooms with doors between them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from monoloc.cli.common import (
    DepthScaleOption,
    FixPosesOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    SeedOption,
    SourceArgument,
    open_source,
    print_figures,
    print_json,
    print_table,
    refuse_frames,
    say_written,
    stderr,
    text_of,
)
from monoloc.cli.output_checks import check_outputs, check_suffix
from monoloc.cli.signature import RequireSignatureOption
from monoloc.errors import DataError, SettingError
from monoloc.place.door_measurement import MeasuredDoor, measure_door, same_world_door
from monoloc.place.place_files import Place, check_place_target, make_place, read_place, replaced_doors, write_place
from monoloc.place.place_run import PlaceRun, localize_in_place
from monoloc.place.place_table import PlaceTable
from monoloc.place.place_update import updated_place
from monoloc.progress import ConsoleProgress

app = typer.Typer(help="Join rooms by doors, and localise across them.", no_args_is_help=True, rich_markup_mode=None)
PlaceArgument = Annotated[Path, typer.Argument(metavar="PLACE", help="Place, NAME.place.", show_default=False)]


@app.command()
def new(
    place: PlaceArgument,
    bundles: Annotated[
        list[Path], typer.Argument(metavar="BUNDLE", help="Bundles from monoloc build.", show_default=False)
    ],
    require_signature: RequireSignatureOption = None,
    json: JsonOption = False,
) -> None:
    """Make a place of bundles.

    A room has the name of its bundle, which stays where it is. A place with doors is not replaced.

    \b
    Examples:
      monoloc place new house.place kitchen.monoloc hall.monoloc study.monoloc
    """
    check_place_target(place)
    if doors := replaced_doors(place):
        raise DataError(
            place, f"exists, and its doors would be lost ({doors})", "name another place, or remove this one first"
        )
    made = make_place(place, bundles, require_signature)
    size = write_place(made)
    stderr.print(f"written: {place} (rooms: {len(made.names)}, doors: none yet)", soft_wrap=True)
    if json:
        print_json({"place": str(place), "rooms": made.names, "bytes": size})


@app.command()
def door(
    place: PlaceArgument,
    a: Annotated[
        str, typer.Argument(metavar="ROOM", help="Room on one side, named as its bundle.", show_default=False)
    ],
    b: Annotated[
        str,
        typer.Argument(metavar="NEXT_ROOM", help="Room on the other side, named as its bundle.", show_default=False),
    ],
    source: Annotated[
        str | None, typer.Argument(metavar="SOURCE", help="Recording of a walk through the door.")
    ] = None,
    frames: FramesOption = "::",
    same_world: Annotated[
        bool, typer.Option("--same-world", help="Both bundles have one world (not checked); no recording needed.")
    ] = False,
    intrinsics: IntrinsicsOption = None,
    require_signature: RequireSignatureOption = None,
    json: JsonOption = False,
) -> None:
    """Measure a door between two rooms by a walk through it.

    Landmarks of both rooms localise the camera along the walk. The new door replaces one at the same place.

    \b
    Examples:
      monoloc place door house.place kitchen hall door.mp4 --camera cam.toml
      monoloc place door house.place hall study --same-world
    """
    if source is None and not same_world:
        fix = "name a walk through the door, or give --same-world for bundles of one world"
        raise SettingError("SOURCE", "is missing", fix)
    if source is not None and same_world:
        raise SettingError("--same-world", "has no meaning with a walk through the door", "give one of the two")
    joined = read_place(place, require_signature, is_edited=True)
    names = _known(joined, a), _known(joined, b)
    if a == b:
        raise SettingError("ROOM", f"{a} is named twice", "name two rooms")
    recording = None if source is None else open_source(source, frames, intrinsics)
    if recording is None:
        refuse_frames(frames, "--same-world")
    rooms = joined.read_room(a), joined.read_room(b)
    if recording is None:
        measured = same_world_door(names, rooms)
    else:
        cv2.setNumThreads(1)
        measured = measure_door(names, rooms, recording, ConsoleProgress(stderr))
    write_place(joined.with_door(measured.door))
    content = {"place": str(place), **_described(measured)}
    print_figures(str(place), content, json)


@app.command()
def update(place: PlaceArgument, require_signature: RequireSignatureOption = None, json: JsonOption = False) -> None:
    """Take in the edits of a place's bundles; the doors stay.

    Edits keep the world of a room. A bundle that was built anew is refused, since its world may be another.

    \b
    Examples:
      monoloc place update house.place
    """
    updated, edits = updated_place(place, require_signature)
    size = write_place(updated) if edits else None
    if json:
        print_json({"place": str(place), "edits": edits, "bytes": size})
    elif edits:
        print_table(str(place), ["room", "edits taken in"], [[name, str(count)] for name, count in edits.items()])
        say_written(place)
    else:
        stderr.print(f"{place} has its bundles as they are", soft_wrap=True)


@app.command()
def info(place: PlaceArgument, require_signature: RequireSignatureOption = None, json: JsonOption = False) -> None:
    """Describe a place, and check that its bundles are there and unchanged.

    \b
    Examples:
      monoloc place info house.place
    """
    read = read_place(place, require_signature)
    rooms = [
        {
            "name": room.name,
            "bundle": room.bundle,
            "index_bytes": descriptors.nbytes,
            "doors_to": [each.beyond(room.name) for each in read.doors_of(room.name)],
        }
        for room, descriptors in zip(read.manifest.rooms, read.descriptors, strict=True)
    ]
    if json:
        doors = [each.model_dump(mode="json") for each in read.manifest.doors]
        print_json(
            {"place": str(place), "schema_version": read.manifest.schema_version, "rooms": rooms, "doors": doors}
        )
        return
    rows = [[text_of(value) for value in room.values()] for room in rooms]
    print_table(str(place), ["room", "bundle", "bytes of index", "doors to"], rows)


@app.command("localize")
def localize_in(
    place: PlaceArgument,
    source: SourceArgument,
    frames: FramesOption = "::",
    truth_room: Annotated[
        str | None,
        typer.Option("--truth-room", metavar="ROOM", help="Room in whose world the recording's poses are."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.csv", help="Table to write: poses, states and rooms.")
    ] = None,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    fix_poses: FixPosesOption = None,
    require_signature: RequireSignatureOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Find a camera in a place, and follow it from room to room.

    \b
    Examples:
      monoloc place localize house.place flight.mp4 --camera cam.toml --out flight.csv
      monoloc place localize house.place tum:walk --truth-room kitchen --json
    """
    check_outputs({"--out": out}, (place, source, require_signature))
    check_suffix(out, "--out", ".csv", "a table")
    read = read_place(place, require_signature)
    recording = open_source(source, frames, intrinsics, depth_scale, fix_poses=fix_poses)
    if truth_room is not None:
        _known(read, truth_room, "--truth-room")
        if recording.poses is None:
            raise SettingError("--truth-room", "is given, but the recording has no poses", "leave it out")
    cv2.setNumThreads(1)  # as in monoloc localize
    table = None if out is None else PlaceTable(out)
    run = localize_in_place(read, recording, seed, ConsoleProgress(stderr), table)
    for room, problem in run.unreadable.items():
        stderr.print(f"warning: room {room} was not entered: {problem}", soft_wrap=True)
    if table is not None:
        table.write()
        say_written(out)
    content: dict[str, object] = {"place": str(place), "source": source, "seed": seed, **run.metrics()}
    if truth_room is not None and recording.poses is not None:
        content |= run.errors(read, np.asarray(recording.poses), truth_room)
    if json:
        print_json(content)
    else:
        _show(content, run)


def _known(place: Place, room: str, field: str = "ROOM") -> str:
    if room not in place.names:
        raise SettingError(field, f"{room} is no room of {place.path}", f"name one of {', '.join(place.names)}")
    return room


def _described(measured: MeasuredDoor) -> dict[str, object]:
    described: dict[str, object] = {"by": measured.by}
    if measured.by != "same world":  # there, no frame was looked at
        in_a, in_b, in_both = measured.frames
        described |= {"frames_in_a": in_a, "frames_in_b": in_b, "frames_in_both": in_both}
        described["agreeing"] = measured.agreeing
    return described | measured.door.model_dump(mode="json")


def _show(content: dict[str, object], run: PlaceRun) -> None:
    rows = [[f"{each.time_s:.1f} s", each.before or "(search)", each.after] for each in run.switches]
    if rows:
        print_table("Entries", ["", "from", "to"], rows)
    shown = {name: value for name, value in content.items() if name != "switches"}
    print_figures("Frames", shown, json=False)
