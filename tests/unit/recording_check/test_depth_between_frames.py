"""Depth that disagrees between frames is found; right and noisy depth is not doubted."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from altered_recordings import Altered, turning_path
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.checks import check_recording
from monoloc.recording_check.depth_between_frames import CHECK_DEPTH, find_disagreement
from monoloc.recording_check.inspection import inspect_recording
from synthetic_room import SMALL_CAMERA, Room, RoomRecording


class Uneven(Altered):
    """Depth in a unit of each frame's own, up to 10 % off."""

    def depth(self, index: int) -> NDArray[np.float32]:
        return super().depth(index) * np.float32(0.9 + 0.2 * (0.618 * index % 1.0))


@pytest.fixture(scope="module")
def right() -> RoomRecording:
    return RoomRecording(Room(), turning_path(60), SMALL_CAMERA)


def test_right_depth_is_not_doubted_even_if_it_is_noisy(right: RoomRecording) -> None:
    rng = np.random.default_rng(0)
    noisy = Altered(right, depth=lambda depth: depth * np.exp(rng.normal(0.0, 0.1, depth.shape)))
    assert find_disagreement(right) is None and find_disagreement(noisy) is None


def test_depth_that_differs_between_views_gives_a_warning(right: RoomRecording) -> None:
    uneven = Uneven(right)
    found = next(each for each in inspect_recording(uneven).findings if each.name == "depth between frames")
    assert (found.level, found.remark) == ("warning", CHECK_DEPTH)
    assert re.fullmatch(
        r"by the poses, what two frames see is \d+% nearer or farther in .* \(\d+ pairs\)", found.value
    )
    assert f"{found.value}; {CHECK_DEPTH}" in check_recording(uneven, None, BuildConfig())


def test_poses_that_drift_between_two_visits_are_not_blamed_on_depth() -> None:
    """The camera takes two images a place, twice; by its poses, it is 20 cm farther back the second time."""
    places = np.repeat(turning_path(60)[::6], 2, axis=0)
    places[1::2, 0, 3] += 0.02
    twice = RoomRecording(Room(), np.tile(places, (2, 1, 1)), SMALL_CAMERA)
    poses = twice.poses.copy()
    poses[len(places) :, 2, 3] -= 0.2
    assert find_disagreement(Altered(twice, poses=poses)) is None
