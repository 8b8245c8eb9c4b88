"""``monoloc map edit``: change the map of a bundle in place, and take changes back."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer.core import TyperGroup

from monoloc.bundle import Bundle, digest_of, read_bundle, write_bundle
from monoloc.bundle_signature import SIGNATURE
from monoloc.cli.bundle_output import check_bundle_output, note_replaced
from monoloc.cli.common import (
    DepthScaleOption,
    FixDepthOption,
    FixPosesOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    SeedOption,
    SourceArgument,
    naming,
    open_cloud,
    open_source,
    print_json,
    print_table,
    stderr,
    text_of,
)
from monoloc.edit_record import EditRecord
from monoloc.editing.box import Box, parse_box, parse_numbers
from monoloc.editing.changed_region import read_changed_region
from monoloc.editing.edits import add, move, remove
from monoloc.editing.extension import extend, merge
from monoloc.editing.paired_map import down_direction
from monoloc.editing.unchanged import AsFound
from monoloc.editing.undo import undone
from monoloc.errors import BundleError, SettingError
from monoloc.files import target_of
from monoloc.geometry import FloatArray, make_pose, so3_exp, transform


class _BundleFirst(TyperGroup):
    """Says so if what to do comes before the bundle."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        first = str(ctx.params["bundle"])
        if args and first in self.commands and args[0] not in self.commands:
            # An option, such as --help, is no bundle.
            bundle, others = ("BUNDLE", args) if args[0].startswith("-") else (args[0], args[1:])
            command = shlex.join(["monoloc", "map", "edit", bundle, first, *others])
            raise SettingError("BUNDLE", f"comes before {first}", f"write: {command}")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=_BundleFirst,
    help="Change the map of a bundle: BUNDLE, then what to do.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

_COUNTS = ("components", "landmarks", "reference_poses")  # of an edit's changes: numbers before and after it
_BOX = "X,Y,Z,X,Y,Z"
BoxOption = Annotated[
    str | None, typer.Option("--box", metavar=_BOX, help="Two opposite corners, world frame, metres.")
]
YawOption = Annotated[
    float, typer.Option("--yaw", help="Turn the box about the vertical through its centre, degrees, right-handed.")
]
ChangedOption = Annotated[
    Path | None,
    typer.Option("--changed", metavar="RUN.json", help="The region that localize --json named in place of a box."),
]
TurnOption = Annotated[float, typer.Option("--turn", help="About the vertical, degrees, right-handed.")]
OutOption = Annotated[Path | None, typer.Option("--out", "-o", help="Bundle to write. [the same]")]


@dataclass(frozen=True)
class _Target:
    """The bundle that the command line names before the subcommand."""

    path: Path

    def edit(self, out: Path | None, json: bool, change: Callable[[Bundle], Bundle], *inputs: Path | str) -> None:
        """Read, change and write the bundle, and print what changed."""
        target = out or self.path
        if out is not None:
            check_bundle_output(out, inputs)
            if target_of(out) != target_of(self.path):
                note_replaced(out)
        found = AsFound.of(target_of(target))
        bundle = read_bundle(self.path)
        began = time.perf_counter()
        edited = change(bundle)
        seconds = time.perf_counter() - began
        with found.held():
            was_signed = (target / SIGNATURE).is_file()
            size = write_bundle(target_of(target), edited)
        if was_signed:
            stderr.print(f"note: {target}: its signature is void and was removed; sign it again", soft_wrap=True)
        content: dict[str, object] = {"bundle": str(target), "bytes": size, "seconds": round(seconds, 3)}
        if len(edited.edits) >= len(bundle.edits):  # as many where the first one was dropped
            last = edited.edits[-1]
            content |= {**last.record.model_dump(mode="json"), "undo_bytes": len(last.undo)}
            _remark(last.record)
        else:
            undone_edit = bundle.edits[-1].record
            content |= {"kind": "undo", "undone": undone_edit.model_dump(mode="json")}
            if undone_edit.kind == "update":
                stderr.print("note: what its flights showed is used up; two new flights can propose it again")
        if json:
            print_json(content)
        else:
            print_table(str(target), ["", ""], [[name, text_of(value)] for name, value in _readable(content).items()])


@app.callback()
def edit(
    context: typer.Context,
    bundle: Annotated[Path, typer.Argument(help="Bundle from monoloc build.", show_default=False)],
) -> None:
    """Change the map of a bundle: what stands elsewhere, is new or is gone.

    \b
    Examples:
      monoloc map edit kitchen.monoloc remove --box -0.5,0.2,1.8,0.3,0.9,2.6
      monoloc map edit kitchen.monoloc log
    """
    context.obj = _Target(bundle)


@app.command("remove")
def remove_command(
    context: typer.Context,
    box: BoxOption = None,
    changed: ChangedOption = None,
    yaw: YawOption = 0.0,
    out: OutOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Take away what lies in a box, or in the region that a run named as changed.

    \b
    Examples:
      monoloc map edit kitchen.monoloc remove --box -0.5,0.2,1.8,0.3,0.9,2.6 --yaw 30
      monoloc map edit kitchen.monoloc remove --changed run.json --out without-chair.monoloc
    """
    _check_angle(yaw, "--yaw")
    rng = np.random.default_rng(seed)
    named = {"changed": str(changed)} if changed is not None else {}
    corners = _corners(_target(context).path, box, changed)
    inputs = [] if changed is None else [changed]
    _target(context).edit(
        out,
        json,
        lambda bundle: remove(bundle, _box(bundle, corners, yaw), {**_box_parameters(corners, yaw), **named}, rng),
        *inputs,
    )


@app.command("add")
def add_command(
    context: typer.Context,
    cloud: Annotated[Path, typer.Argument(help="Cloud (ply, pcd, xyz, txt, csv, npz), metres.", show_default=False)],
    at: Annotated[
        str | None,
        typer.Option("--at", metavar="X,Y,Z", help="Where the cloud's origin is to be. [the cloud is in the world]"),
    ] = None,
    turn: TurnOption = 0.0,
    out: OutOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Add a cloud: one in the bundle's world, or an object's with a place.

    The axes of an object's cloud are those of the map's world, which need not be upright: "down" of monoloc inspect
    is the direction of gravity in them.

    \b
    Examples:
      monoloc map edit kitchen.monoloc add new-shelf.ply
      monoloc map edit kitchen.monoloc add chair.ply --at 0.4,1.1,2.0 --turn 90
    """
    place = np.zeros(3) if at is None else parse_numbers(at, 3, "X,Y,Z", "--at")
    _check_angle(turn, "--turn")
    points = open_cloud(cloud)
    rng = np.random.default_rng(seed)
    parameters = {"cloud": cloud.name, "at": place.tolist(), "turn_deg": turn}

    def change(bundle: Bundle) -> Bundle:
        pose = make_pose(_turned(bundle, turn), place)
        return add(bundle, transform(pose, points), parameters, rng)

    _target(context).edit(out, json, change, cloud)


@app.command("move")
def move_command(
    context: typer.Context,
    by: Annotated[str, typer.Option("--by", metavar="DX,DY,DZ", help="Shift, world frame, metres.")] = "0,0,0",
    turn: TurnOption = 0.0,
    box: BoxOption = None,
    changed: ChangedOption = None,
    yaw: YawOption = 0.0,
    out: OutOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Move what lies in a box: a turn about the vertical through its centre, then a shift.

    \b
    Examples:
      monoloc map edit kitchen.monoloc move --box -0.5,0.2,1.8,0.3,0.9,2.6 --by 0.4,0,0 --turn 15
    """
    shift = parse_numbers(by, 3, "DX,DY,DZ", "--by")
    _check_angle(turn, "--turn")
    _check_angle(yaw, "--yaw")
    if not np.any(shift) and turn == 0.0:
        raise SettingError("--by", "moves nothing", "give a shift, or --turn")
    corners = _corners(_target(context).path, box, changed)
    rng = np.random.default_rng(seed)
    parameters = {**_box_parameters(corners, yaw), "by_m": shift.tolist(), "turn_deg": turn}
    inputs = [] if changed is None else [changed]

    def change(bundle: Bundle) -> Bundle:
        where = _box(bundle, corners, yaw)
        rotation = _turned(bundle, turn)
        T_new_old = make_pose(rotation, where.centre + shift - rotation @ where.centre)
        with naming({"by": "--by"}):
            return move(bundle, where, T_new_old, parameters, rng)

    _target(context).edit(out, json, change, *inputs)


@app.command("extend")
def extend_command(
    context: typer.Context,
    source: SourceArgument,
    frames: FramesOption = "::",
    align: Annotated[
        bool, typer.Option("--align", help="Find where the recording's world lies in the room. [it is the room's]")
    ] = False,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    fix_poses: FixPosesOption = None,
    fix_depth: FixDepthOption = None,
    out: OutOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Extend the map by another recording with poses and depth: what the map does not know yet is added.

    \b
    Examples:
      monoloc map edit kitchen.monoloc extend 7scenes:redkitchen --frames 200:300
      monoloc map edit kitchen.monoloc extend folder:second-walk --align
    """
    recording = open_source(source, frames, intrinsics, depth_scale, fix_poses=fix_poses, fix_depth=fix_depth)
    rng = np.random.default_rng(seed)
    parameters = {"source": recording.name, "frames": frames, "align": align}
    _target(context).edit(out, json, lambda bundle: extend(bundle, recording, align, parameters, rng), source)


@app.command("merge")
def merge_command(
    context: typer.Context,
    other: Annotated[Path, typer.Argument(help="Bundle of a part that overlaps.", show_default=False)],
    out: OutOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Merge another bundle's map into this one: it is placed by its landmarks, then by its surfaces.

    The network, the camera and the settings stay this bundle's.

    \b
    Examples:
      monoloc map edit kitchen.monoloc merge hall.monoloc --out home.monoloc
    """
    target = _target(context)
    if digest_of(other) == digest_of(target.path):
        raise SettingError("OTHER", f"{other} is the same bundle", "name one of another part")
    part = read_bundle(other)
    rng = np.random.default_rng(seed)
    parameters = {"bundle": other.name}
    target.edit(out, json, lambda bundle: merge(bundle, part, str(other), parameters, rng), other)


@app.command("undo")
def undo_command(context: typer.Context, out: OutOption = None, json: JsonOption = False) -> None:
    """Take back the last edit.

    \b
    Examples:
      monoloc map edit kitchen.monoloc undo
    """
    target = _target(context)

    def change(bundle: Bundle) -> Bundle:
        try:
            return undone(bundle)
        except ValueError as error:
            raise BundleError(target.path, str(error), "copy the bundle again or rebuild it") from error

    target.edit(out, json, change)


@app.command("log")
def log_command(context: typer.Context, json: JsonOption = False) -> None:
    """List the edits of a bundle, the last one last.

    \b
    Examples:
      monoloc map edit kitchen.monoloc log --json
    """
    path = _target(context).path
    edits = [
        {**each.record.model_dump(mode="json"), "undo_bytes": len(each.undo)} for each in read_bundle(path).edits
    ]
    if json:
        print_json({"bundle": str(path), "edits": edits})
        return
    for number, each in enumerate(edits):
        values = {**each["parameters"], **_readable(each["changes"])}
        described = "; ".join(f"{name} {text_of(value)}" for name, value in values.items())
        typer.echo(f"{number + 1}  {each['time']}  {each['kind']}: {described}")
    if not edits:
        stderr.print(f"{path}: the map is as it was built", soft_wrap=True)


def _target(context: typer.Context) -> _Target:
    target = context.obj
    assert isinstance(target, _Target)
    return target


def _readable(values: dict[str, Any]) -> dict[str, Any]:
    """The same for a text, with numbers before and after an edit, in dicts of it too, as ``before -> after``."""
    shown = dict(values)
    for name, value in values.items():
        if name in _COUNTS:
            shown[name] = " -> ".join(map(str, value))
        elif isinstance(value, dict):
            shown[name] = _readable(value)
    return shown


def _remark(record: EditRecord) -> None:
    """Say what the record of an addition holds against it."""
    changes, source = record.changes, record.parameters.get("source", record.parameters.get("cloud"))
    for warning in changes.get("warnings", []):
        stderr.print(f"warning: {source}: {warning}", soft_wrap=True)
    if left_out := changes.get("frames_left_out"):
        note = f"frames that the map was made of are left out ({left_out})"
        stderr.print(f"note: {source}: {note}", soft_wrap=True)
    names = ("confirmed_by_landmarks", "contradicted_by_landmarks", "looked_at")
    confirmed, contradicted, looked_at = (changes.get(f"frames_{name}", 0) for name in names)
    has_landmarks = changes["landmarks"][0] > 0
    if has_landmarks and looked_at and confirmed <= contradicted:
        found = f"landmarks of the map confirm the poses of {confirmed} of {looked_at} frames that were looked at"
        fix = "unless it shows another part of the room, undo, and extend with --align"
        stderr.print(f"warning: {source}: {found}; {fix}", soft_wrap=True)


def _check_angle(degrees: float, option: str) -> None:
    if not np.isfinite(degrees):
        raise SettingError(option, f"is {degrees}", "give degrees, such as 90")


def _corners(bundle: Path, box: str | None, changed: Path | None) -> tuple[FloatArray, FloatArray]:
    """Corners of the box that one of two options gives.

    Raises:
        DataError, BundleError: as :func:`monoloc.editing.changed_region.read_changed_region`.
        SettingError: both do, or neither.
    """
    if (box is None) == (changed is None):
        problem = "is missing" if box is None else "and --changed both name a region"
        raise SettingError("--box", problem, f"give one of --box {_BOX} and --changed RUN.json")
    if changed is not None:
        return read_changed_region(changed, bundle)
    assert box is not None
    return parse_box(box, "--box")


def _box(bundle: Bundle, corners: tuple[FloatArray, FloatArray], yaw_deg: float) -> Box:
    return Box.between(*corners, _down_for(bundle, yaw_deg, "--yaw"), float(np.deg2rad(yaw_deg)))


def _box_parameters(corners: tuple[FloatArray, FloatArray], yaw_deg: float) -> dict[str, object]:
    lower, upper = corners
    return {"lower_m": lower.tolist(), "upper_m": upper.tolist(), "yaw_deg": yaw_deg}


def _turned(bundle: Bundle, turn_deg: float) -> FloatArray:
    """Rotation about the upward direction, (3, 3)."""
    return so3_exp(-np.deg2rad(turn_deg) * _down_for(bundle, turn_deg, "--turn"))


def _down_for(bundle: Bundle, turn_deg: float, option: str) -> FloatArray:
    """Down, (3,), and a warning where a turn is about an axis that may be tilted."""
    if turn_deg != 0.0 and bundle.down is None:
        problem = "is about the cameras' mean direction, since the map does not tell that of gravity"
        stderr.print(f"warning: {option}: {problem}; look at the map, and undo if it is tilted", soft_wrap=True)
    return down_direction(bundle)
