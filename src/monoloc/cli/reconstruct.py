"""``monoloc reconstruct``: poses and depth of a video, as a recording."""

from __future__ import annotations

from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.cli.common import (
    DepthScaleOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    ScaleOption,
    SeedOption,
    SourceArgument,
    naming,
    note,
    open_source,
    print_json,
    say_written,
    stderr,
)
from monoloc.cli.output_checks import check_apart, check_folder, check_outputs, check_picture, check_suffix
from monoloc.errors import SettingError
from monoloc.io.camera_file import write_camera
from monoloc.io.folder_writer import require_empty, write_folder
from monoloc.io.recording import Recording
from monoloc.io.video import has_guessed_camera
from monoloc.progress import ConsoleProgress
from monoloc.structure_from_motion.reconstruction import Reconstruction, reconstruct
from monoloc.structure_from_motion.scale_option import parse_scale
from monoloc.viz.reconstruction_drawing import plot_reconstruction


def reconstruct_command(
    source: SourceArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to make, a recording.")],
    frames: FramesOption = "::",
    scale: ScaleOption = None,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    camera_out: Annotated[
        Path | None, typer.Option("--camera-out", metavar="FILE.toml", help="Write the intrinsics that were found.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw cameras, points and depth.")
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Find poses and depth of a video by structure from motion.

    Other images without poses work too. The result is a recording like any other: look at it, check it, build from
    it. Poses of the source are not used. docs/how-to/map-from-a-video.md says how to film, and what can give the
    scale. The file of a distance names frames by their numbers in the video, from 000000; images in --out are
    renumbered.

    \b
    Examples:
      monoloc reconstruct walk.mp4 --out walk --scale marker:7:0.16 --plot walk.png
      monoloc reconstruct walk.mp4 --camera cam.toml --scale distance:door.toml --out walk
      monoloc reconstruct walk.mp4 --out walk --camera-out cam.toml
    """
    check_folder(out, "--out")
    check_apart(out, "--out", (source,))
    require_empty(out)
    check_outputs({"--camera-out": camera_out, "--plot": plot}, (source,))
    check_suffix(camera_out, "--camera-out", ".toml", "a camera file")
    check_picture(plot, "--plot")
    recording = open_source(source, frames, intrinsics, depth_scale, guesses_camera=True)
    if camera_out is not None and not has_guessed_camera(recording):
        raise SettingError("--camera-out", "has no meaning where the intrinsics are given", "leave it out")
    found = reconstruct_source(recording, scale, seed)
    write_folder(out, found.recording, found.depths, ConsoleProgress(stderr))
    if camera_out is not None:
        write_camera(camera_out, found.model.camera, _provenance(found))
    if plot is not None:
        plot_reconstruction(plot, found, title=source)
    say_written(camera_out, plot)
    if json:
        print_json({"source": source, "out": str(out), **_figures(found)})
        return
    for name, sd in found.model.camera_sd.items():
        value = found.model.camera.fx if name == "f" else found.model.camera.distortion[int(name[1:]) - 1]
        stderr.print(f"{name}: {value:.5g} ± {sd:.2g}")
    stderr.print(
        f"{out}: {len(found.recording)} frames, {len(found.model.points)} points, reprojected within "
        f"{found.model.reprojection_px():.2f} px (RMS)",
        soft_wrap=True,
    )


def reconstruct_source(recording: Recording, scale: str | None, seed: int) -> Reconstruction:
    """Reconstruct what a command opened, and print the notes on stderr.

    Raises:
        MissingExtraError, SettingError, DataError: as :func:`reconstruct` and :func:`parse_scale`.
    """
    with naming({"scale": "--scale"}):
        chosen = parse_scale(scale, recording.has_depth)
        found = reconstruct(recording, chosen, has_guessed_camera(recording), seed, ConsoleProgress(stderr))
    for line in found.recording.notes:
        note(recording.name, line)
    return found


def _provenance(found: Reconstruction) -> dict[str, float | int | str]:
    return {
        "date": date.today().isoformat(),
        "structure_from_motion": found.recording.name,
        "views": len(found.recording),
        "rms_px": round(found.model.reprojection_px(), 4),
        **{f"sd_{name}": float(f"{sd:.4g}") for name, sd in found.model.camera_sd.items()},
    }


def _figures(found: Reconstruction) -> dict[str, object]:
    model = found.model
    return {
        "keyframes": model.tried,
        "frames": len(model.frames),
        "points": len(model.points),
        "reprojection_px": model.reprojection_px(),
        "depth_share": float(np.mean([np.mean(depth > 0.0) for depth in found.depths])),
        "scale_sd": found.scale.sd,
        "scale_by": found.scale.how,
        "is_upright": found.is_upright,
        "camera": asdict(model.camera),
        "camera_sd": model.camera_sd,
    }
