"""A bundle's map in ROS's frame ``map``, whose z axis is up: as voxels, and as cells at a height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.editing.seen_space import with_seen_space
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray
from monoloc.map.occupancy import FREE, OCCUPIED, UNKNOWN, VoxelGrid, surface_voxels
from monoloc.map.surface import transformed
from monoloc.obstacles.sectors import HALF_HEIGHT_M
from monoloc.ros.ros_frames import RosFrames

_LEAST_FREE = 0.5  # share of a column's voxels that were seen free, from which its cell is free


@dataclass(frozen=True)
class LevelCells:
    """What a vehicle that flies level at a height can hit.

    Attributes:
        states: (X, Y) uint8, :data:`~monoloc.map.occupancy.UNKNOWN`, ``FREE`` or ``OCCUPIED``.
        lower: corner of the first cell, (2,) m, in the frame ``map``.
        cell_m: edge of a cell.
        height_m: z in the frame ``map``.
    """

    states: NDArray[np.uint8]
    lower: FloatArray
    cell_m: float
    height_m: float

    def centres(self, state: int) -> FloatArray:
        """Centres of the cells in a state, (N, 3) m, in the frame ``map``."""
        xy = self.lower + (np.argwhere(self.states == state) + 0.5) * self.cell_m
        return np.column_stack([xy, np.full(len(xy), self.height_m)])


def T_map_world(bundle: Bundle) -> FloatArray:
    """From the bundle's world to ROS's frame ``map``, z up, as ``monoloc fly --mcap`` publishes it, (4, 4).

    Where the map does not tell gravity, it is the mean direction of the cameras' y axes; z, where there is none. Then
    this is not the frame that is published, which is the world itself.
    """
    down = bundle.provenance.down_world if bundle.down is None else bundle.down
    return RosFrames(np.eye(4), down if np.any(down) else None).T_map_room


def level_voxels(bundle: Bundle, voxel_m: float) -> VoxelGrid:
    """Voxels of the map in the frame ``map``, with the space free that the build's cameras saw through.

    Raises:
        SettingError: as :func:`monoloc.map.occupancy.surface_voxels`.
        BundleError: as :func:`monoloc.editing.seen_space.with_seen_space`.
    """
    T = T_map_world(bundle)
    eyes = (T @ bundle.reference_poses.poses)[:, :3, 3]
    return with_seen_space(surface_voxels(transformed(bundle.original, T), voxel_m, eyes), bundle, T)


def level_cells(bundle: Bundle, cell_m: float, height_m: float | None) -> LevelCells:
    """Cells of the map at a height.

    A cell is occupied if a voxel of its column is, within 0.25 m above and below; else free if half of them were seen
    free; else unknown.

    Args:
        bundle: the room.
        cell_m: edge of a cell.
        height_m: z in the frame ``map``; None for the median of the cameras that built the map.

    Raises:
        SettingError: as :func:`monoloc.map.occupancy.surface_voxels`, or the map has nothing at that height.
    """
    if height_m is None:
        if len(bundle.reference_poses) == 0:
            raise SettingError("height_m", "is needed: the bundle keeps no reference poses", "give metres")
        height_m = float(np.median((T_map_world(bundle) @ bundle.reference_poses.poses)[:, 2, 3]))
    grid = level_voxels(bundle, cell_m)
    levels = (grid.first[2] + np.arange(grid.states.shape[2]) + 0.5) * cell_m
    is_in = np.abs(levels - height_m) <= max(HALF_HEIGHT_M, 0.5 * cell_m)
    if not is_in.any():
        fix = f"choose from {levels[0]:.2f} to {levels[-1]:.2f} metres along z of the frame map"
        raise SettingError("height_m", f"is {height_m:g}, where the map has nothing", fix)
    columns = grid.states[:, :, is_in]
    is_free = (columns == FREE).mean(axis=2) >= _LEAST_FREE
    states = np.where(is_free, FREE, UNKNOWN).astype(np.uint8)
    states[(columns == OCCUPIED).any(axis=2)] = OCCUPIED
    return LevelCells(states, grid.lower[:2], cell_m, height_m)
