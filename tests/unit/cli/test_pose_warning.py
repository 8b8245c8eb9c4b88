"""What is said of errors against poses that fit the images less well than another reading of them."""

from __future__ import annotations

import re

import pytest

from monoloc.cli import pose_warning
from monoloc.recording_check.explanations import Explanation
from monoloc.recording_check.pose_check import PoseCheck
from synthetic_room import Room, RoomRecording, make_path


@pytest.mark.parametrize(
    ("frames", "share", "said"),
    [
        (10, 0.14, "may mean nothing: .*; 10 frames do not decide this; check at least 50 by: monoloc check"),
        (10, 0.6, "mean nothing: .*; give --fix-poses scaled:0.856"),
        (50, 0.14, "mean nothing: .*; give --fix-poses scaled:0.856"),
    ],
)
def test_few_frames_decide_only_by_a_large_error(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], frames: int, share: float, said: str
) -> None:
    other = Explanation("poses of another scale", "--fix-poses scaled:0.856", 1, 0.06)
    check = PoseCheck("explained", 9, 900, share, explanation=other)
    monkeypatch.setattr(pose_warning, "check_poses", lambda recording, pairs: check)
    pose_warning.warn_of_poses(RoomRecording(Room(), make_path(frames)))
    message = capfd.readouterr().err
    assert re.search(f"errors against its poses {said}", message), message
