"""A map grows by another walk or another bundle, in the same world or in one that is found first."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from altered_recordings import Altered
from edit_helpers import (
    VOXEL_M,
    built_from_others,
    bundle_of_walk,
    digest,
    digest_without_last_edit,
    in_another_world,
    walk,
    written,
)
from monoloc.bundle import Bundle
from monoloc.editing.alignment import known
from monoloc.editing.extension import SEEN_BY_UPDATE, extend, merge, with_frames
from monoloc.editing.undo import undone
from monoloc.geometry import FloatArray, invert, pose_distance_m, se3_exp, transform
from monoloc.io.recording import Recording, Selection
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.map.cloud import cloud_from_recording
from monoloc.map.mixture import GaussianMixture
from refusals import refuses_data
from synthetic_room import Room, RoomRecording, make_path

OTHER = se3_exp(np.array([2.0, -0.7, 1.1, 0.1, 2.3, -0.2]))  # T_other_world
pytestmark = pytest.mark.usefixtures("one_thread")


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def extended(recording: Recording, align: bool = False, bundle: Bundle | None = None) -> Bundle:
    return extend(bundle or bundle_of_walk("A"), recording, align, {}, rng())


def changes(bundle: Bundle) -> dict[str, Any]:
    return bundle.edits[-1].record.changes


def shifted(mixture: GaussianMixture, x: float) -> GaussianMixture:
    return replace(mixture, means=mixture.means + np.array([x, 0.0, 0.0]))


GL = np.diag([1.0, -1.0, -1.0, 1.0])


@cache
def long_walk() -> RoomRecording:
    """The second walk with as many frames as its poses can be compared by."""
    recording = RoomRecording(Room(), make_path(40, 3.4, 15.0))
    recording.name = "walk-B"
    return recording


def in_milliseconds(recording: Recording) -> Recording:
    altered = Altered(recording)
    altered.timestamps_s = 1000.0 * recording.timestamps_s
    return altered


class Joined(Altered):
    """One recording after another."""

    def __init__(self, first: RoomRecording, second: RoomRecording) -> None:
        super().__init__(first, np.concatenate([first.poses, second.poses]))
        self.name, self._both, self._count = "both", (first, second), len(first)
        self.frame_names = [f"{walk.name}-{name}" for walk in self._both for name in walk.frame_names]
        self.timestamps_s = np.concatenate([first.timestamps_s, second.timestamps_s + 100.0])

    def __len__(self) -> int:
        return len(self.frame_names)

    def color(self, index: int) -> NDArray[np.uint8]:
        return self._both[index // self._count].color(index % self._count)

    def depth(self, index: int) -> NDArray[np.float32]:
        return self._both[index // self._count].depth(index % self._count)


def test_walk_in_the_same_world_adds_what_the_map_does_not_know() -> None:
    room, recording = bundle_of_walk("A"), walk("B")
    edited = extended(recording)
    cloud = cloud_from_recording(recording, VOXEL_M)
    assert known(room, cloud).mean() < 0.9 and known(edited, cloud).mean() > 0.97
    # As dense as the rest, and the rest as it was.
    count = len(room.original)
    added = len(edited.original) - count
    assert added / (edited.cloud.points - room.cloud.points) == pytest.approx(count / room.cloud.points, rel=0.2)
    np.testing.assert_array_equal(edited.original.means[:count], room.original.means)
    assert changes(edited)["frames_confirmed_by_landmarks"] >= 7 and changes(edited)["frames_looked_at"] == 14
    assert changes(edited)["frames_contradicted_by_landmarks"] <= 3
    assert not {"warnings", "frames_left_out", "largest_share_of_a_view"} & changes(edited).keys()
    assert len(edited.reference_poses) == 28 and len(edited.provenance.frames) == 28
    assert edited.provenance.recording == "walk-A + walk-B"


def test_landmarks_of_both_walks_are_kept_once_and_are_familiar_to_the_new_views() -> None:
    room, edited = bundle_of_walk("A"), extended(walk("B"))
    before, after = room.landmarks, edited.landmarks
    np.testing.assert_array_equal(after.points[: len(before)], before.points)
    assert len(after) > 1.2 * len(before)
    np.testing.assert_array_equal(after.views.found[:14, : len(before)], before.views.found)
    assert not after.views.found[:14, len(before) :].any()
    found_old, found_new = (
        after.views.found[14:, part].sum() for part in (slice(len(before)), slice(len(before), None))
    )
    assert found_old > 100 and found_new > 100


def test_extension_is_taken_back(tmp_path: Path) -> None:
    room = written(bundle_of_walk("A"), tmp_path)
    edited = extended(walk("B"), bundle=room)
    assert digest_without_last_edit(edited, tmp_path) == digest(room, tmp_path)
    back = undone(edited)
    np.testing.assert_allclose(back.original.means, room.original.means, atol=1e-6)
    np.testing.assert_array_equal(back.landmarks.points, room.landmarks.points)
    np.testing.assert_array_equal(back.landmarks.views.found, room.landmarks.views.found)
    assert back.provenance == room.provenance and len(back.reference_poses) == 14


def test_walk_that_the_map_knows_changes_no_component() -> None:
    room = bundle_of_walk("A")
    edited = extended(walk("A"), bundle=built_from_others(room))
    assert len(edited.original) <= len(room.original) + 1


def test_frames_that_the_map_was_made_of_are_left_out() -> None:
    both = Joined(walk("A"), walk("B"))
    edited = extended(both)
    assert changes(edited)["frames_left_out"] == 14 and len(edited.reference_poses) == 28
    for known_frames in (walk("A"), walk("B"), both):
        refuses_data(
            lambda again=known_frames: extended(again, bundle=edited),
            known_frames.name,
            "holds only frames that the map was made of",
            "--frames",
        )


CONTRADICTIONS: dict[str, tuple[Callable[[Recording], Recording], str, str]] = {
    "milliseconds": (in_milliseconds, "look like milliseconds|are not seconds", "in seconds|divide them by 1000"),
    "convention": (
        lambda walk: Altered(walk, poses=walk.poses @ GL),
        "as camera axes of OpenGL",
        "--fix-poses opengl",
    ),
    "unit of depth": (
        lambda walk: Altered(walk, depth=lambda depth: 2.0 * depth),
        r"differ by a factor of (2|2\.0\d|1\.9\d) \(to \d%\)",
        "scaled:",
    ),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
@pytest.mark.parametrize("align", [False, True])
def test_walk_that_a_build_refuses_is_refused(name: str, align: bool) -> None:
    altered, problem, fix = CONTRADICTIONS[name]
    refuses_data(lambda: extended(altered(long_walk()), align=align), "walk-B", problem, fix)


def test_walk_with_noisy_poses_is_warned_of() -> None:
    noise = se3_exp(rng().normal(size=(40, 6)) * np.repeat([0.02, 0.01], 3))
    noisy = Altered(long_walk(), poses=long_walk().poses @ noise)
    (warning,) = changes(extended(noisy))["warnings"]
    assert "poses fit the images poorly" in warning and warning.endswith("; check them: monoloc check")


@pytest.mark.slow
def test_walk_in_another_world_is_found() -> None:
    moved = Selection(walk("B"), range(14))
    moved.poses = OTHER @ walk("B").poses
    edited = extended(moved, align=True)
    found = np.array(changes(edited)["T_world_other"])
    assert pose_distance_m(invert(OTHER), found[None])[0] < 0.02
    assert changes(edited)["landmarks_to_surfaces"] < 0.05
    assert 3 <= changes(edited)["agreeing_frames"] <= 14 and "agreeing_landmarks" not in changes(edited)
    np.testing.assert_allclose(edited.reference_poses.poses[14:], walk("B").poses, atol=0.03)


def test_walk_in_another_world_is_refused_as_one_in_the_same() -> None:
    moved, room = in_another_world(walk("A"), OTHER), built_from_others(bundle_of_walk("A"))
    refuses_data(
        lambda: extended(moved, bundle=room), "walk-A", "is in another world: landmarks see its cameras", "--align"
    )


@pytest.mark.parametrize("align", [False, True])
def test_walk_whose_depth_is_in_another_unit_is_refused(align: bool) -> None:
    """By landmarks, as far as poses do not tell: a tenth passes the check of the recording."""
    wrong, room = Altered(walk("B"), depth=lambda depth: 1.1 * depth), built_from_others(bundle_of_walk("A"))
    problem = "its depth is 1.1 times as far as the map's landmarks"
    refuses_data(lambda: extended(wrong, align, room), "walk-B", problem, "correct its depth")


def test_map_of_a_video_may_be_what_has_the_wrong_scale() -> None:
    wrong, room = Altered(walk("B"), depth=lambda depth: 1.1 * depth), built_from_others(bundle_of_walk("A"))
    guessed = replace(room, provenance=room.provenance.model_copy(update={"scale_sd": 0.1}))
    fix = "no depth sensor measured the map's scale: .*, build the room from this recording; else correct its depth"
    refuses_data(lambda: extended(wrong, bundle=guessed), "walk-B", "1.1 times as far as the map's landmarks", fix)


def test_walk_through_another_room_is_refused() -> None:
    other = walk("A", room_seed=7)
    refuses_data(lambda: extended(other, align=True), "walk-A", "is not found in the room", "record it from where")


@pytest.mark.parametrize(
    ("shift_m", "problem", "fix"),
    [(0.3, "landmarks and surfaces do not agree", "monoloc check"), (30.0, "does not fit: .* knows 0%", "overlaps")],
)
def test_landmarks_and_surfaces_must_agree(shift_m: float, problem: str, fix: str) -> None:
    room = built_from_others(bundle_of_walk("A"))
    torn = replace(room, original=shifted(room.original, shift_m), adapted=shifted(room.adapted, shift_m))
    refuses_data(lambda: extended(walk("A"), align=True, bundle=torn), "walk-A", problem, fix)


@pytest.mark.parametrize("what", ["poses", "depth"])
def test_walk_without_poses_or_depth_is_refused(what: str) -> None:
    bare = copy(walk("B"))
    if what == "poses":
        bare.poses = None
    else:
        bare.has_depth = False
    refuses_data(lambda: extended(bare), "walk-B", f"has no {what}", "poses and depth")


@pytest.mark.slow
def test_bias_of_a_tuned_network_is_measured_on_the_new_frames() -> None:
    room = bundle_of_walk("A")
    tuned = replace(room, provenance=room.provenance.model_copy(update={"tune": "all"}))
    edited = extended(walk("B"), bundle=tuned)
    assert changes(edited)["bias_sd_m"] == round(edited.settings.particle_bias.sd_at_reference_m, 4)
    assert edited.settings.particle_bias.sd_at_reference_m >= room.settings.particle_bias.sd_at_reference_m
    assert extended(walk("B")).settings == room.settings
    assert undone(edited).settings == room.settings


def moved_bundle(bundle: Bundle, T_new_old: FloatArray) -> Bundle:
    """The same room in another world."""
    means, rotation = transform(T_new_old, bundle.original.means), T_new_old[:3, :3]
    covariances = rotation @ bundle.original.covariances @ rotation.T
    mixture = GaussianMixture(bundle.original.weights, means, 0.5 * (covariances + covariances.swapaxes(-1, -2)))
    landmarks, known_bias = bundle.landmarks, bundle.reference_poses
    points = transform(T_new_old, landmarks.points.astype(np.float64)).astype(np.float32)
    views = replace(landmarks.views, poses=T_new_old @ landmarks.views.poses)
    return replace(
        bundle,
        original=mixture,
        adapted=mixture,
        landmarks=Landmarks(points, landmarks.descriptors, views),
        reference_poses=replace(known_bias, poses=T_new_old @ known_bias.poses),
    )


def test_bundle_in_another_world_is_merged(tmp_path: Path) -> None:
    room, other = written(bundle_of_walk("A"), tmp_path), moved_bundle(bundle_of_walk("B"), OTHER)
    edited = merge(room, other, "b.monoloc", {}, rng())
    found = np.array(changes(edited)["T_world_other"])
    assert pose_distance_m(invert(OTHER), found[None])[0] < 0.03
    assert changes(edited)["agreeing_landmarks"] >= 30
    assert not {"agreeing_frames", "largest_share_of_a_view"} & changes(edited).keys()
    cloud = cloud_from_recording(walk("B"), VOXEL_M)
    assert known(room, cloud).mean() < 0.9 and known(edited, cloud).mean() > 0.95
    assert len(room.original) < len(edited.original) < len(room.original) + len(other.original)
    assert len(room.landmarks) < len(edited.landmarks) < len(room.landmarks) + len(other.landmarks)
    assert edited.landmarks.views.found.shape == (28, len(edited.landmarks))
    assert edited.depth_model == room.depth_model and changes(edited)["same_network"]
    np.testing.assert_allclose(edited.reference_poses.poses[14:], walk("B").poses, atol=0.04)
    assert len(edited.provenance.frames) == 28  # the frames of both have the same names
    back = undone(edited)
    np.testing.assert_array_equal(back.landmarks.descriptors, room.landmarks.descriptors)
    assert back.settings == room.settings and back.thresholds == room.thresholds
    assert digest_without_last_edit(edited, tmp_path) == digest(room, tmp_path)


def test_bundle_whose_frames_the_map_was_made_of_is_not_merged() -> None:
    """After a first merge, or because it was built from a part of the same recording."""
    room, other = bundle_of_walk("A"), moved_bundle(bundle_of_walk("B"), OTHER)
    edited = merge(room, other, "b.monoloc", {}, rng())
    for again in (other, room):
        refuses_data(
            lambda again=again: merge(edited, again, "again.monoloc", {}, rng()),
            "again.monoloc",
            "holds only frames that the map was made of",
            "another recording",
        )
    assert len(merge(undone(edited), other, "b.monoloc", {}, rng()).provenance.frames) == 28
    # What only an update used gave the map no surfaces.
    used = {f"{SEEN_BY_UPDATE}{frame}": checksum for frame, checksum in other.provenance.frames.items()}
    provenance = with_frames(room.provenance, room.provenance.recording, used)
    assert merge(replace(room, provenance=provenance), other, "b.monoloc", {}, rng()).edits


def test_bundle_of_another_room_is_not_merged() -> None:
    room = bundle_of_walk("A")
    descriptors = rng().integers(0, 256, (len(room.landmarks), 32)).astype(np.uint8)
    other = replace(built_from_others(room), landmarks=replace(room.landmarks, descriptors=descriptors))
    refuses_data(lambda: merge(room, other, "b.monoloc", {}, rng()), "b.monoloc", "does not overlap", "common part")


def test_bundle_of_another_scale_is_not_merged() -> None:
    """Landmarks of a part of the room agree all the same."""
    room, other = bundle_of_walk("A"), bundle_of_walk("B")
    larger = replace(other, landmarks=replace(other.landmarks, points=other.landmarks.points * np.float32(1.08)))
    problem = "is in another scale: its distances are 1.08 times those of the room"
    fix = "build the wrong one again, from depth and poses in metres, or from its video with a better --scale"
    refuses_data(lambda: merge(room, larger, "b.monoloc", {}, rng()), "b.monoloc", problem, fix)


def test_what_landmarks_would_place_says_where_there_are_none() -> None:
    room = bundle_of_walk("A")
    bare = replace(built_from_others(room), landmarks=Landmarks.none())
    fix = "build both with landmarks"
    refuses_data(lambda: merge(room, bare, "b.monoloc", {}, rng()), "b.monoloc", "it has no landmarks", fix)
    refuses_data(lambda: merge(bare, room, "b.monoloc", {}, rng()), "b.monoloc", "the other bundle has no", fix)
    problem = "cannot be aligned: the bundle has no landmarks"
    refuses_data(lambda: extended(walk("B"), bundle=bare, align=True), "walk-B", problem, "without --align")
