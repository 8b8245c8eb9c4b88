"""Frames that are held out: regions apart from all other frames."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc.evaluation.hold_out import hold_out_regions
from monoloc.geometry import pose_distance_m, se3_exp


@settings(max_examples=30, deadline=None)
@given(frames=st.integers(5, 60), regions=st.integers(1, 3), share=st.floats(0.02, 0.3), seed=st.integers(0, 99))
def test_regions_are_as_isolated_as_any_could_be(frames: int, regions: int, share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = se3_exp(rng.normal(scale=0.5, size=(frames, 6)))
    found = hold_out_regions(poses, regions, share)
    held_out = np.concatenate(found)
    assert len({*held_out}) == len(held_out) and {*held_out} < {*range(1, frames)}
    training = np.setdiff1d(np.arange(frames), held_out)
    assert 1 <= len(found) <= regions and len(training) >= 2
    for region in found:
        assert len(region) == max(1, round(frames * share / regions)) and (np.diff(region) > 0).all()
    # No other centre, with its nearest frames, is farther from all remaining frames.
    size, rest = len(found[0]), np.setdiff1d(np.arange(frames), found[0])
    margins = []
    for centre in range(1, frames):
        apart = pose_distance_m(poses[centre], poses)
        margins.append(min(apart[0], np.sort(apart[1:])[size]))
    assert max(pose_distance_m(poses[i], poses[rest]).min() for i in found[0]) >= max(margins)


def test_region_is_where_the_camera_was_once() -> None:
    """A line travelled in both directions, and a few frames aside: neighbours in time are not isolated."""
    poses = np.repeat(np.eye(4)[None], 40, axis=0)
    poses[:, 0, 3] = np.abs(np.linspace(-2.0, 2.0, 40))
    poses[30:34, 1, 3] = 3.0
    (region,) = hold_out_regions(poses, 1, 0.1)
    assert region.tolist() == [30, 31, 32, 33]


def test_regions_of_a_straight_trajectory_are_apart() -> None:
    """The end is most isolated; the second region lies neither next to the first, nor at the start."""
    poses = np.repeat(np.eye(4)[None], 100, axis=0)
    poses[:, 0, 3] = np.linspace(0.0, 3.0, 100)
    end, other = hold_out_regions(poses, 2, 0.16)
    assert end.tolist() == [*range(92, 100)]
    assert len(other) == 8 and other[0] > 0 and other[-1] < 91
    (same,) = hold_out_regions(np.repeat(np.eye(4)[None], 9, axis=0), 1, 0.2)
    assert same.tolist() == [1, 2]
