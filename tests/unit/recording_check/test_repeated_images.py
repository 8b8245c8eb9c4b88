"""Images that repeat while the poses move are found; those of a camera that stands still are not doubted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from altered_recordings import Altered
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.checks import check_recording
from monoloc.recording_check.inspection import inspect_recording
from monoloc.recording_check.repeated_images import find_repeats
from synthetic_room import RoomRecording


class Frozen(Altered):
    """Half way, its image stays as it is."""

    def color(self, index: int) -> NDArray[np.uint8]:
        return super().color(min(index, 12))


class FrozenOnce(Altered):
    """One frame has the image of the one before."""

    def color(self, index: int) -> NDArray[np.uint8]:
        return super().color(12 if index == 13 else index)


def test_images_that_change_with_the_poses_are_not_doubted(right: RoomRecording) -> None:
    assert find_repeats(right) is None


def test_a_camera_that_stands_still_may_repeat_its_image(right: RoomRecording) -> None:
    still = Frozen(right, poses=right.poses[np.minimum(np.arange(24), 12)])
    assert find_repeats(still) is None


def test_one_image_that_repeats_and_a_blank_wall_are_not_doubted(right: RoomRecording) -> None:
    assert find_repeats(FrozenOnce(right)) is None
    assert find_repeats(Altered(right, color=lambda image: np.full_like(image, 200))) is None


def test_a_stream_that_froze_gives_a_warning_that_names_the_first_frames(right: RoomRecording) -> None:
    frozen = Frozen(right)
    names = f"as {right.frame_names[12]} and {right.frame_names[13]}"
    found = (
        f"11 of 23 pairs of neighbouring frames looked at show one and the same image while the poses move, {names}"
    )
    line = next(each for each in inspect_recording(frozen).findings if each.name == "images")
    assert (line.level, line.value, line.remark) == (
        "warning",
        found,
        "leave out the frames whose own image did not arrive",
    )
    assert f"{found}; {line.remark}" in check_recording(frozen, None, BuildConfig())
