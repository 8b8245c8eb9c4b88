"""Trajectories over a build's frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from monoloc.builder.trajectories import (
    continuous_segments,
    forward_and_backward,
    hover,
    recording_segments,
    single_pass,
)
from monoloc.geometry import FloatArray

LONG, WARM_UP, MOST_SEGMENTS, MOST_SHORT = 30, 60, 20, 8


def poses_at(z_m: FloatArray) -> FloatArray:
    poses = np.tile(np.eye(4), (len(z_m), 1, 1))
    poses[:, 2, 3] = z_m
    return poses


@settings(max_examples=15)
@given(st.lists(st.integers(1, 60), min_size=1, max_size=40))
@example([1] * 6 + [30] * 15)
def test_long_segments_are_selected_before_short_ones(lengths: list[int]) -> None:
    """Segments are five metres apart."""
    poses = poses_at(np.repeat(5.0 * np.arange(len(lengths)), lengths))
    segments = recording_segments(0.1 * np.arange(len(poses)), poses)
    assert [int(segment[0]) for segment in segments] == sorted(int(segment[0]) for segment in segments)
    assert all(np.array_equal(np.diff(segment), np.ones(len(segment) - 1)) for segment in segments)
    long, selected = sum(length >= LONG for length in lengths), sum(len(segment) >= LONG for segment in segments)
    assert selected == long or (long > MOST_SEGMENTS and selected > MOST_SEGMENTS // 2)
    short = len(segments) - selected
    assert len(segments) <= MOST_SEGMENTS and short <= MOST_SHORT
    room = min(MOST_SHORT, MOST_SEGMENTS - selected)  # every second one, and so on: at least half of it is used
    assert short >= min(len(lengths) - long, (room + 1) // 2)


@pytest.mark.parametrize(("pause_s", "jump_m", "count"), [(0.1, 0.4, 1), (1.6, 0.0, 2), (0.1, 0.6, 2)])
def test_segments_end_at_pauses_and_jumps(pause_s: float, jump_m: float, count: int) -> None:
    times_s = np.array([0.0, 0.1, 0.2, 0.2 + pause_s, 0.3 + pause_s])
    poses = poses_at(np.array([0.0, 0.0, 0.0, jump_m, jump_m]))
    segments = continuous_segments(np.arange(5), times_s, poses)
    assert [segment.tolist() for segment in segments] == ([[0, 1, 2, 3, 4]] if count == 1 else [[0, 1, 2], [3, 4]])


@pytest.mark.parametrize("count", [1, 7, 40, 100])
def test_forward_and_backward_scores_each_frame_twice_after_a_warm_up(count: int) -> None:
    segment = np.arange(10, 10 + count)
    trajectory = forward_and_backward(segment)
    np.testing.assert_array_equal(trajectory.scored, [*segment, *segment[::-1]])
    assert trajectory.warm_up == WARM_UP
    assert np.abs(np.diff(trajectory.frames)).max() <= 1  # no jump


@pytest.mark.parametrize("count", [1, 2, 7, 59, 60, 100])
def test_short_segments_are_hovered_in_until_the_start_is_forgotten(count: int) -> None:
    segment = np.arange(10, 10 + count)
    trajectory = single_pass(segment)
    if count >= WARM_UP:
        assert trajectory.warm_up == 0
        np.testing.assert_array_equal(trajectory.frames, segment)
        return
    np.testing.assert_array_equal(trajectory.frames, hover(segment).frames)
    np.testing.assert_array_equal(trajectory.frames[: trajectory.warm_up], segment)
    assert len(trajectory.scored) >= WARM_UP
    assert set(trajectory.scored) == set(segment) and np.abs(np.diff(trajectory.frames)).max(initial=0) <= 1
