"""Findings that need neither depth nor poses."""

from __future__ import annotations

from dataclasses import replace

import pytest

from altered_recordings import Altered
from monoloc.recording_check.inspection import inspect_recording
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


@pytest.mark.parametrize("is_exchanged", [False, True])
def test_principal_point_far_from_the_centre_gives_a_warning(is_exchanged: bool) -> None:
    recording = RoomRecording(Room(), make_path(2), SMALL_CAMERA)
    exchanged = replace(SMALL_CAMERA, cx=SMALL_CAMERA.cy, cy=SMALL_CAMERA.cx)
    findings = inspect_recording(Altered(recording, camera=exchanged if is_exchanged else None)).findings
    levels = [finding.level for finding in findings if finding.name == "principal point"]
    assert levels == ["warning"] * is_exchanged
