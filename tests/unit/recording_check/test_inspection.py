"""Findings that need neither depth nor poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from altered_recordings import Altered
from monoloc.geometry import make_pose, so3_exp
from monoloc.io.recording import Remark
from monoloc.recording_check.inspection import Finding, inspect_recording
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


class Noted(Altered):
    notes: list[str]


@pytest.mark.parametrize("is_exchanged", [False, True])
def test_principal_point_far_from_the_centre_gives_a_warning(is_exchanged: bool) -> None:
    recording = RoomRecording(Room(), make_path(2), SMALL_CAMERA)
    exchanged = replace(SMALL_CAMERA, cx=SMALL_CAMERA.cy, cy=SMALL_CAMERA.cx)
    findings = inspect_recording(Altered(recording, camera=exchanged if is_exchanged else None)).findings
    levels = [finding.level for finding in findings if finding.name == "principal point"]
    assert levels == ["warning"] * is_exchanged


def test_notes_warn_only_where_something_is_left_out_or_assumed() -> None:
    recording = Noted(RoomRecording(Room(), make_path(5), SMALL_CAMERA))
    recording.notes = [Remark("colour is /cam/color/image_raw")]
    assert inspect_recording(recording).findings[0] == Finding("frames", "good", "5")
    recording.notes.append("1 of 6 frames are left out: 1 without depth")
    expected = Finding("frames", "warning", "5", "1 of 6 frames are left out: 1 without depth")
    assert inspect_recording(recording).findings[0] == expected


def test_fewer_frames_than_a_build_takes_are_bad() -> None:
    found = inspect_recording(RoomRecording(Room(), make_path(4), SMALL_CAMERA)).findings[0]
    assert found == Finding("frames", "bad", "4", "too few; a build needs at least 5")


def test_walk_with_images_on_their_side_gives_a_warning() -> None:
    poses = make_pose(so3_exp(np.outer(np.linspace(0.0, 3.0, 12), [1.0, 0.0, 0.0])), np.zeros((12, 3)))
    findings = inspect_recording(RoomRecording(Room(), poses, SMALL_CAMERA, has_depth=False)).findings
    assert [finding.level for finding in findings if finding.name == "upright"] == ["warning"]


@pytest.mark.parametrize(("scale_sd", "expected"), [(None, "sensor"), (0.02, "texture")])
def test_too_little_depth_is_explained_by_what_made_it(scale_sd: float | None, expected: str) -> None:
    recording = RoomRecording(Room(), make_path(2), SMALL_CAMERA)
    sparse = Altered(recording, depth=lambda depth: np.where(np.arange(depth.shape[1]) % 5 == 0, depth, 0.0))
    sparse.scale_sd = scale_sd
    [found] = [finding for finding in inspect_recording(sparse).findings if finding.name == "depth"]
    assert found.level == "warning" and expected in found.remark
