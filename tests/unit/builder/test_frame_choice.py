"""The frames of a long recording that a build uses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.builder.frame_choice import choose_frames, most_covering, spread_stretches
from monoloc.builder.trajectories import continuous_segments, is_long
from monoloc.camera import Camera
from monoloc.geometry import FloatArray, make_pose, pose_distance_m, so3_exp
from monoloc.io.recording import Selection
from monoloc.progress import NoProgress

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
RATE_HZ = 10.0


class Walk:
    """A walk along a corridor of 30 m that stands for its first half; depth is that of a wall 2 m ahead.

    No image may be read, and the depth images that were read are counted.
    """

    def __init__(self, count: int, has_depth: bool = True) -> None:
        still = count // 2
        x_m = np.concatenate([np.zeros(still), np.linspace(0.0, 30.0, count - still)])
        turns = so3_exp(np.stack([np.zeros(count), np.sin(x_m), np.zeros(count)], axis=1))
        self.poses: FloatArray | None = make_pose(turns, np.stack([x_m, 0.0 * x_m, 0.0 * x_m], axis=1))
        self.name, self.camera, self.has_depth = "walk", CAMERA, has_depth
        self.timestamps_s = np.arange(count) / RATE_HZ
        self.frame_names = [f"{index}" for index in range(count)]
        self.read: list[int] = []

    def __len__(self) -> int:
        return len(self.frame_names)

    def color(self, index: int) -> NDArray[np.uint8]:
        raise AssertionError("read an image")

    def depth(self, index: int) -> NDArray[np.float32]:
        self.read.append(index)
        return np.full((CAMERA.height, CAMERA.width), 2.0, dtype=np.float32)


def test_a_recording_that_is_short_enough_is_used_as_it_is() -> None:
    walk = Walk(100)
    assert choose_frames(walk, 100, NoProgress()) is walk and walk.read == []


@pytest.mark.parametrize("has_depth", [True, False])
def test_a_long_recording_is_covered_by_a_bounded_number_of_frames(has_depth: bool) -> None:
    walk = Walk(6000, has_depth)
    assert walk.poses is not None
    chosen = choose_frames(walk, 120, NoProgress())
    assert isinstance(chosen, Selection) and chosen.source is walk
    frames = chosen.positions
    assert 100 <= len(frames) <= 120 and np.all(np.diff(frames) > 0)
    assert len(walk.read) <= 240
    assert np.count_nonzero(frames < 2900) < 10  # where the camera stands
    gaps_m = np.diff(walk.poses[frames[frames >= 2900], 0, 3])
    assert gaps_m.max() < 1.0 and gaps_m.min() >= 0.0
    every = walk.poses[::20]
    assert max(pose_distance_m(pose, walk.poses[frames]).min() for pose in every) < 0.6


@pytest.mark.parametrize("places", [1, 2])
def test_frames_of_a_camera_that_stands_are_enough_for_a_build(places: int) -> None:
    walk = Walk(1000)
    walk.poses = np.tile(np.eye(4), (1000, 1, 1))
    walk.poses[500:, 0, 3] = float(places - 1)
    frames = choose_frames(walk, 120, NoProgress())
    assert 30 <= len(frames) <= 120
    assert frames.poses is not None and len(np.unique(frames.poses[:, 0, 3])) == places


def test_half_of_the_frames_can_be_followed_so_that_the_bias_can_be_measured() -> None:
    chosen = choose_frames(Walk(6000), 130, NoProgress())
    assert chosen.poses is not None
    segments = continuous_segments(np.arange(len(chosen)), chosen.timestamps_s, chosen.poses)
    assert sum(len(segment) for segment in segments if is_long(segment)) >= 60


@pytest.mark.parametrize("count", [1, 2, 30, 1200, 6000])
def test_stretches_can_be_followed_however_long_a_recording_is(count: int) -> None:
    walk = Walk(count)
    assert walk.poses is not None
    frames = spread_stretches(2, walk.timestamps_s, walk.poses)
    segments = continuous_segments(frames, walk.timestamps_s, walk.poses)
    assert 1 <= len(segments) <= 2 and len(frames) <= 62
    assert count < 1000 or is_long(segments[-1])


def test_a_selection_keeps_its_source() -> None:
    walk = Walk(400)
    chosen = choose_frames(Selection(walk, np.arange(0, 400, 2)), 50, NoProgress())
    assert isinstance(chosen, Selection) and chosen.source is walk
    assert np.all(chosen.positions % 2 == 0)


def test_a_selection_keeps_poses_of_its_own() -> None:
    moved = Selection(Walk(400), np.arange(0, 400, 2))
    assert moved.poses is not None
    moved.poses = moved.poses + 0.01
    chosen = choose_frames(moved, 50, NoProgress())
    assert isinstance(chosen, Selection)
    np.testing.assert_array_equal(chosen.poses, moved.poses[chosen.positions // 2])


def test_the_cover_is_greedy() -> None:
    sets = [{(1,), (2,)}, {(1,), (2,), (3,)}, {(4,)}, {(5,), (6,)}, {(4,), (5,)}]
    assert most_covering(sets, 3) == [1, 3, 2]
    assert most_covering(sets, 2, covered=[(5,), (6,), (3,)]) == [0, 2]
    assert most_covering(sets, 9) == [1, 3, 2]
