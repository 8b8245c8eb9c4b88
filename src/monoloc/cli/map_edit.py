"""``monoloc map edit``: change the map of a bundle in place, and take changes back."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer.core import TyperGroup

from monoloc.bundle import Bundle, digest_of, read_bundle
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
    stderr,
    text_of,
)
from monoloc.cli.edit_region import (
    BoxOption,
    ChangedOption,
    TurnOption,
    YawOption,
    box_of,
    box_parameters,
    check_angle,
    corners_of,
    turn_of,
)
from monoloc.cli.edit_target import EditTarget, edit_target, readable
from monoloc.editing.box import parse_numbers
from monoloc.editing.edits import add, move, remove
from monoloc.editing.extension import extend, merge
from monoloc.editing.undo import undone
from monoloc.errors import BundleError, SettingError
from monoloc.geometry import make_pose, transform


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

OutOption = Annotated[Path | None, typer.Option("--out", "-o", help="Bundle to write. [the same]")]


@app.callback()
def edit(
    context: typer.Context,
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="Bundle from monoloc build.", show_default=False)],
) -> None:
    """Change the map of a bundle: what stands elsewhere, is new or is gone.

    \b
    Examples:
      monoloc map edit kitchen.monoloc remove --box -0.5,0.2,1.8,0.3,0.9,2.6
      monoloc map edit kitchen.monoloc log
    """
    context.obj = EditTarget(bundle)


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
    """Remove what lies in a box, or in the region that a run named as changed.

    \b
    Examples:
      monoloc map edit kitchen.monoloc remove --box -0.5,0.2,1.8,0.3,0.9,2.6 --yaw 30
      monoloc map edit kitchen.monoloc remove --changed run.json --out without-chair.monoloc
    """
    check_angle(yaw, "--yaw")
    rng = np.random.default_rng(seed)
    corners = corners_of(edit_target(context).path, box, changed)
    inputs = [] if changed is None else [changed]
    parameters = box_parameters(corners, yaw, changed)

    def change(bundle: Bundle) -> Bundle:
        with naming({"box": "--box" if changed is None else "--changed"}):
            return remove(bundle, box_of(bundle, corners, yaw), parameters, rng)

    edit_target(context).edit(out, json, change, *inputs)


@app.command("add")
def add_command(
    context: typer.Context,
    cloud: Annotated[
        Path,
        typer.Argument(
            metavar="CLOUD", help="Cloud (ply, pcd, xyz, txt, csv, npz, points3D), metres.", show_default=False
        ),
    ],
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
    check_angle(turn, "--turn")
    points = open_cloud(cloud)
    rng = np.random.default_rng(seed)
    parameters = {"cloud": cloud.name, "at": place.tolist(), "turn_deg": turn}

    def change(bundle: Bundle) -> Bundle:
        pose = make_pose(turn_of(bundle, turn), place)
        return add(bundle, transform(pose, points), parameters, rng)

    edit_target(context).edit(out, json, change, cloud)


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
    check_angle(turn, "--turn")
    check_angle(yaw, "--yaw")
    if not np.any(shift) and turn == 0.0:
        raise SettingError("--by", "moves nothing", "give a shift, or --turn")
    corners = corners_of(edit_target(context).path, box, changed)
    rng = np.random.default_rng(seed)
    parameters = {**box_parameters(corners, yaw, changed), "by_m": shift.tolist(), "turn_deg": turn}
    inputs = [] if changed is None else [changed]

    def change(bundle: Bundle) -> Bundle:
        where = box_of(bundle, corners, yaw)
        rotation = turn_of(bundle, turn)
        T_new_old = make_pose(rotation, where.centre + shift - rotation @ where.centre)
        with naming({"by": "--by", "box": "--box" if changed is None else "--changed"}):
            return move(bundle, where, T_new_old, parameters, rng)

    edit_target(context).edit(out, json, change, *inputs)


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
    """Extend the map by another recording with poses and depth: what the map does not contain yet is added.

    \b
    Examples:
      monoloc map edit kitchen.monoloc extend 7scenes:redkitchen --frames 200:300
      monoloc map edit kitchen.monoloc extend folder:second-walk --align
    """
    recording = open_source(source, frames, intrinsics, depth_scale, fix_poses=fix_poses, fix_depth=fix_depth)
    rng = np.random.default_rng(seed)
    parameters = {"source": recording.name, "frames": frames, "align": align}
    edit_target(context).edit(out, json, lambda bundle: extend(bundle, recording, align, parameters, rng), source)


@app.command("merge")
def merge_command(
    context: typer.Context,
    other: Annotated[
        Path, typer.Argument(metavar="OTHER", help="Bundle of a part that overlaps.", show_default=False)
    ],
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
    target = edit_target(context)
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
    target = edit_target(context)

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
    path = edit_target(context).path
    edits = [
        {**each.record.model_dump(mode="json"), "undo_bytes": len(each.undo)} for each in read_bundle(path).edits
    ]
    if json:
        print_json({"bundle": str(path), "edits": edits})
        return
    for number, each in enumerate(edits):
        values = {**each["parameters"], **readable(each["changes"])}
        described = "; ".join(f"{name} {text_of(value)}" for name, value in values.items()).replace("\n", ", ")
        typer.echo(f"{number + 1}  {each['time']}  {each['kind']}: {described}")
    if not edits:
        stderr.print(f"{path}: the map is as it was built", soft_wrap=True)
