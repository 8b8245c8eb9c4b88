"""The space that the cameras of a map saw through, also where edits have changed the map since."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from monoloc.bundle import Bundle
from monoloc.camera import Camera
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
    for room, poses, camera in _recorded(bundle):
        then = None if room is bundle else surface_voxels(transformed(room.original, T_grid_world), grid.voxel_m)
        grid = grid.with_free_space(T_grid_world @ poses, camera, then)
    return grid


def _recorded(bundle: Bundle) -> Iterator[tuple[Bundle, FloatArray, Camera]]:
    """The room after each recording that brought reference poses, these, (V, 4, 4), and its camera, newest first."""
    before = bundle
    for room, before in pairwise(states(bundle)):
        count = len(before.reference_poses)
        if count < len(room.reference_poses):
            given = room.edits[-1].record.changes.get("camera")
            yield room, room.reference_poses.poses[count:], room.camera if given is None else Camera(**given)
    yield before, before.reference_poses.poses, before.camera
