"""What a removed object hid stays unknown until a camera looks there again."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from edit_helpers import BACK_M, CUBE, mapped_room
from monoloc.bundle import Bundle
from monoloc.edit_record import Edit
from monoloc.editing.edits import add, finish, remove
from monoloc.editing.seen_space import with_seen_space
from monoloc.errors import BundleError
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray
from monoloc.map.occupancy import FREE, UNKNOWN, surface_voxels

VOXEL_M = 0.1


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def states_at(bundle: Bundle, points: FloatArray) -> FloatArray:
    grid = surface_voxels(bundle.original, VOXEL_M, bundle.reference_poses.poses[:, :3, 3])
    return np.asarray(with_seen_space(grid, bundle, np.eye(4)).at(points))


def behind_the_cube() -> FloatArray:
    """Points between the cube and the wall that it hides from all cameras."""
    x, y, z = np.meshgrid(np.linspace(-0.05, 0.05, 3), np.linspace(0.75, 0.85, 3), np.linspace(2.4, BACK_M - 0.3, 4))
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def test_what_a_removed_object_hid_is_free_only_after_a_recording_without_it() -> None:
    room = mapped_room()
    removed = remove(room, CUBE, {}, rng())
    for hidden in (room, removed):
        assert not (states_at(hidden, behind_the_cube()) == FREE).any()
    again = ReferencePoses.without_bias(np.concatenate([room.reference_poses.poses] * 2))
    extended = finish(removed, replace(removed, reference_poses=again), "extend", {}, None, rng())
    assert (states_at(extended, behind_the_cube()) == FREE).mean() > 0.5


def test_a_recording_by_a_narrower_camera_saw_less() -> None:
    """Else, the map would call free what no image has shown."""
    room = mapped_room()
    camera = replace(room.camera, fx=8.0 * room.camera.fx, fy=8.0 * room.camera.fy)
    again = ReferencePoses.without_bias(np.concatenate([room.reference_poses.poses] * 2))
    bare = remove(room, CUBE, {}, rng())
    extended = replace(bare, reference_poses=again)
    wide, narrow = (
        states_at(finish(bare, extended, "extend", {}, None, rng(), **by), behind_the_cube()) == FREE
        for by in ({}, {"camera": asdict(camera)})
    )
    assert wide.any() and not narrow.any()


def test_an_added_object_hides_what_is_behind_it() -> None:
    room = mapped_room()
    before_the_wall = np.array([[0.0, -0.2, 2.5], [0.1, -0.3, 2.5], [-0.1, -0.2, 2.6]])
    assert (states_at(room, before_the_wall) == FREE).all()
    grid = np.stack(np.meshgrid(np.arange(-1.2, 1.2, 0.02), np.arange(-0.9, 0.5, 0.02)), axis=-1).reshape(-1, 2)
    board = np.insert(grid, 2, 1.5, axis=1)
    assert (states_at(add(room, board, {}, rng()), before_the_wall) == UNKNOWN).all()


def test_damaged_undo_is_refused() -> None:
    removed = remove(mapped_room(), CUBE, {}, rng())
    damaged = replace(removed, edits=(Edit(removed.edits[0].record, b"nothing"),))
    with pytest.raises(BundleError, match=r"edits\.npz: edit 1 cannot be taken back .*; copy the bundle again"):
        states_at(damaged, behind_the_cube())
