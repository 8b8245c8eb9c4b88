"""Flights through a room in which a box was moved mend its map; flights elsewhere change nothing."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from altered_recordings import Altered
from edit_helpers import digest, digest_without_last_edit, faces, written
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.editing.edits import add, remove
from monoloc.editing.extension import with_frames
from monoloc.editing.undo import undone
from monoloc.errors import DataError
from monoloc.map.mixture import GaussianMixture
from monoloc.updating.apply_update import applied
from monoloc.updating.observed_flight import views_of
from monoloc.updating.proposals import Proposal, proposals
from monoloc.updating.room_evidence import (
    Evidence,
    evidence_path,
    landmark_keys,
    read_evidence,
    write_evidence,
)
from monoloc.updating.surface_ageing import VOXEL_M
from monoloc.updating.tally import PRIOR_ODDS
from refusals import refuses_data
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path
from update_helpers import LEFT, evidence_of, flight, mapped, observed

pytestmark = pytest.mark.usefixtures("one_thread")


def proposed(evidence: Evidence, kind: str) -> list[Proposal]:
    return [each for each in proposals(evidence, mapped()) if each.kind == kind]


def updated() -> tuple[Bundle, Evidence]:
    evidence = evidence_of(1, 2)
    every = proposals(evidence, mapped())
    return applied(mapped(), evidence, every, np.random.default_rng(0))


def test_two_flights_find_what_is_gone_and_what_is_new() -> None:
    evidence = evidence_of(1, 2)
    points = mapped().landmarks.points.astype(np.float64)
    retired = np.concatenate([each.members for each in proposed(evidence, "retire landmarks")])
    on_box = LEFT.contains(points)
    assert np.isin(landmark_keys(mapped().landmarks)[on_box], retired).mean() > 0.5
    # Others are behind the box now, or were seen past it.
    assert len(retired) < 2 * on_box.sum()
    (gone,) = proposed(evidence, "remove surfaces")
    assert LEFT.contains(gone.points).all() and len(gone.members) >= 20
    (new,) = proposed(evidence, "add surfaces")
    assert not LEFT.contains(new.points).any() and np.all(np.abs(new.points[:, 2] - 2.2) < 0.1)  # its front, there
    assert len(proposed(evidence, "add landmarks")) >= 1


def test_a_proposal_keeps_its_id_in_the_file_and_when_others_are_applied(tmp_path: Path) -> None:
    evidence = evidence_of(1, 2)
    every = proposals(evidence, mapped())
    ids = [each.id for each in every]
    assert len(set(ids)) == len(ids) >= 4
    write_evidence(tmp_path / "room.evidence.npz", evidence, mapped())
    read = read_evidence(tmp_path / "room.evidence.npz", mapped())
    assert [each.id for each in proposals(read, mapped())] == ids
    for number, chosen in enumerate(every):
        bundle, left = applied(mapped(), evidence, [chosen], np.random.default_rng(0))
        others = [each.id for each in proposals(left, bundle)]
        assert others == ids[:number] + ids[number + 1 :]


def test_what_an_edit_has_added_meanwhile_is_not_proposed_again() -> None:
    evidence = evidence_of(1, 2)
    (new,) = proposed(evidence, "add surfaces")
    edited = add(mapped(), new.points, {}, np.random.default_rng(0))
    others = [each.id for each in proposals(evidence, mapped()) if each.kind != "add surfaces"]
    assert [each.id for each in proposals(evidence, edited)] == others


def test_a_full_map_gets_as_many_landmarks_as_are_retired(monkeypatch: pytest.MonkeyPatch) -> None:
    """As one that was extended or merged."""
    evidence = evidence_of(1, 2)
    monkeypatch.setattr("monoloc.updating.proposals._MOST_LANDMARKS", 1)
    counts = {"retire landmarks": 0, "add landmarks": 0}
    for each in proposals(evidence, mapped()):
        counts[each.kind] = counts.get(each.kind, 0) + len(each.members)
    proven = int(evidence.candidates.tally.is_proven.sum())
    assert counts["add landmarks"] == min(proven, counts["retire landmarks"]) > 0


def test_candidates_that_the_next_flight_does_not_find_again_are_given_up() -> None:
    """The box stood elsewhere for one flight only."""
    first = evidence_of(1).candidates
    back = observed(flight(2, Room()))
    second = evidence_of(1).after_flight(mapped(), back, True, np.random.default_rng(0)).candidates
    again = {point.tobytes() for point in second.corners.points}
    kept = sum(point.tobytes() in again for point in first.corners.points)
    assert 0 < kept < 0.5 * len(first)
    assert second.tally.odds.min() > 1.01 * PRIOR_ODDS


@pytest.mark.slow
def test_one_flight_proposes_nothing_and_an_unchanged_room_loses_nothing() -> None:
    assert proposals(evidence_of(1), mapped()) == []
    unchanged = evidence_of(1, 2, room=Room())
    kinds = {each.kind for each in proposals(unchanged, mapped())}
    assert kinds <= {"add landmarks"}


def test_parts_of_the_drone_in_the_image_show_no_change_of_the_room() -> None:
    """They are known from the twentieth frame or so on, and were in the images before."""
    width, height = SMALL_CAMERA.width, SMALL_CAMERA.height
    guards = np.zeros((height, width), np.uint8)
    for corner in ((0, height), (width, height)):
        cv2.circle(guards, corner, 3 * width // 10, 1, -1)
    colors = np.random.default_rng(0).integers(0, 256, (8, 10, 3), dtype=np.uint8)
    picture = cv2.resize(colors, (width, height), interpolation=cv2.INTER_NEAREST)
    evidence = Evidence.none(mapped())
    for number in (1, 2):
        recording = RoomRecording(Room(), make_path(40, 0.03 + 0.02 * number, 8.0), SMALL_CAMERA)
        recording.name = f"guarded-{number}"
        seen = observed(
            Altered(
                recording,
                color=lambda color: np.where(guards[..., None] > 0, picture, color),
                depth=lambda depth_m: np.where(guards > 0, np.float32(0.3), depth_m),
            )
        )
        assert seen.refusal is None
        evidence = evidence.after_flight(mapped(), seen, True, np.random.default_rng(0))
    assert {each.kind for each in proposals(evidence, mapped())} <= {"add landmarks"}


def test_an_update_is_edits_that_can_be_undone() -> None:
    bundle, left = updated()
    assert [edit.record.kind for edit in bundle.edits] == ["update"] * len(bundle.edits)
    assert proposals(left, bundle) == []
    views = bundle.landmarks.views
    assert views is not None
    added = ~np.isin(landmark_keys(bundle.landmarks), landmark_keys(mapped().landmarks))
    assert views.found[:, added].sum(axis=0).min() >= 2  # so that they may be retired some day
    assert set(left.frames) <= set(bundle.provenance.frames.values())
    while bundle.edits:
        bundle = undone(bundle)
    np.testing.assert_array_equal(bundle.landmarks.points, mapped().landmarks.points)
    np.testing.assert_array_equal(
        bundle.original.means.astype(np.float32), mapped().original.means.astype(np.float32)
    )


def test_a_removal_of_next_to_nothing_of_the_map_does_not_stop_an_update() -> None:
    """A few voxels of a wall that is one component."""
    wall = GaussianMixture(np.ones(1), np.zeros((1, 3)), np.diag([4.0, 4.0, 1e-4])[None])
    room = replace(mapped(), original=wall, adapted=wall)
    voxels = np.array([[8, 8, 0], [9, 8, 0], [10, 8, 0]])
    gone = Proposal("remove surfaces", voxels, (voxels + 0.5) * VOXEL_M, 2, 5.0, 5.0, 30.0)
    bundle, _ = applied(room, Evidence.none(room), [gone], np.random.default_rng(0))
    assert bundle.original is wall and len(bundle.edits) == 1


def test_an_update_of_an_extended_map_keeps_the_names_of_its_recordings() -> None:
    evidence, provenance = evidence_of(1, 2), mapped().provenance
    room = replace(mapped(), provenance=with_frames(provenance, "second walk", {"0": 1}))
    names = f"{provenance.recording} + second walk"
    every = proposals(evidence, room)
    bundle, _ = applied(room, evidence, every, np.random.default_rng(0))
    assert len(bundle.edits) >= 4 and room.provenance.recording == bundle.provenance.recording == names


@pytest.mark.slow
def test_the_updated_map_finds_again_what_the_old_one_missed() -> None:
    bundle, _ = updated()
    before, after = (observed(flight(3), each) for each in (mapped(), bundle))
    shares = [np.mean(np.concatenate([f.is_found for f in each.frames])) for each in (before, after)]
    assert shares[1] > 1.2 * shares[0]
    assert after.states.get("map-changed", 0) < before.states["map-changed"]


@pytest.mark.slow
def test_a_flight_counts_once() -> None:
    again = observed(flight(1), known=frozenset(evidence_of(1).frames))
    assert again.refusal is not None and "counted before" in again.refusal
    assert evidence_of(1).after_flight(mapped(), again, True, np.random.default_rng(0)) is evidence_of(1)


def test_a_flight_whose_depth_is_in_another_unit_is_refused() -> None:
    wrong = Altered(flight(1), depth=lambda depth: 1.25 * depth)
    seen = observed(wrong)
    assert len(seen.frames) >= 5  # landmarks place the camera all the same
    assert seen.refusal is not None and "its depth is 1.25 times as far as the map's landmarks" in seen.refusal
    assert observed(Altered(flight(1), depth=lambda depth: 1.03 * depth)).refusal is None


def test_a_flight_that_hardly_moves_is_refused_and_is_told_why() -> None:
    refusal = observed(RoomRecording(Room(), make_path(12, 1.0, 200.0), SMALL_CAMERA)).refusal
    assert refusal is not None
    assert re.match(r"[0-4] of its frames are usable, fewer than 5 \(as the view before: [0-9]+", refusal)


def test_an_update_is_taken_back_to_the_bit(tmp_path: Path) -> None:
    room, evidence = written(mapped(), tmp_path), evidence_of(1, 2)
    for proposal in {each.kind: each for each in proposals(evidence, room)}.values():
        bundle, _ = applied(room, evidence, [proposal], np.random.default_rng(0))
        assert digest_without_last_edit(bundle, tmp_path) == digest(room, tmp_path)


def test_a_flight_in_another_room_is_refused() -> None:
    elsewhere = observed(RoomRecording(Room(7, 1.4), make_path(16, 0.05, 8.0), SMALL_CAMERA))
    assert elsewhere.refusal is not None
    evidence = Evidence.none(mapped())
    assert evidence.after_flight(mapped(), elsewhere, True, np.random.default_rng(0)) is evidence


def test_evidence_comes_back_and_follows_the_landmarks(tmp_path: Path) -> None:
    path = evidence_path(tmp_path / "room.monoloc")
    assert path.name == "room.evidence.npz"
    evidence = evidence_of(1)
    assert write_evidence(path, evidence, mapped()) < 200_000
    same = read_evidence(path, mapped())
    np.testing.assert_array_equal(same.landmarks.log_odds, evidence.landmarks.log_odds)
    np.testing.assert_array_equal(same.surfaces.new.cells, evidence.surfaces.new.cells)
    assert (same.flights, same.frames, len(same.candidates)) == (
        evidence.flights,
        evidence.frames,
        len(evidence.candidates),
    )
    bundle, _ = updated()  # after an edit that took landmarks away and added others
    followed = read_evidence(path, bundle)
    kept = np.isin(landmark_keys(bundle.landmarks), landmark_keys(mapped().landmarks))
    assert len(followed.landmarks) == len(bundle.landmarks)
    assert np.all(followed.landmarks.flights[~kept] == 0)


def test_what_an_edit_has_put_where_a_surface_was_gone_is_not_proposed_for_removal(tmp_path: Path) -> None:
    """No flight has looked there since."""
    path = tmp_path / "room.evidence.npz"
    write_evidence(path, evidence_of(1, 2), mapped())
    assert proposed(read_evidence(path, mapped()), "remove surfaces")
    rng = np.random.default_rng(0)
    another = faces(LEFT.centre - LEFT.half, LEFT.centre + LEFT.half)
    edited = add(remove(mapped(), LEFT, {}, rng), another, {}, rng)
    write_bundle(tmp_path / "room.monoloc", edited)
    room = read_bundle(tmp_path / "room.monoloc")
    left = read_evidence(path, room)
    assert not [each for each in proposals(left, room) if each.kind == "remove surfaces"]
    write_evidence(path, left, room)
    assert len(read_evidence(path, room).surfaces.gone) == len(left.surfaces.gone)
    write_evidence(path, evidence_of(1, 2), room)  # flights that have seen it
    assert len(read_evidence(path, room).surfaces.gone) == len(evidence_of(1, 2).surfaces.gone)


def test_damaged_and_foreign_evidence_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "room.evidence.npz"
    write_evidence(path, Evidence.none(mapped()), mapped())
    provenance = mapped().provenance.model_copy(update={"seed": 5})
    other = replace(mapped(), provenance=provenance)
    refuses_data(lambda: read_evidence(path, other), path, "evidence of another room", "its own bundle")
    path.write_bytes(path.read_bytes()[:-40])
    refuses_data(lambda: read_evidence(path, mapped()), path, "holds no evidence", "remove it")


def test_a_bundle_without_views_cannot_be_updated() -> None:
    blind = replace(mapped(), integrity=mapped().integrity.model_copy(update={"familiar_found": 0.0}))
    with pytest.raises(DataError, match=r"cannot be updated.*; build it from more frames"):
        views_of(blind)
