"""Every edit can be taken back, to the bit of what a bundle stores, for bytes that grow with what it changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edit_helpers import (
    CUBE,
    DOWN,
    cube_cloud,
    digest,
    digest_without_last_edit,
    mapped_room,
    shifted,
    written,
)
from monoloc.array_files import MOST_ARRAYS
from monoloc.bundle import Bundle
from monoloc.edit_record import EditRecord
from monoloc.editing.box import Box
from monoloc.editing.edits import add, move, remove
from monoloc.editing.undo import undone, with_edit
from monoloc.geometry import make_pose
from monoloc.landmarks.landmark_map import Landmarks
from refusals import refuses_setting

SHIFT = make_pose(np.eye(3), np.array([0.9, 0.0, -0.4]))
EDITS: dict[str, Callable[[Bundle], Bundle]] = {
    "remove": lambda bundle: remove(bundle, CUBE, {}, np.random.default_rng(0)),
    "add": lambda bundle: add(bundle, shifted(cube_cloud(), 1.0, 0.0, 0.0), {}, np.random.default_rng(0)),
    "move": lambda bundle: move(bundle, CUBE, SHIFT, {}, np.random.default_rng(0)),
}


def stored(bundle: Bundle) -> dict[str, bytes]:
    """All arrays that a bundle stores of its map."""
    known = bundle.reference_poses
    arrays = bundle.original.to_arrays("o_") | bundle.adapted.to_arrays("a_") | bundle.landmarks.to_arrays()
    arrays |= {"forward": known.forward_bias.astype(np.float32), "backward": known.backward_bias.astype(np.float32)}
    return {name: array.tobytes() for name, array in arrays.items()}


@pytest.fixture
def room(tmp_path: Path) -> Bundle:
    return written(mapped_room(), tmp_path)


def test_the_first_of_very_many_edits_is_dropped_so_that_the_bundle_can_be_read(room: Bundle, tmp_path: Path) -> None:
    first, second = EDITS["add"](room).edits[0], EDITS["move"](room).edits[0]
    full = replace(room, edits=(first, *[second] * (MOST_ARRAYS - 1)))
    edited = written(EDITS["remove"](full), tmp_path)
    assert len(edited.edits) == MOST_ARRAYS
    assert [edited.edits[place].record.kind for place in (0, -2, -1)] == ["move", "move", "remove"]
    assert stored(undone(edited)) == stored(room)


@pytest.mark.parametrize("name", EDITS)
def test_edit_is_taken_back_to_the_bit(room: Bundle, tmp_path: Path, name: str) -> None:
    edited = written(EDITS[name](room), tmp_path)
    assert stored(edited) != stored(room)
    back = undone(edited)
    assert stored(back) == stored(room)
    assert back.edits == () and back.cloud == room.cloud and back.provenance == room.provenance
    np.testing.assert_allclose(back.reference_poses.poses, room.reference_poses.poses, atol=1e-6)
    assert digest(back, tmp_path) == digest(room, tmp_path)


def test_edits_are_taken_back_one_by_one(room: Bundle, tmp_path: Path) -> None:
    versions = [room]
    for edit in EDITS.values():
        versions.append(written(edit(versions[-1]), tmp_path))
    assert [edit.record.kind for edit in versions[-1].edits] == list(EDITS)
    bundle = versions[-1]
    for version in reversed(versions[:-1]):
        assert digest_without_last_edit(bundle, tmp_path) == digest(version, tmp_path)
        bundle = undone(bundle)


def test_room_without_landmarks_and_without_reference_poses(room: Bundle) -> None:
    bare = replace(room, landmarks=Landmarks.none())
    assert stored(undone(EDITS["remove"](bare))) == stored(bare)
    unseen = replace(room, landmarks=replace(room.landmarks, views=None))
    assert stored(undone(EDITS["move"](unseen))) == stored(unseen)


def test_bytes_grow_with_what_is_changed(room: Bundle) -> None:
    small = Box.between(np.array([1.5, 0.9, 1.0]), np.array([1.8, 1.1, 1.3]), DOWN)
    little = len(remove(room, small, {}, np.random.default_rng(0)).edits[-1].undo)
    much = len(EDITS["remove"](room).edits[-1].undo)
    whole = sum(len(content) for content in stored(room).values())
    assert little < much < 0.6 * whole


def test_frames_that_an_update_adds_are_taken_back_and_those_before_are_not_kept_twice(room: Bundle) -> None:
    """Else a bundle that is updated every night grows with the square of the nights."""
    checksums = np.random.default_rng(0).integers(0, 2**32, 5000).tolist()
    frames = {f"frame-{index}": checksum for index, checksum in enumerate(checksums)}
    known = replace(room, provenance=room.provenance.model_copy(update={"frames": frames}))
    provenance = known.provenance.model_copy(update={"frames": {**frames, "new": 5}, "brightness": (99.0, 9.0)})
    record = EditRecord(time="2026-01-02T03:04:05+00:00", kind="update", parameters={}, changes={})
    updated = with_edit(known, replace(known, provenance=provenance), record)
    assert len(updated.edits[-1].undo) < 5000
    assert undone(updated).provenance == known.provenance
    fewer = replace(updated, provenance=known.provenance.model_copy(update={"frames": {"new": 5}}))
    with pytest.raises(ValueError, match=r"cannot be taken back .5000 frames before it"):
        undone(fewer)
    # Whatever an edit does with frames is taken back.
    assert undone(with_edit(known, fewer, record)).provenance == known.provenance


def test_nothing_to_take_back_is_refused(room: Bundle) -> None:
    refuses_setting(lambda: undone(room), "undo", "no edit to take back", "map edit BUNDLE log")


def test_damaged_undo_is_refused(room: Bundle) -> None:
    edited = EDITS["remove"](room)
    last = edited.edits[-1]
    cut = replace(edited, edits=(replace(last, undo=last.undo[:100]),))
    with pytest.raises(ValueError, match="no whole archive"):
        undone(cut)
    with pytest.raises(ValueError, match="cannot be taken back"):
        undone(replace(edited, original=edited.original, landmarks=Landmarks.none()))
