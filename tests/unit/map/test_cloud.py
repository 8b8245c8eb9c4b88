"""Clouds: from the frames of a recording, thinned and cleaned."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.geometry import invert, se3_exp, transform
from monoloc.map.cloud import (
    VoxelThinner,
    cloud_from_recording,
    remove_outliers,
    voxel_thin,
)
from synthetic_room import Room


class BoxRecording:
    """A camera inside a box |x| <= 1, |y| <= 1, |z| <= 1.5 (world, m), with exact depth."""

    name = "box"
    has_depth = True

    def __init__(self, poses: NDArray[np.float64] | None) -> None:
        self.camera = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)
        self.poses = poses
        self.frame_names = [f"{i}" for i in range(len(self))]
        self.timestamps_s = np.arange(len(self), dtype=np.float64)

    def __len__(self) -> int:
        return 1 if self.poses is None else len(self.poses)

    def color(self, index: int) -> NDArray[np.uint8]:
        raise AssertionError("a cloud is made of depth and needs no colour")

    def depth(self, index: int) -> NDArray[np.float32]:
        assert self.poses is not None
        T_world_camera = self.poses[index]
        directions = self.camera.pixel_rays() @ T_world_camera[:3, :3].T
        half = np.array([1.0, 1.0, 1.5])
        with np.errstate(divide="ignore"):
            reach = (np.sign(directions) * half - T_world_camera[:3, 3]) / directions
        return np.asarray(reach.min(axis=-1), dtype=np.float32)


POSES = se3_exp(np.random.default_rng(0).normal(size=(5, 6)) * np.array([0.2, 0.2, 0.2, 0.5, 0.5, 0.5]))


def test_cloud_lies_on_the_walls() -> None:
    done: list[tuple[int, int]] = []
    cloud = cloud_from_recording(BoxRecording(POSES), voxel_m=0.05, progress=lambda i, n: done.append((i, n)))
    distance = np.abs(np.abs(cloud) / np.array([1.0, 1.0, 1.5]) - 1.0).min(axis=1)
    assert len(cloud) > 500
    # Voxels at an edge average two walls; all others are exact.
    assert np.mean(distance < 1e-4) > 0.9
    assert distance.max() < 0.05
    assert done == [(i, 5) for i in range(1, 6)]


def test_depth_beyond_the_limit_is_left_out() -> None:
    recording = BoxRecording(POSES)
    cloud = cloud_from_recording(recording, max_depth_m=1.2)
    nearest = np.min([transform(invert(T), cloud)[:, 2] for T in POSES], axis=0)
    assert len(cloud) > 0
    assert nearest.max() < 1.2 + 0.03


def test_cloud_needs_poses_and_depth() -> None:
    with pytest.raises(DataError, match="box: has no poses; give a recording with poses"):
        cloud_from_recording(BoxRecording(None))
    without_depth = BoxRecording(POSES)
    without_depth.has_depth = False
    with pytest.raises(DataError, match=r"box: has no depth; give .* with depth, or a cloud \(--cloud\)"):
        cloud_from_recording(without_depth)
    with pytest.raises(DataError, match=r"box: has no depth between 0 and 0\.01 m"):
        cloud_from_recording(BoxRecording(POSES), max_depth_m=0.01)
    with pytest.raises(SettingError, match="max_depth_m: is 0"):
        cloud_from_recording(BoxRecording(POSES), max_depth_m=0.0)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 200), st.sampled_from([0.03, 0.2, 1.0]))
def test_thinning_leaves_one_centroid_a_voxel(seed: int, count: int, voxel_m: float) -> None:
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 3))
    thinned = voxel_thin(points, voxel_m)
    cells, inverse = np.unique(np.floor(points / voxel_m), axis=0, return_inverse=True)
    assert len(thinned) == len(cells)
    expected = np.stack([points[inverse.ravel() == i].mean(axis=0) for i in range(len(cells))])
    np.testing.assert_allclose(np.sort(thinned, axis=0), np.sort(expected, axis=0), atol=1e-12)


def test_thinning_in_parts_equals_thinning_all_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("monoloc.map.cloud._MERGE_AT", 100)  # merges several times
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (3000, 3))
    thinner = VoxelThinner(0.3)
    for part in np.array_split(points, 20):
        thinner.add(part)
    np.testing.assert_allclose(thinner.points(), voxel_thin(points, 0.3), atol=1e-12)


def test_thinning_weighs_points() -> None:
    thinner = VoxelThinner(1.0)
    thinner.add([[0.1, 0.5, 0.5], [0.5, 0.5, 0.5]], [3.0, 1.0])
    np.testing.assert_allclose(thinner.points(), [[0.2, 0.5, 0.5]])


def test_thinning_of_no_points_and_of_invalid_input() -> None:
    assert voxel_thin(np.empty((0, 3)), 0.1).shape == (0, 3)
    assert VoxelThinner(0.1).points().shape == (0, 3)
    with pytest.raises(SettingError, match="voxel_m: is 0"):
        voxel_thin(np.zeros((1, 3)), 0.0)
    with pytest.raises(ValueError, match="points must be finite"):
        voxel_thin([[np.nan, 0.0, 0.0]], 0.01)


def test_outliers_are_removed_and_surfaces_remain() -> None:
    u, v = np.meshgrid(np.arange(0.0, 1.0, 0.03), np.arange(0.0, 1.0, 0.03))
    plane = np.stack([u.ravel(), v.ravel(), np.zeros(u.size)], axis=1)
    strays = np.array([[0.5, 0.5, 1.0], [-2.0, 0.0, 0.0], [0.5, 0.5, -3.0]])
    cleaned = remove_outliers(np.concatenate([plane, strays]))
    np.testing.assert_array_equal(cleaned, plane)
    assert remove_outliers(np.empty((0, 3))).shape == (0, 3)
    with pytest.raises(SettingError, match="voxel_m: is -1"):
        remove_outliers(plane, voxel_m=-1.0)


@pytest.mark.parametrize("voxel_m", [0.03, 0.1, 0.2])
def test_outlier_removal_works_at_every_voxel_size(voxel_m: float) -> None:
    """At voxels of 10 cm next to nothing would remain, were neighbours counted in cells of 5 cm."""
    room = voxel_thin(Room().cloud(voxel_m / 3.0), voxel_m)
    strays = np.array([[0.0, 0.0, 50.0], [0.0, 40.0, 0.0], [30.0, 0.1, 0.1]])
    cleaned = remove_outliers(np.concatenate([room, strays]), voxel_m)
    assert len(cleaned) > 0.99 * len(room) and np.abs(cleaned).max() < 10.0


def test_cloud_far_from_the_origin_is_refused() -> None:
    """As with the easting and northing of a survey: its voxels cannot be numbered."""
    cloud = np.random.default_rng(0).uniform(0.0, 3.0, (100, 3)) + np.array([450_000.0, 5_400_000.0, 120.0])
    line = r"^cloud: lies 5400\.0 km from the origin, too far for voxels of 0\.03 m; subtract an offset from cloud"
    with pytest.raises(DataError, match=line):
        voxel_thin(cloud, 0.03)
