"""The space that the cameras of a map saw through, also where edits have changed the map since."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from monoloc.bundle import Bundle
from monoloc.editing.undo import states
from monoloc.geometry import FloatArray
from monoloc.map.occupancy import VoxelGrid, surface_voxels
from monoloc.map.surface import transformed


def with_seen_space(grid: VoxelGrid, bundle: Bundle, T_grid_world: FloatArray) -> VoxelGrid:
    """The grid of a bundle's map with the space free that its cameras saw through.

    What an edit has removed hid the space behind it: each camera saw no farther than to the map of its recording.

    Args:
        grid: surfaces of the map as it is now.
        bundle: the room.
        T_grid_world: (4, 4).

    Raises:
        BundleError: what undoes an edit is damaged.
    """
    for room, poses in _recorded(bundle):
        then = None if room is bundle else surface_voxels(transformed(room.original, T_grid_world), grid.voxel_m)
        grid = grid.with_free_space(T_grid_world @ poses, bundle.camera, then)
    return grid


def _recorded(bundle: Bundle) -> Iterator[tuple[Bundle, FloatArray]]:
    """The room after each recording that brought reference poses, and these, (V, 4, 4), the newest first."""
    before = bundle
    for room, before in pairwise(states(bundle)):
        count = len(before.reference_poses)
        if count < len(room.reference_poses):
            yield room, room.reference_poses.poses[count:]
    yield before, before.reference_poses.poses
