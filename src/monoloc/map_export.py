"""A bundle's map for other programs: points, ellipsoids, voxels, a grid at a height.

What is written is the room as it was mapped, in metres, not the map that was bent to the depth network.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.octomap import write_octomap
from monoloc.io.pcd import write_pcd
from monoloc.io.ply_writer import write_ply
from monoloc.io.ros_grid import GREY_FREE, GREY_OCCUPIED, GREY_UNKNOWN, write_ros_grid
from monoloc.level_map import level_cells, level_voxels
from monoloc.map.occupancy import FREE, OCCUPIED, UNKNOWN
from monoloc.map.surface import ellipsoid_mesh, patch_normals, patch_offsets, surface_points

_STATES = {"occupied": OCCUPIED, "free": FREE, "unknown": UNKNOWN}
_GREY_OF = np.array([GREY_UNKNOWN, GREY_FREE, GREY_OCCUPIED], dtype=np.uint8)  # by state


def export_points(path: Path, bundle: Bundle, count: int, rng: np.random.Generator) -> dict[str, object]:
    """Write random points of the surface as ``.pcd``, or as ``.ply`` with normals towards the cameras and colours.

    Raises:
        DataError: the file cannot be written.
    """
    if path.suffix.lower() == ".pcd":
        write_pcd(path, surface_points(bundle.original, count, rng))
    else:
        component, offsets = patch_offsets(bundle.original, count, rng)
        points = bundle.original.means[component] + offsets
        normals = _towards_cameras(bundle)[component]
        write_ply(path, points, colors=_by_height(points, bundle), normals=normals)
    return {"points": count, "frame": "world"}


def export_ellipsoids(path: Path, bundle: Bundle) -> dict[str, object]:
    """Write the components as ``.ply``, a mesh of ellipsoids that are as large as the patches they stand for.

    Raises:
        DataError: the file cannot be written.
    """
    vertices, triangles, component = ellipsoid_mesh(bundle.original)
    colors = _by_height(bundle.original.means, bundle)[component]
    write_ply(path, vertices, colors=colors, triangles=triangles)
    return {"components": len(bundle.original), "triangles": len(triangles), "frame": "world"}


def export_voxels(path: Path, bundle: Bundle, name: str, voxel_m: float) -> dict[str, object]:
    """Write occupied and free voxels as OctoMap's ``.bt``, in ROS's frame ``map``, whose z axis is up.

    Args:
        path: NAME.bt.
        bundle: the room.
        name: of the bundle, for messages.
        voxel_m: edge of a voxel.

    Raises:
        SettingError: as :func:`monoloc.map.occupancy.surface_voxels`.
        DataError: the file cannot be written, or the map does not tell the direction of gravity.
    """
    _require_gravity(bundle, name)
    grid = level_voxels(bundle, voxel_m)
    write_octomap(path, grid.indices(OCCUPIED), grid.indices(FREE), voxel_m)
    return {
        "voxel_m": voxel_m,
        "occupied_voxels": int(np.count_nonzero(grid.states == OCCUPIED)),
        "free_voxels": int(np.count_nonzero(grid.states == FREE)),
        "frame": "map",
    }


def export_grid(path: Path, bundle: Bundle, name: str, cell_m: float, height_m: float | None) -> dict[str, object]:
    """Write ROS's occupancy grid at a height, in the frame ``map``: :func:`monoloc.level_map.level_cells`.

    Args:
        path: NAME.yaml; the picture is NAME.pgm beside it.
        bundle: the room.
        name: of the bundle, for messages.
        cell_m: edge of a cell.
        height_m: z in the frame ``map``; None for the median of the cameras that built the map.

    Raises:
        SettingError: as :func:`monoloc.level_map.level_cells`.
        DataError: as :func:`export_voxels`.
    """
    _require_gravity(bundle, name)
    cells = level_cells(bundle, cell_m, height_m)
    write_ros_grid(path, _GREY_OF[cells.states], cells.lower, cell_m)
    shares = {f"{name}_share": float(np.mean(cells.states == state)) for name, state in _STATES.items()}
    return {"cell_m": cell_m, "cells": list(cells.states.shape), "height_m": cells.height_m, **shares, "frame": "map"}


def _require_gravity(bundle: Bundle, name: str) -> None:
    if bundle.down is None:
        problem = "does not give the direction of gravity: it shows too little of floor and walls"
        raise DataError(name, problem, "export a .ply or .pcd")


def _towards_cameras(bundle: Bundle) -> FloatArray:
    """Normals of the components, (K, 3), on the side of the nearest camera that built the map."""
    normals, eyes = patch_normals(bundle.original), bundle.reference_poses.poses[:, :3, 3]
    if len(eyes) == 0:
        return normals
    to_eyes = eyes[None] - bundle.original.means[:, None]
    nearest = np.linalg.norm(to_eyes, axis=2).argmin(axis=1)
    side = np.einsum("ki,ki->k", to_eyes[np.arange(len(normals)), nearest], normals)
    return np.asarray(normals * np.where(side < 0.0, -1.0, 1.0)[:, None])


def _by_height(points: FloatArray, bundle: Bundle) -> NDArray[np.uint8]:
    """Colours (N, 3) RGB by height, from the 1st to the 99th percentile."""
    height = -points @ np.asarray(bundle.provenance.down_world)
    low, high = np.percentile(height, [1.0, 99.0])
    level = np.clip(255.0 * (height - low) / max(float(high - low), 1e-6), 0.0, 255.0).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(level[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1], dtype=np.uint8)
