"""Edits as they are drawn: their places, and what went and came as far as the map of today shows it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from edit_helpers import CUBE, cube_cloud, mapped_room, shifted
from monoloc.bundle import Bundle
from monoloc.edit_record import EditRecord
from monoloc.editing.box import Box
from monoloc.editing.edit_history import drawn_edits
from monoloc.editing.edits import add, move, remove
from monoloc.editing.undo import undone, with_edit
from monoloc.errors import BundleError
from monoloc.geometry import make_pose, so3_exp

SHIFT, TURN_DEG = np.array([0.9, 0.0, -0.4]), 30.0
GIVEN = {"lower_m": (CUBE.centre - CUBE.half).tolist(), "upper_m": (CUBE.centre + CUBE.half).tolist(), "yaw_deg": 0.0}


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@cache
def added_then_moved() -> Bundle:
    """A second cube was added on the left, and the first one moved to the right."""
    rotation = so3_exp([0.0, -np.deg2rad(TURN_DEG), 0.0])
    T_new_old = make_pose(rotation, CUBE.centre + SHIFT - rotation @ CUBE.centre)
    bundle = add(mapped_room(), shifted(cube_cloud(), -1.2, 0.0, 0.0), {"cloud": "cube.npz"}, rng())
    return move(bundle, CUBE, T_new_old, GIVEN | {"by_m": SHIFT.tolist(), "turn_deg": TURN_DEG}, rng())


def test_map_as_built_has_none() -> None:
    assert drawn_edits(mapped_room(), rng()) == ()


def test_edits_are_where_they_were_made_and_named_as_in_the_list() -> None:
    added, moved = drawn_edits(added_then_moved(), rng())
    assert (added.name, moved.name) == ("1 add", "2 move")
    assert added.place is not None and moved.place is not None and moved.moved_to is not None
    np.testing.assert_allclose(added.place.centre, CUBE.centre - [1.2, 0.0, 0.0], atol=0.1)
    np.testing.assert_allclose(added.place.half, CUBE.half, atol=0.1)
    assert not added.is_taking and added.moved_to is None and len(added.came) > 300 and not len(added.went)
    np.testing.assert_allclose(moved.place.centre, CUBE.centre)
    np.testing.assert_allclose(moved.moved_to.centre, CUBE.centre + SHIFT)
    assert CUBE.contains(moved.went).all() and moved.moved_to.contains(moved.came).all()
    assert min(len(moved.went), len(moved.came)) > 300
    # Its landmarks lie in the turned box as they lay in the first one.
    assert len(moved.went_landmarks) == len(moved.came_landmarks) == 50
    np.testing.assert_allclose(
        (moved.came_landmarks - moved.moved_to.centre) @ moved.moved_to.R_world_box,
        moved.went_landmarks - CUBE.centre,
        atol=1e-4,
    )


def test_what_was_taken_back_or_changed_later_is_not_drawn() -> None:
    (added,) = drawn_edits(undone(added_then_moved()), rng())
    assert added.name == "1 add" and added.place is not None
    place = Box(added.place.centre, added.place.half + 0.1, np.eye(3))
    first, _, third = drawn_edits(remove(added_then_moved(), place, {}, rng()), rng())
    assert len(first.came) < 0.05 * len(added.came) and first.place is not None
    assert third.is_taking and len(third.went) > 300
    mended = add(remove(mapped_room(), CUBE, GIVEN, rng()), cube_cloud(), {}, rng())
    removed, again = drawn_edits(mended, rng())
    assert len(removed.went) < 100 < 300 < len(again.came)


def test_edit_of_landmarks_alone_has_their_bounds() -> None:
    room = mapped_room()
    kept = np.arange(len(room.landmarks)) >= 50  # the others are on the cube
    record = EditRecord(time="", kind="update", parameters={"lower_m": "damaged"}, changes={})
    (edit,) = drawn_edits(with_edit(room, replace(room, landmarks=room.landmarks.select(kept)), record), rng())
    assert edit.is_taking and len(edit.went_landmarks) == 50 and not len(edit.went) + len(edit.came)
    assert edit.place is not None and CUBE.contains(edit.place.corners).all()
    (nothing,) = drawn_edits(with_edit(room, room, record), rng())
    assert nothing.place is None and not nothing.is_taking


def test_damaged_undo_is_refused_in_one_line() -> None:
    edited = added_then_moved()
    damaged = replace(edited, edits=(edited.edits[0], replace(edited.edits[1], undo=b"nothing")))
    with pytest.raises(BundleError, match=r"^edits\.npz: edit 2 cannot be taken back \(.*\); copy the bundle again"):
        drawn_edits(damaged, rng())
