"""``monoloc map info``, ``render`` and ``export``: what a map holds, as figures, as a picture, for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from monoloc.bundle import Bundle, read_bundle
from monoloc.cli.common import (
    JsonOption,
    SeedOption,
    naming,
    print_figures,
    warn,
)
from monoloc.cli.output_checks import check_outputs, check_picture
from monoloc.cli.start_option import METAVAR, parse_pose
from monoloc.editing.edit_history import drawn_edits
from monoloc.editing.seen_space import with_seen_space
from monoloc.errors import SettingError
from monoloc.evaluation.cloud_metrics import cloud_distances
from monoloc.extras import require_extra
from monoloc.geometry import FloatArray
from monoloc.io.ros_grid import picture_of
from monoloc.level_map import T_map_world
from monoloc.map.mixture import GaussianMixture
from monoloc.map.occupancy import FREE, OCCUPIED, fitting_voxel_m, surface_voxels
from monoloc.map.surface import EXTENT_SIGMAS, surface_points
from monoloc.map_export import export_ellipsoids, export_grid, export_points, export_voxels
from monoloc.obstacles.depth_error import nearest_depth_m
from monoloc.viz.map_view import CHANGED_M, MapView, plot_from_above, plot_from_pose

_DRAWN_POINTS = 100_000
# From a pose: a surface at arm's length fills the picture with few of a map's points, and shows what is behind it
# where these are too sparse.
_POSED_POINTS = 2_000_000
_EXPORTED_POINTS = 100_000
_SEEN_VOXEL_M = 0.1  # of the volume that the build's cameras saw
_VOXEL_M = 0.05
_LEAST_COMMON = 0.2  # of surfaces of two maps of one world: 5 % or less by chance, in rooms that are not alike

BundleArgument = Annotated[
    Path, typer.Argument(metavar="BUNDLE", help="Bundle from monoloc build.", show_default=False)
]


def info(
    target: Annotated[Path, typer.Argument(metavar="MAP|BUNDLE", help="Map (.npz) or bundle.", show_default=False)],
    json: JsonOption = False,
) -> None:
    """Describe a map: its size and resolution; for a bundle also its parts, and how much of the room was seen.

    \b
    Examples:
      monoloc map info kitchen.npz
      monoloc map info kitchen.monoloc --json
    """
    content = _bundle(target) if target.is_dir() else _mixture(GaussianMixture.load(target))
    print_figures(str(target), content, json)


def render(
    bundle: BundleArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="Picture to write, NAME.png.")],
    beside: Annotated[
        Path | None,
        typer.Option("--beside", metavar="BUNDLE", help="A later bundle of the same world: before, after, changes."),
    ] = None,
    pose: Annotated[
        str | None,
        typer.Option("--pose", metavar=METAVAR, help="Draw what a camera there sees. [from above]"),
    ] = None,
    reference: Annotated[
        int | None,
        typer.Option("--reference", min=0, metavar="N", help="The same from the bundle's N-th reference pose."),
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Draw a map from above or from a pose, alone or beside a later one.

    \b
    Examples:
      monoloc map render kitchen.monoloc --out kitchen.png
      monoloc map render kitchen.monoloc --out view.png --reference 40
      monoloc map render before.monoloc --beside after.monoloc --out change.png
    """
    check_outputs({"--out": out}, (bundle, beside))
    check_picture(out, "--out")
    if pose is not None and reference is not None:
        raise SettingError("--reference", "is given together with --pose", "give one of them")
    given = None if pose is None else parse_pose(pose, "--pose")
    room = read_bundle(bundle)
    later = None if beside is None else read_bundle(beside)
    given = given if reference is None else _reference_pose(room, bundle, reference)
    shown = [(bundle, room)] if beside is None or later is None else [(bundle, room), (beside, later)]
    count = _DRAWN_POINTS if given is None else _POSED_POINTS
    views = tuple(_view(path, each, seed, count) for path, each in shown)
    if beside is not None:
        _check_world(views[0], views[1])
    if given is None:
        warn_of_up(room, bundle.name)
        plot_from_above(out, views, T_map_world(room))
    else:
        with naming({"pose": "--pose" if reference is None else "--reference"}):
            plot_from_pose(out, views, room.camera, given)
    content = {"picture": str(out), "from": "above" if given is None else "pose", "bundles": len(views)}
    print_figures(str(bundle), content, json)


def export(
    bundle: BundleArgument,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help=".ply or .pcd: points; .bt: OctoMap; .yaml: ROS's occupancy grid."),
    ],
    ellipsoids: Annotated[
        bool, typer.Option("--ellipsoids", help="Components as a mesh, in place of points.")
    ] = False,
    points: Annotated[int | None, typer.Option("--points", min=1, max=10_000_000, help="Number of points.")] = None,
    voxel: Annotated[float | None, typer.Option("--voxel", help="Edge of a voxel or cell, metres.")] = None,
    height: Annotated[
        float | None,
        typer.Option("--height", help="Height of the grid, metres, in ROS's map frame. [median of the cameras']"),
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Write a map for other programs; the extension selects the format.

    Points and ellipsoids are in the bundle's world frame, voxels and grids in ROS's frame map, whose z axis is up.

    \b
    Examples:
      monoloc map export kitchen.monoloc --out kitchen.ply
      monoloc map export kitchen.monoloc --out kitchen-ellipsoids.ply --ellipsoids
      monoloc map export kitchen.monoloc --out kitchen.bt --voxel 0.1
      monoloc map export kitchen.monoloc --out map.yaml --height 1.2
    """
    ending = out.suffix.lower()
    _check_options(
        ending,
        {
            "--ellipsoids": (ellipsoids, (".ply",)),
            "--points": (points is not None, (".ply", ".pcd")),
            "--voxel": (voxel is not None, (".bt", ".yaml")),
            "--height": (height is not None, (".yaml",)),
        },
    )
    if ellipsoids and points is not None:
        raise SettingError("--points", "has no meaning for ellipsoids", "leave it out")
    if height is not None and not np.isfinite(height):
        raise SettingError("--height", f"is {height}", "give metres")
    check_outputs({"--out": out, "--out's picture": picture_of(out) if ending == ".yaml" else None}, (bundle,))
    count, edge_m = points or _EXPORTED_POINTS, _VOXEL_M if voxel is None else voxel
    writers: dict[str, Callable[[Bundle], dict[str, object]]] = {
        ".ply": lambda room: export_points(out, room, count, np.random.default_rng(seed)),
        ".pcd": lambda room: export_points(out, room, count, np.random.default_rng(seed)),
        ".bt": lambda room: export_voxels(out, room, str(bundle), edge_m),
        ".yaml": lambda room: export_grid(out, room, str(bundle), edge_m, height),
    }
    room = read_bundle(bundle)
    with naming({"voxel_m": "--voxel", "height_m": "--height"}):
        written = export_ellipsoids(out, room) if ellipsoids else writers[ending](room)
    content = {"written": str(out), **written}
    print_figures(str(bundle), content, json)


def _check_options(ending: str, options: dict[str, tuple[bool, tuple[str, ...]]]) -> None:
    """Reject an unknown ending, and options that it does not take; each has whether it is given, and its endings."""
    endings = (".ply", ".pcd", ".bt", ".yaml")
    if ending not in endings:
        raise SettingError("--out", f"ends in {ending or 'nothing'}", f"choose from {', '.join(endings)}")
    for option, (is_given, its_endings) in options.items():
        if is_given and ending not in its_endings:
            raise SettingError(option, f"has no meaning for {ending}", "leave it out")


def _mixture(mixture: GaussianMixture) -> dict[str, object]:
    lower, upper = mixture.bounds_m(EXTENT_SIGMAS)
    extents = np.sqrt(np.linalg.eigvalsh(mixture.covariances))
    return {
        "components": len(mixture),
        "bytes": mixture.nbytes_stored,
        "lower_m": [float(value) for value in lower],
        "upper_m": [float(value) for value in upper],
        "thickness_median_m": float(np.median(extents[:, 0])),
        "length_median_m": float(np.median(extents[:, 2])),
        "largest_share": float(mixture.weights.max()),
    }


def _bundle(path: Path) -> dict[str, object]:
    bundle = read_bundle(path)
    views = bundle.landmarks.views
    provenance = bundle.provenance
    return {
        **_mixture(bundle.original),
        "files_bytes": {file.name: file.stat().st_size for file in sorted(path.iterdir())},
        "landmarks": len(bundle.landmarks),
        "landmark_views": 0 if views is None else len(views.poses),
        "reference_poses": len(bundle.reference_poses),
        **_seen(bundle),
        "nearest_depth_m": nearest_depth_m(bundle),
        "scale_sd": provenance.scale_sd,
        "recording": provenance.recording,
        "frames": len(provenance.frames),
        "tune": provenance.tune,
        "map_transform": provenance.map_transform,
        "down": None if bundle.down is None else [float(value) for value in bundle.down],
    }


def _seen(bundle: Bundle) -> dict[str, object]:
    """Volume of the surfaces, and of the space that the build's cameras saw through, by voxels of 10 cm or more."""
    eyes = bundle.reference_poses.poses[:, :3, 3]
    grid = surface_voxels(bundle.original, fitting_voxel_m(bundle.original, _SEEN_VOXEL_M, eyes), eyes)
    grid = with_seen_space(grid, bundle, np.eye(4))
    return {"surface_volume_m3": grid.volume_m3(OCCUPIED), "free_volume_m3": grid.volume_m3(FREE)}


def _view(path: Path, bundle: Bundle, seed: int, points: int) -> MapView:
    require_extra("report")
    rng = np.random.default_rng(seed)
    return MapView(
        name=path.name,
        cloud=surface_points(bundle.original, points, rng),
        landmarks=bundle.landmarks.points.astype(np.float64),
        poses=bundle.reference_poses.poses,
        edits=drawn_edits(bundle, rng),
    )


def warn_of_up(bundle: Bundle, name: str) -> None:
    """Warn where the map does not tell gravity: flights then publish the world itself as ROS's frame ``map``."""
    if bundle.down is None:
        problem = "floor and walls do not show the direction of gravity; up is that of the build's cameras"
        warn(name, f"{problem}, and x, y and z are not those of ROS's frame map")


def _check_world(before: MapView, after: MapView) -> None:
    """Warn if two maps have hardly a surface in common, as those of two worlds; one may be a part of the other."""
    first, second = (view.cloud[:: 1 + len(view.cloud) // _DRAWN_POINTS] for view in (before, after))
    share = max(float(np.mean(cloud_distances(*pair) < CHANGED_M)) for pair in ((first, second), (second, first)))
    if share < _LEAST_COMMON:
        problem = f"at most {share:.0%} of its surfaces are also in {before.name}"
        warn(after.name, f"{problem}; both must be of one world")


def _reference_pose(bundle: Bundle, path: Path, number: int) -> FloatArray:
    count = len(bundle.reference_poses)
    if number >= count:
        fix = f"choose from 0 to {count - 1}" if count else "give --pose"
        raise SettingError("--reference", f"is {number}, and {path} has {count} reference poses", fix)
    return np.asarray(bundle.reference_poses.poses[number])
