"""``monoloc build``: build a bundle from a recording."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from monoloc.adapt.settings import QUICK, Tune
from monoloc.builder.build_config import METHODS, BuildConfig, Method
from monoloc.builder.build_plan import expected_stages
from monoloc.builder.build_report import BuildReport
from monoloc.builder.pipeline import build_bundle
from monoloc.bundle import Bundle, write_bundle
from monoloc.cli.bundle_output import check_bundle_output, note_replaced
from monoloc.cli.common import (
    DepthScaleOption,
    FixDepthOption,
    FixPosesOption,
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    ScaleOption,
    SeedOption,
    SourceArgument,
    naming,
    note,
    open_cloud,
    open_source,
    print_json,
    stderr,
    warn,
)
from monoloc.cli.reconstruct import reconstruct_source
from monoloc.config import load_settings, override
from monoloc.depth.model_files import trainable_file
from monoloc.depth.models import DEFAULT, is_shipped
from monoloc.errors import SettingError
from monoloc.files import target_of
from monoloc.io.recording import Recording
from monoloc.partial_files import locked_folder
from monoloc.progress import ConsoleProgress, Plan
from monoloc.updating.room_evidence import evidence_path

_OPTIONS = {
    "components": "--components",
    "int8": "--int8",
    "landmarks": "--landmarks",
    "refine_poses": "--refine-poses",
    "adapt.tune": "--tune",
    "adapt.map_transform": "--map-transform",
    "adapt.lambda_kl": "--lambda",
}


def build(
    source: SourceArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Bundle to write, NAME.monoloc.")],
    frames: FramesOption = "::",
    cloud: Annotated[
        Path | None,
        typer.Option("--cloud", help="Cloud of the room (ply, pcd, xyz, txt, csv, npz, points3D), world frame."),
    ] = None,
    components: Annotated[
        str | None,
        typer.Option("--components", "-k", help="Gaussians in the map, or 'bic' for automatic choice. [200]"),
    ] = None,
    method: Annotated[
        Method | None, typer.Option("--method", help="monoloc's method or the paper's, for flights too. [default]")
    ] = None,
    tune: Annotated[Tune | None, typer.Option("--tune", help="Layers of the network to tune. [all]")] = None,
    map_transform: Annotated[
        bool | None, typer.Option("--map-transform/--no-map-transform", help="Transform the map. [yes]")
    ] = None,
    lambda_kl: Annotated[
        float | None, typer.Option("--lambda", help="Weight of the KL divergence from the original map.")
    ] = None,
    refine_poses: Annotated[
        bool | None,
        typer.Option("--refine-poses/--given-poses", help="Align the poses with the map first. [given]"),
    ] = None,
    network: Annotated[
        str,
        typer.Option(
            "--network",
            help="Depth network: a name from depth list, a .safetensors, .onnx, bundle, or .toml of another network.",
        ),
    ] = DEFAULT,
    landmarks: Annotated[
        bool | None,
        typer.Option("--landmarks/--no-landmarks", help="Store a map of landmarks in the bundle. [yes]"),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Tune for fewer steps: less than half the time, less accurate depth.")
    ] = False,
    int8: Annotated[
        bool | None, typer.Option("--int8/--no-int8", help="Quantise the network to 8 bits. [no]")
    ] = None,
    settings: Annotated[Path | None, typer.Option("--settings", help="TOML file of settings.")] = None,
    scale: ScaleOption = None,
    intrinsics: IntrinsicsOption = None,
    depth_scale: DepthScaleOption = None,
    fix_poses: FixPosesOption = None,
    fix_depth: FixDepthOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Map a room and adapt the depth network to it.

    docs/how-to/another-depth-network.md explains how to use another network.

    \b
    Examples:
      monoloc build 7scenes:redkitchen --frames 0:400:4 --out kitchen.monoloc
      monoloc build tum:rgbd_dataset_freiburg1_room --out room.monoloc -k 400
      monoloc build my-recording --quick --out draft.monoloc     (a first look)
      monoloc build my-recording --cloud room.ply --out room.monoloc
      monoloc build my-recording --refine-poses --out room.monoloc     (poses with errors of 2 cm and 1 degree)
      monoloc build my-recording --fix-poses opengl --out room.monoloc     (poses with axes of OpenGL)
      monoloc build walk.mp4 --scale marker:7:0.16 --out room.monoloc     (a plain video)
      monoloc build my-recording --method paper --out paper.monoloc     (as Shukla et al. 2023)
      monoloc build my-recording --tune none --no-map-transform --no-landmarks --out plain.monoloc
      monoloc build my-recording --network midas.toml --out midas.monoloc     (another network)
    """
    check_bundle_output(out, (source, network))
    config = _settings_of(method, settings)
    remarks = []
    if trainable_file(network) is None:
        # By default, a network that cannot be trained is used as it is.
        only_run = {"tune": "none", "map_transform": False}
        unset = only_run.keys() - config.adapt.model_fields_set
        config = override(config, adapt={name: only_run[name] for name in unset})
        if "tune" in unset and tune is None:
            remarks.append(_not_tuned(network))
    if quick:
        config = override(config, adapt=QUICK)
    adapt = {"tune": tune, "map_transform": map_transform, "lambda_kl": lambda_kl}
    given = {"components": components, "int8": int8, "landmarks": landmarks, "refine_poses": refine_poses}
    values = given | {f"adapt.{name}": value for name, value in adapt.items()}
    # Errors name the option if it was given, or if there is no settings file.
    options = {name: _OPTIONS[name] for name, value in values.items() if value is not None or settings is None}
    evidence = evidence_path(target_of(out))
    with naming(options):
        config = override(config, **given, adapt=adapt)
        note_replaced(out, evidence, "; to keep them, stop now and name another --out")
        points = None if cloud is None else open_cloud(cloud)
        selected = open_source(
            source, frames, intrinsics, depth_scale, fix_poses=fix_poses, fix_depth=fix_depth, guesses_camera=True
        )
        recording = _with_poses(selected, scale, seed, cloud)
        progress = ConsoleProgress(stderr, Plan(expected_stages(len(recording), config)))
        bundle, report = build_bundle(recording, config, seed, progress, points, network)
    with locked_folder(target_of(out).parent):
        size = write_bundle(out, bundle)
        if evidence.is_file():  # of the bundle that was there; flights in this one begin anew
            evidence.unlink()
    report = replace(report, warnings=remarks + report.warnings)
    for warning in report.warnings:
        warn(recording.name, warning)
    if report.frames < report.recorded_frames:
        remark = f"{report.frames} of {report.recorded_frames} frames are used, chosen to show most of the room"
        note(recording.name, f"{remark}; most_frames in --settings uses more")
    if json:
        print_json({"bundle": str(out), "bytes": size, **asdict(report)})
    else:
        _print_report(out, size, bundle, report, network)


def _print_report(out: Path, size: int, bundle: Bundle, report: BuildReport, network: str) -> None:
    stderr.print(
        f"{out}: {size / 1e6:.1f} MB, map of {report.components} components in "
        f"{bundle.adapted.nbytes_stored / 1e3:.0f} kB, {report.landmarks} landmarks in "
        f"{bundle.landmarks.bytes / 1e3:.0f} kB, from {report.frames} frames in {report.seconds:.0f} s",
        soft_wrap=True,
    )
    if report.depth_absrel_before is not None and report.depth_absrel_after is not None:
        stderr.print(
            f"on {report.held_out_frames} held-out frames: depth error {100 * report.depth_absrel_before:.1f} % -> "
            f"{100 * report.depth_absrel_after:.1f} %, map moved {100 * report.shift_median_m:.1f} cm (median)",
            soft_wrap=True,
        )
    if report.scale_sd is not None:
        stderr.print(f"the map's scale is known to ± {100.0 * report.scale_sd:.2g} % (standard deviation)")
    if report.depth_scale is not None:
        shift = "" if report.depth_shift is None else f" and shift {report.depth_shift:.4g}"
        how = f"{network} is used as it is, with scale {report.depth_scale:.4g}{shift} fitted on these frames"
        stderr.print(how, soft_wrap=True)


def _settings_of(method: Method | None, settings: Path | None) -> BuildConfig:
    if settings is None:
        return METHODS[method or "default"]
    if method is not None:
        raise SettingError("--method", f"is given beside {settings}", "leave one of them out")
    return load_settings(settings, BuildConfig)


def _with_poses(recording: Recording, scale: str | None, seed: int, cloud: Path | None) -> Recording:
    """The recording, reconstructed if it has no poses."""
    if recording.poses is None:
        if cloud is not None:
            raise SettingError("--cloud", "is of a world that images without poses are not in", "leave it out")
        return reconstruct_source(recording, scale, seed).recording
    if scale is not None:
        raise SettingError("--scale", "has no meaning for a recording with poses", "leave it out")
    return recording


def _not_tuned(network: str) -> str:
    remark = f"{network} can only be run, so it was not tuned"
    if not is_shipped(network):
        return remark
    return f"{remark}; for a tuned network in 8 bits: --network {network.removesuffix('-int8')} --int8"
