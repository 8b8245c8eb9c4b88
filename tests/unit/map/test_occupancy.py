"""Voxels of a room of known walls: where a surface is, what cameras saw through, what nobody saw."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.errors import SettingError
from monoloc.map.mixture import GaussianMixture
from monoloc.map.occupancy import FREE, OCCUPIED, UNKNOWN, VoxelGrid, fitting_voxel_m, surface_voxels
from refusals import refuses_setting
from synthetic_room import SMALL_CAMERA, Room, make_path, room_mixture

ROOM = Room()
POSES = make_path(40, rate_hz=4.0)


@pytest.fixture(scope="module")
def grid() -> VoxelGrid:
    return surface_voxels(room_mixture(ROOM, 120), 0.1, POSES[:, :3, 3]).with_free_space(POSES, SMALL_CAMERA)


def test_occupied_voxels_are_at_surfaces_and_cover_what_cameras_see(grid: VoxelGrid) -> None:
    assert np.percentile(ROOM.distance_m(grid.centres(OCCUPIED)), 90.0) < 0.12
    seen = np.concatenate(
        [
            (SMALL_CAMERA.back_project(ROOM.view(pose, SMALL_CAMERA)[1])[::8, ::8] @ pose[:3, :3].T + pose[:3, 3])
            for pose in POSES[::8]
        ]
    ).reshape(-1, 3)
    around = np.stack([grid.at(seen + shift) for shift in 0.1 * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])])
    assert np.mean((around == OCCUPIED).any(axis=0)) > 0.97


def test_free_space_is_free_and_what_is_behind_walls_is_unknown(grid: VoxelGrid) -> None:
    assert grid.volume_m3(FREE) > 10.0
    assert ROOM.distance_m(grid.centres(FREE)).min() > 0.0  # neither in a box nor behind a wall
    inside = np.array([[0.0, 0.0, -0.5], [9.0, 0.0, 0.0], [-1.3, 0.9, 2.0]])  # free, outside, within a box
    assert grid.at(inside).tolist() == [FREE, UNKNOWN, UNKNOWN]


def test_distances_are_those_to_the_walls(grid: VoxelGrid) -> None:
    distances_m = grid.distances_m(
        np.array([0.0, -0.2, 0.0]), np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), 4.0
    )
    np.testing.assert_allclose(distances_m, [2.5, 2.0, 1.4], atol=0.15)
    assert grid.distances_m(np.array([0.0, -0.2, 0.0]), np.array([[1.0, 0.0, 0.0]]), 1.0)[0] == np.inf


def test_what_is_before_no_surface_stays_unknown() -> None:
    plate = GaussianMixture(np.ones(1), np.array([[0.0, 0.0, 2.0]]), np.diag([0.01, 0.01, 1e-4])[None])
    grid = surface_voxels(plate, 0.1, np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 0.0]]))
    seen = grid.with_free_space(np.eye(4)[None], SMALL_CAMERA)
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.4, 0.0, 1.0]])
    assert seen.at(points).tolist() == [FREE, OCCUPIED, UNKNOWN]


def test_the_size_that_a_refusal_names_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("monoloc.map.occupancy._MOST_VOXELS", 1 << 15)  # of a small memory
    mixture = room_mixture(ROOM, 120)
    with pytest.raises(SettingError) as raised:
        surface_voxels(mixture, 1e-3)
    surface_voxels(mixture, float(raised.value.fix.split()[1]))


def test_no_size_is_named_for_a_map_that_is_too_large_for_any() -> None:
    covariances = np.tile(1e-4 * np.eye(3), (2, 1, 1))
    far = GaussianMixture(np.full(2, 0.5), np.array([[0.0, 0.0, 0.0], [1e20, 1e20, 1e20]]), covariances)
    refuses_setting(
        lambda: surface_voxels(far, 0.1), "voxel_m", "for a map of 1e\\+20 x", "no size fits: .* in metres"
    )
    largest_m = fitting_voxel_m(far, 0.1)
    refuses_setting(lambda: surface_voxels(far, largest_m), "voxel_m", "is 2 for a map", "no size fits")


@pytest.mark.parametrize(
    ("voxel_m", "problem", "fix"),
    [
        (0.0, "is 0.0", "give a size in metres, up to 2"),
        (float("nan"), "is nan", "give a size in metres"),
        (2.1, "is 2.1", "up to 2"),
        (1e-3, r"is 0.001 for a map of", "or more"),
    ],
)
def test_voxels_that_no_memory_holds_are_refused(voxel_m: float, problem: str, fix: str) -> None:
    refuses_setting(lambda: surface_voxels(room_mixture(ROOM, 120), voxel_m), "voxel_m", problem, fix)
