"""``monoloc check``: check a recording against itself, and against a bundle."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.bundle import read_bundle
from monoloc.bundle_manifest import MANIFEST
from monoloc.cli.common import (
    DepthScaleOption,
    FixDepthOption,
    FixPosesOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    open_cloud,
    open_source,
    print_json,
    say_written,
    stderr,
)
from monoloc.cli.findings import EXIT_CODES, print_findings
from monoloc.cli.output_checks import check_outputs, check_picture
from monoloc.errors import SettingError
from monoloc.progress import ConsoleProgress
from monoloc.recording_check.inspection import Inspection, inspect_recording
from monoloc.viz.check_drawing import plot_check


def check(
    target: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE|BUNDLE", help="Recording, or a bundle to compare a recording with.", show_default=False
        ),
    ],
    source: Annotated[
        str | None, typer.Argument(metavar="SOURCE", help="Recording, after a bundle.", show_default=False)
    ] = None,
    frames: FramesOption = "::",
    cloud: Annotated[
        Path | None, typer.Option("--cloud", help="Cloud of the room, in the poses' world, if there is no depth.")
    ] = None,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    fix_poses: FixPosesOption = None,
    fix_depth: FixDepthOption = None,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw what was found.")] = None,
    json: JsonOption = False,
) -> int:
    """Check a recording before a build or a flight.

    The exit code is 0 if all is well, 1 with warnings, and 2 if a build would refuse the recording.

    \b
    Examples:
      monoloc check my-recording
      monoloc check 7scenes:redkitchen --frames 0:400 --plot check.png
      monoloc check my-recording --fix-poses opengl
      monoloc check kitchen.monoloc second-recording
    """
    bundle_path, source = (None, target) if source is None else (Path(target), source)
    if bundle_path is None and (Path(target) / MANIFEST).is_file():
        raise SettingError("SOURCE", "is missing after the bundle", "give the recording to compare it with")
    if bundle_path is not None and (Path(source) / MANIFEST).is_file():
        raise SettingError("SOURCE", f"{source} is a bundle", f"give it first: monoloc check {source} {target}")
    check_outputs({"--plot": plot}, (bundle_path, source, cloud))
    check_picture(plot, "--plot")
    bundle = None if bundle_path is None else read_bundle(bundle_path)
    points = None if cloud is None else open_cloud(cloud)
    recording = open_source(source, frames, intrinsics, depth_scale, fix_poses=fix_poses, fix_depth=fix_depth)
    inspection = inspect_recording(recording, points, bundle, ConsoleProgress(stderr))
    if plot is not None:
        plot_check(plot, inspection, title=source if bundle_path is None else f"{source} against {target}")
    say_written(plot)
    print_findings(source, inspection.findings, inspection.level, json)
    if json:
        print_json(_content(source, inspection))
    return EXIT_CODES[inspection.level]


def _content(source: str, inspection: Inspection) -> dict[str, object]:
    images, agreement = inspection.images, inspection.agreement
    parts = {"times": inspection.times, "motion": inspection.motion, "depth": inspection.depth}
    content: dict[str, object] = {
        "source": source,
        "level": inspection.level,
        "findings": [asdict(finding) for finding in inspection.findings],
        **{name: asdict(part) for name, part in parts.items() if part is not None},
        "images": {
            "blur_median": float(np.median(images.blur)),
            "blurred_share": images.blurred_share,
            "brightness": float(np.mean(images.brightness)),
            "dark_share": float(np.mean(images.dark)),
            "saturated_share": float(np.mean(images.saturated)),
        },
    }
    if inspection.poses is not None:
        content["poses"] = asdict(inspection.poses)
    if agreement is not None:
        content["map"] = {
            "frames": agreement.frames,
            "found": agreement.found,
            "agreeing": agreement.agreeing,
            "offset_m": agreement.offset_m,
            "offset_deg": None if agreement.offset_rad is None else float(np.rad2deg(agreement.offset_rad)),
            "T_map_world": None if agreement.T_map_world is None else agreement.T_map_world.tolist(),
            "focal": None if agreement.focal is None else agreement.focal.value,
            "aspect": None if agreement.aspect is None else agreement.aspect.value,
        }
    return content
