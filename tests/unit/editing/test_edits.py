"""Remove, add and move: the maps, landmarks, views, biases and the list of edits after each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edit_helpers import BACK_M, CUBE, DOWN, cube_cloud, mapped_room, room_cloud, shifted
from monoloc.bundle import Bundle
from monoloc.editing.box import Box
from monoloc.editing.edits import add, move, remove
from monoloc.editing.undo import undone
from monoloc.geometry import FloatArray, make_pose, so3_exp, transform
from refusals import refuses_setting

SHIFT = make_pose(np.eye(3), np.array([0.9, 0.0, -0.4]))


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def points_at(bundle: Bundle, box: Box) -> float:
    """Of the cloud that the map stands for, those in a box."""
    assert bundle.cloud is not None
    return float(box.contains(bundle.original.sample(60_000, rng())).mean() * bundle.cloud.points)


def mean_nats(bundle: Bundle, points: FloatArray) -> float:
    return float(bundle.original.log_density(points).mean())


def far_from(bundle: Bundle) -> FloatArray:
    """Points of the map that are a metre and more from the cube."""
    points = bundle.original.sample(5000, rng())
    return points[np.linalg.norm(points - CUBE.centre, axis=1) > 1.5]


def test_removed_object_is_gone_and_the_rest_is_as_before() -> None:
    room = mapped_room()
    edited = remove(room, CUBE, {}, rng())
    assert points_at(edited, CUBE) < 0.15 * points_at(room, CUBE)
    assert len(edited.original) == len(edited.adapted) <= len(room.original)
    far = far_from(room)
    lost = room.cloud.points / edited.cloud.points  # the share of the rest grows
    assert mean_nats(edited, far) == pytest.approx(mean_nats(room, far) + np.log(lost), abs=0.02)
    assert not CUBE.contains(edited.landmarks.points.astype(np.float64)).any()
    assert len(edited.landmarks) > 140 and edited.landmarks.views.found.shape == (12, len(edited.landmarks))


def test_removed_and_added_again_the_object_is_mapped_as_well_as_by_the_build() -> None:
    room = mapped_room()
    mended = add(remove(room, CUBE, {}, rng()), cube_cloud(), {}, rng())
    assert abs(len(mended.original) - len(room.original)) < 0.1 * len(room.original)
    assert mended.cloud.points == pytest.approx(room.cloud.points, rel=0.05)
    assert mean_nats(mended, cube_cloud()) > mean_nats(room, cube_cloud()) - 0.3


@pytest.mark.parametrize("shift_m", [15.0, 700.0, 1e20])
def test_nothing_is_put_far_from_the_map(shift_m: float) -> None:
    away = make_pose(np.eye(3), np.array([shift_m, 0.0, 0.0]))
    room, cloud = mapped_room(), transform(away, cube_cloud())
    refuses_setting(lambda: add(room, cloud, {}, rng()), "cloud", "m beyond the map", "are these millimetres")
    refuses_setting(lambda: move(room, CUBE, away, {}, rng()), "by", "m beyond the map", "are these millimetres")
    refuses_setting(lambda: add(room, 1000.0 * cube_cloud(), {}, rng()), "cloud", "beyond the map", "give metres")


def test_the_next_part_of_a_room_is_near_enough() -> None:
    room = mapped_room()
    assert len(add(room, shifted(cube_cloud(), 9.0, 0.0, 0.0), {}, rng()).original) > len(room.original)
    larger = Box.between(np.full(3, -30.0), np.full(3, 30.0), DOWN)  # than the room
    assert len(move(room, larger, SHIFT, {}, rng()).original) == len(room.original)


def test_new_components_are_adapted_by_the_learnt_transform() -> None:
    room = mapped_room()
    edited = add(room, shifted(cube_cloud(), 0.9, 0.0, 0.0), {}, rng())
    new = slice(len(room.original), None)
    assert len(edited.original.means[new]) > 2
    expected = room.transform(edited.original.means[new])
    assert np.linalg.norm(expected - edited.original.means[new], axis=1).min() > 0.005
    np.testing.assert_allclose(edited.adapted.means[new], expected, atol=5e-3)
    plain = add(replace(room, transform=None, adapted=room.original), cube_cloud(), {}, rng())
    assert plain.adapted.means[new] == pytest.approx(plain.original.means[new])


def test_added_cloud_is_thinned_like_the_builds() -> None:
    twice = np.concatenate([cube_cloud(), cube_cloud() + 1e-4])
    once, dense = (add(mapped_room(), cloud, {}, rng()) for cloud in (cube_cloud(), twice))
    assert dense.cloud == once.cloud and len(dense.original) == len(once.original)


def test_landmarks_behind_an_added_object_are_not_found_from_where_it_hides_them() -> None:
    room = mapped_room()
    screen = shifted(cube_cloud() * [1.0, 1.0, 0.2], 0.0, -0.9, 0.6)  # before the wall, above the cube
    edited = add(room, screen, {}, rng())
    found, before = edited.landmarks.views.found, room.landmarks.views.found
    behind = (np.abs(room.landmarks.points[:, 0]) < 0.1) & (np.abs(room.landmarks.points[:, 1] + 0.2) < 0.2)
    behind &= room.landmarks.points[:, 2] > BACK_M - 0.1
    assert behind.sum() > 2 and not found[5:7][:, behind].any()
    assert found.sum() > 0.5 * before.sum()
    np.testing.assert_array_equal(edited.landmarks.points, room.landmarks.points)


def test_moved_object_takes_its_landmarks_along() -> None:
    room = mapped_room()
    edited = move(room, CUBE, SHIFT, {}, rng())
    there = Box(CUBE.centre + SHIFT[:3, 3], CUBE.half, CUBE.R_world_box)
    assert points_at(edited, CUBE) < 0.15 * points_at(room, CUBE)
    assert points_at(edited, there) == pytest.approx(points_at(room, CUBE) + points_at(room, there), rel=0.2)
    points = room.landmarks.points.astype(np.float64)
    inside = CUBE.contains(points)
    np.testing.assert_allclose(edited.landmarks.points[inside], transform(SHIFT, points[inside]), atol=1e-6)
    np.testing.assert_array_equal(edited.landmarks.points[~inside], room.landmarks.points[~inside])
    assert not edited.landmarks.views.found[:, inside].any() and edited.landmarks.views.found[:, ~inside].any()


def test_known_bias_shrinks_by_the_share_of_the_view_that_has_changed() -> None:
    room = mapped_room()
    edited = remove(room, CUBE, {}, rng())
    left = edited.reference_poses.forward_bias[:, 0] / room.reference_poses.forward_bias[:, 0]
    share = edited.edits[-1].record.changes["largest_share_of_a_view"]
    assert 0.05 < share < 0.5 and left.min() == pytest.approx(1.0 - share, abs=2e-3) and left.max() < 1.0
    away = Box.between(np.array([-2.1, 0.5, -2.1]), np.array([-1.0, 1.1, -1.0]), DOWN)  # behind all cameras
    elsewhere = remove(room, away, {}, rng())
    np.testing.assert_array_equal(elsewhere.reference_poses.forward_bias, room.reference_poses.forward_bias)


def test_edit_is_listed_with_what_it_changed() -> None:
    room = mapped_room()
    edited = add(remove(room, CUBE, {"yaw_deg": 0.0}, rng()), cube_cloud(), {"cloud": "cube.ply"}, rng())
    first, second = (edit.record for edit in edited.edits)
    assert (first.kind, second.kind) == ("remove", "add")
    assert first.parameters == {"yaw_deg": 0.0} and second.parameters == {"cloud": "cube.ply"}
    assert first.changes["components"][0] == 150 and second.changes["components"][1] == len(edited.original)
    assert first.changes["landmarks"] == [200, len(edited.landmarks)]
    assert edited.thresholds == room.thresholds and edited.settings == room.settings


@pytest.mark.parametrize("is_moved", [False, True])
def test_box_without_anything_in_it_is_refused(is_moved: bool) -> None:
    nowhere, room = Box.between(np.full(3, 8.0), np.full(3, 9.0), DOWN), mapped_room()

    def edit() -> Bundle:
        return move(room, nowhere, SHIFT, {}, rng()) if is_moved else remove(room, nowhere, {}, rng())

    refuses_setting(edit, "box", "holds nothing of the map", "the map lies between")


def test_box_that_holds_landmarks_alone_is_emptied() -> None:
    """As after an update that removed the surfaces there."""
    nowhere, room = Box.between(np.full(3, 8.0), np.full(3, 9.0), DOWN), mapped_room()
    points = room.landmarks.points.copy()
    points[:7] = 8.5
    edited = remove(replace(room, landmarks=replace(room.landmarks, points=points)), nowhere, {}, rng())
    assert len(edited.landmarks) == len(points) - 7 and edited.original is room.original


def test_box_around_most_of_the_room_is_warned_of() -> None:
    """It may have been a wrong one, such as one in another unit."""
    room = mapped_room()
    upper = np.array([np.quantile(room.landmarks.points[:, 0], 0.8), 50.0, 50.0])
    most = Box.between(np.full(3, -50.0), upper, DOWN)
    (warning,) = remove(room, most, {}, rng()).edits[-1].record.changes["warnings"]
    assert "of the landmarks" in warning and warning.endswith("lay in the box; if it was a wrong one, undo")
    assert "warnings" not in remove(room, CUBE, {}, rng()).edits[-1].record.changes


FLOOR = Box.between(np.array([-9.0, 0.35, -9.0]), np.full(3, 9.0), DOWN)


def test_edit_does_not_turn_the_direction_of_gravity() -> None:
    """Else each edit would turn the frame ``map`` of flights, of exports and of ROS a little."""
    room = mapped_room()
    assert room.down is not None
    for edited in (remove(room, FLOOR, {}, rng()), move(room, CUBE, SHIFT, {}, rng())):
        assert edited.down == pytest.approx(room.down, abs=1e-15) and undone(edited).provenance == room.provenance
        assert not [each for each in edited.edits[-1].record.changes.get("warnings", []) if "gravity" in each]


def test_edit_after_which_floor_and_walls_show_another_gravity_is_warned_of() -> None:
    """The one that the map keeps may have been wrong."""
    room = mapped_room()
    tilted = room.provenance.model_copy(update={"kept_down": tuple(so3_exp(np.array([0.1, 0.0, 0.0])) @ room.down)})
    (warning,) = remove(replace(room, provenance=tilted), CUBE, {}, rng()).edits[-1].record.changes["warnings"]
    assert warning.startswith("floor and walls now show gravity 6 degrees from where the map keeps it; ")


def test_edit_that_gives_the_direction_of_gravity_is_warned_of() -> None:
    """A flight would level its poses, and the frame that it publishes, differently than before."""
    walls = replace(remove(mapped_room(), FLOOR, {}, rng()), provenance=mapped_room().provenance)
    assert walls.down is None
    given = add(walls, room_cloud()[room_cloud()[:, 1] > 0.97], {}, rng())
    assert given.down is not None
    (warning,) = given.edits[-1].record.changes["warnings"]
    assert warning.startswith("the map now shows the direction of gravity, [")


def test_box_around_everything_is_refused() -> None:
    everything = Box.between(np.full(3, -50.0), np.full(3, 50.0), DOWN)
    refuses_setting(lambda: remove(mapped_room(), everything, {}, rng()), "box", "the whole map", "smaller")


def test_cloud_of_a_few_points_is_refused() -> None:
    """As one in millimetres is after thinning, or one that is smaller than a voxel."""
    speck = np.random.default_rng(0).uniform(0.0, 0.001, (500, 3))
    refuses_setting(lambda: add(mapped_room(), speck, {}, rng()), "cloud", "gives 1 points 3 cm apart", "at least 10")
