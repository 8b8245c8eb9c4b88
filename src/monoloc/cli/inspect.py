"""``monoloc inspect``: describe a bundle or a recording."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from json import loads
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.bundle import Bundle, read_bundle
from monoloc.bundle_manifest import MANIFEST, PLACE_MANIFEST, manifest_content
from monoloc.bundle_signature import SIGNATURE
from monoloc.camera import Camera
from monoloc.cli.common import (
    FramesOption,
    IntrinsicsOption,
    JsonOption,
    open_source,
    print_figures,
    refuse_frames,
)
from monoloc.errors import DataError, SettingError
from monoloc.evaluation.trajectory import twist_errors
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.io.recording import Selection
from monoloc.map.compare import compare_maps
from monoloc.map.surface import EXTENT_SIGMAS

# Entries of a bundle that a person rarely asks for; JSON has them all.
_DETAILS = ("settings", "thresholds", "integrity", "sensor", "network_spec")
# Entries of a bundle that are listed first: what it is of, and what a flight depends on.
_FIRST = (
    *("kind", "recording", "frames", "size_m", "landmarks", "components", "supports_relocalization", "down"),
    *("down_by", "mean_camera_down", "tune", "scale_sd", "known_bias_m", "known_bias_deg"),
)


def inspect(
    target: Annotated[
        str, typer.Argument(metavar="TARGET", help="Bundle, or recording as SOURCE.", show_default=False)
    ],
    frames: FramesOption = "::",
    intrinsics: IntrinsicsOption = None,
    json: JsonOption = False,
) -> None:
    """Describe and check a bundle or a recording.

    The check of a bundle covers every byte. The check of a recording covers the presence of its files and the content
    of its first frame.

    \b
    Examples:
      monoloc inspect kitchen.monoloc
      monoloc inspect 7scenes:redkitchen --json
      monoloc inspect flight.mp4 --camera 640,480,525,525,319.5,239.5
    """
    if (Path(target) / PLACE_MANIFEST).is_file():
        fix = f"describe it by: monoloc place info {shlex.quote(target)}"
        raise DataError(target, "is a place of several rooms", fix, "how-to/many-rooms")
    if (Path(target) / MANIFEST).is_file() or (Path(target).suffix == ".monoloc" and ":" not in target):
        refuse_frames(frames, "a bundle")
        if intrinsics is not None:
            raise SettingError("--camera", "has no meaning for a bundle", "leave it out")
        content = _bundle(Path(target))
    else:
        content = _recording(open_source(target, frames, intrinsics))
    if not json and (left_out := [name for name in _DETAILS if name in content]):
        shown = {name: value for name, value in content.items() if name not in left_out}
        content = {**shown, "with --json": ", ".join(left_out)}
    print_figures(target, content, json)


def _bundle(path: Path) -> dict[str, object]:
    bundle = read_bundle(path)
    lower, upper = bundle.adapted.bounds_m(EXTENT_SIGMAS)
    content: dict[str, object] = {
        "kind": "bundle",
        "monoloc_version": loads(manifest_content(path))["monoloc_version"],
        "is_signed": (path / SIGNATURE).is_file(),
        "bytes": sum(file.stat().st_size for file in path.iterdir()),
        "components": len(bundle.adapted),
        "map_bytes": bundle.adapted.nbytes_stored,
        "size_m": [float(value) for value in upper - lower],
        **asdict(compare_maps(bundle.original, bundle.adapted)),
        "landmarks": len(bundle.landmarks),
        "landmark_bytes": bundle.landmarks.bytes,
        "network": bundle.depth_model.name,
        "network_spec": bundle.depth_model.spec.model_dump(mode="json", exclude_none=True),
        "depth_bytes": len(bundle.depth_model.content),
        **bundle.provenance.model_dump(exclude={"frames", "down_world", "knows_down", "kept_down"}),
        "frames": len(bundle.provenance.frames),
        **_gravity(bundle),
        **_known_bias(bundle.reference_poses),
        **_camera(bundle.camera),
        "supports_relocalization": bundle.supports_relocalization,
        "supports_scan_search": bundle.supports_scan_search,
        "thresholds": bundle.thresholds.model_dump(),
        "integrity": bundle.integrity.model_dump(),
        "sensor": bundle.sensor.model_dump(),
        "settings": bundle.settings.model_dump(mode="json"),
    }
    return {name: content[name] for name in _FIRST} | content


def _gravity(bundle: Bundle) -> dict[str, object]:
    """Direction of gravity, what it is from, and what may stand for it: the mean of the cameras' y axes."""
    down, is_recorded = bundle.down, bundle.provenance.knows_down
    return {
        "down": None if down is None else [float(value) for value in down],
        "down_by": None if down is None else "the recording" if is_recorded else _shown_by(bundle),
        "mean_camera_down": None if is_recorded else list(bundle.provenance.down_world),
    }


def _shown_by(bundle: Bundle) -> str:
    return "floor and walls" + ("" if bundle.provenance.kept_down is None else " before an edit")


def _known_bias(reference_poses: ReferencePoses) -> dict[str, object]:
    """Root mean square of the known bias at the reference poses; None if it is unknown."""
    if not reference_poses.common_bias.any():
        return {"known_bias_m": None, "known_bias_deg": None}
    known = twist_errors(reference_poses.common_bias)
    return {
        "known_bias_m": float(np.sqrt(np.mean(known.position_m**2))),
        "known_bias_deg": float(np.rad2deg(np.sqrt(np.mean(known.rotation_rad**2)))),
    }


def _recording(recording: Selection) -> dict[str, object]:
    content: dict[str, object] = {
        "kind": "recording",
        "name": recording.name,
        "frames": len(recording),
        "seconds": float(recording.timestamps_s[-1] - recording.timestamps_s[0]),
        **_camera(recording.camera),
        "has_poses": recording.poses is not None,
        "has_depth": recording.has_depth,
        "first_frame": recording.frame_names[0],
    }
    recording.color(0)  # raises DataError if it is unreadable
    if recording.poses is not None:
        steps = np.linalg.norm(np.diff(recording.poses[:, :3, 3], axis=0), axis=1)
        content["path_m"] = float(steps.sum())
    if recording.has_depth:
        depth = recording.depth(0)
        content["first_frame_depth_share"] = float((depth > 0.0).mean())
        median_m = float(np.median(depth[depth > 0.0])) if depth.any() else np.nan
        content["first_frame_depth_median_m"] = median_m
    return content


def _camera(camera: Camera) -> dict[str, object]:
    return {
        "image": [camera.width, camera.height],
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "distortion": list(camera.distortion),
        "distortion_model": camera.distortion_model,
    }
