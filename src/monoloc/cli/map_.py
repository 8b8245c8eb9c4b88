"""``monoloc map``: fit, describe, draw, export and compare maps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.room_map import fit_map
from monoloc.bundle import read_bundle
from monoloc.cli import map_edit, map_localizability
from monoloc.cli.common import (
    FramesOption,
    JsonOption,
    RecordOption,
    SeedOption,
    ViewOption,
    naming,
    open_cloud,
    open_source,
    print_figures,
    refuse_frames,
    say_written,
    stderr,
)
from monoloc.cli.map_looking import export, info, render
from monoloc.cli.map_update import update
from monoloc.cli.output_checks import check_outputs, check_picture, check_suffix, check_viewing
from monoloc.config import override
from monoloc.editing.edit_history import drawn_edits
from monoloc.evaluation.cloud_metrics import COMPARED_POINTS, compare_clouds
from monoloc.io.cloud_files import CLOUD_SUFFIXES
from monoloc.io.registry import FORMATS
from monoloc.progress import ConsoleProgress
from monoloc.viz.map_drawing import plot_map_change
from monoloc.viz.viewer import show_map_change

app = typer.Typer(
    help="Fit, describe, draw, export and compare maps.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(map_edit.app, name="edit")
app.command()(info)
app.command()(render)
app.command()(export)
app.command("localizability")(map_localizability.command)
app.command()(update)


@app.command()
def fit(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE", help="Recording, or cloud (ply, pcd, xyz, txt, csv, npz, points3D).", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Map to write, NAME.npz.")],
    frames: FramesOption = "::",
    components: Annotated[
        str, typer.Option("--components", "-k", help="Gaussians, or 'bic' for automatic choice.")
    ] = "200",
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Fit a Gaussian mixture to a room.

    \b
    Examples:
      monoloc map fit 7scenes:redkitchen --frames ::4 --out kitchen.npz
      monoloc map fit room.ply -k bic --out room.npz
    """
    check_outputs({"--out": out}, (source,))
    check_suffix(out, "--out", ".npz", "a map")
    is_recording = any(known.recognises(Path(source)) for known in FORMATS.values())
    is_recording |= source.partition(":")[0] in FORMATS and not Path(source).exists()
    is_cloud = Path(source).suffix.lower() in CLOUD_SUFFIXES and not is_recording
    if is_cloud:
        refuse_frames(frames, "a cloud")
    with naming({"components": "--components"}):
        config = override(BuildConfig(), components=components)
        cloud = open_cloud(Path(source)) if is_cloud else None
        recording = None if cloud is not None else open_source(source, frames)
        cloud, mixture = fit_map(recording, cloud, config, np.random.default_rng(seed), ConsoleProgress(stderr))
    mixture.save(out)
    fitted = {
        "map": str(out),
        "cloud_points": len(cloud),
        "components": len(mixture),
        "bytes": mixture.nbytes_stored,
        "log_likelihood": float(mixture.log_density(cloud).mean()),
    }
    print_figures(str(out), fitted, json)


@app.command()
def compare(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="Bundle from monoloc build.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Picture to write. [compare.png, without --view and --record]"),
    ] = None,
    view: ViewOption = False,
    record: RecordOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Draw the map before and after adaptation: clouds, boxes, distances.

    Cloud-to-cloud (C2C) distances are those of points sampled from the original map to the nearest such point after
    adaptation.

    \b
    Examples:
      monoloc map compare kitchen.monoloc
      monoloc map compare kitchen.monoloc --out kitchen.png --json
      monoloc map compare kitchen.monoloc --view
    """
    if out is None and not view and record is None:
        out = Path("compare.png")
    check_outputs({"--out": out, "--record": record}, (bundle,))
    check_picture(out, "--out")
    check_viewing(view, record)
    room = read_bundle(bundle)
    rng = np.random.default_rng(seed)
    clouds = compare_clouds(room.original, room.adapted, COMPARED_POINTS, rng)
    edits = drawn_edits(room, rng)
    down = np.array(room.provenance.down_world)
    name = f"{bundle.name}: {room.provenance.recording}"
    content = dict(clouds.figures)
    if out is not None:
        plot_map_change(out, clouds, down, name, edits)
        content = {"picture": str(out), **content}
    print_figures(str(bundle), content, json)
    show_map_change(name, view, record, clouds, down, edits)  # last, so that a failure affects no other output
    say_written(record)
