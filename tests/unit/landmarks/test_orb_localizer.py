"""The landmark localizer in a room, with and without a prior."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.camera import Camera
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, transform
from monoloc.landmarks import orb_localizer
from monoloc.landmarks.features import KeypointDetector, Keypoints, match_descriptors
from monoloc.landmarks.influential_corners import corners_of
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.landmarks.pnp import PRIOR_COVARIANCE as PRIOR
from monoloc.landmarks.pnp import LandmarkMeasurement, LandmarkPose, NoLandmarks
from monoloc.progress import NoProgress
from synthetic_room import BLACK, CAMERA, Room, RoomRecording, make_path

BUILD_POSES, FLIGHT_POSES = make_path(60)[::3], make_path(60, start_s=0.03)  # the same path, half a frame apart
VAGUE_PRIOR = np.eye(6)


@pytest.fixture(scope="module")
def localizer() -> OrbLandmarkLocalizer:
    recording = RoomRecording(Room(), BUILD_POSES)
    landmarks, _, _ = build_landmarks(recording, recording.depth, NoProgress())
    return OrbLandmarkLocalizer(landmarks, CAMERA)


def measure(
    localizer: OrbLandmarkLocalizer, color: NDArray[np.uint8], prior: FloatArray, covariance: FloatArray
) -> LandmarkMeasurement:
    return localizer.measure(localizer.detect(color), prior, covariance)


def relocalize(localizer: OrbLandmarkLocalizer, color: NDArray[np.uint8]) -> LandmarkPose | None:
    return localizer.relocalize(localizer.detect(color))


def test_camera_is_relocalized_by_one_image(localizer: OrbLandmarkLocalizer) -> None:
    """Without a prior, or with one that is too vague."""
    for pose in FLIGHT_POSES[5::20]:
        color, _ = Room().view(pose)
        for found in (relocalize(localizer, color), measure(localizer, color, BUILD_POSES[0], VAGUE_PRIOR).pose):
            assert found is not None and len(found.points) >= 20
            errors = pose_errors(found.pose[None], pose[None])
            assert errors.position_m[0] < 0.03 and errors.rotation_rad[0] < 0.015


def test_view_that_determines_the_pose_is_not_matched_around_others(
    localizer: OrbLandmarkLocalizer, monkeypatch: pytest.MonkeyPatch
) -> None:
    matched: list[int] = []

    def counted(*given: Any) -> Any:
        matched[-1] += 1
        return match_descriptors(*given)

    monkeypatch.setattr(orb_localizer, "match_descriptors", counted)
    for pose in FLIGHT_POSES[5::20]:
        matched.append(0)
        assert relocalize(localizer, Room().view(pose)[0]) is not None
    assert max(matched) <= 2  # of 5 that a flat view may take


@pytest.mark.parametrize("apart_m", [12.0, 0.4])
def test_two_places_that_look_alike_give_no_pose(localizer: OrbLandmarkLocalizer, apart_m: float) -> None:
    """A second room is equal to the first, whose map lacks three landmarks of ten; or a pattern repeats."""
    room = localizer._landmarks
    rng = np.random.default_rng(7)
    kept = rng.uniform(size=len(room)) < 0.7
    twin = Landmarks(room.points + np.array([apart_m, 0.0, 0.0], np.float32), room.descriptors)
    both = Landmarks(
        np.concatenate([room.points[kept], twin.points]), np.concatenate([room.descriptors[kept], twin.descriptors])
    )
    for pose in FLIGHT_POSES[5::20]:
        color, _ = Room().view(pose)
        mistaken = relocalize(OrbLandmarkLocalizer(twin, CAMERA), color)
        assert mistaken is not None and mistaken.pose[0, 3] - pose[0, 3] == pytest.approx(apart_m, abs=0.03)
        assert relocalize(OrbLandmarkLocalizer(both, CAMERA), color) is None


def test_landmarks_in_a_narrow_band_do_not_relocalize(localizer: OrbLandmarkLocalizer) -> None:
    """The same number of landmarks all over the image does."""
    pose = FLIGHT_POSES[30]
    color, _ = Room().view(pose)
    room, camera = localizer._landmarks, localizer.detector.camera
    local = transform(invert(pose), room.points)
    seen = np.flatnonzero(camera.in_sight(local))
    height = camera.project(local[seen])[:, 1]
    band = seen[np.abs(height - np.median(height)) < 0.12 * camera.height]
    anywhere = np.random.default_rng(8).choice(seen, len(band), replace=False)
    narrow, wide = (
        OrbLandmarkLocalizer(Landmarks(room.points[chosen], room.descriptors[chosen]), CAMERA)
        for chosen in (band, anywhere)
    )
    found = measure(narrow, color, pose, PRIOR)
    assert found.found >= 20 and found.pose is not None
    assert relocalize(narrow, color) is None and relocalize(wide, color) is not None


def test_few_corners_do_not_relocalize_where_thousands_of_landmarks_should_be_in_view(
    localizer: OrbLandmarkLocalizer,
) -> None:
    """Patterns that repeat agree with wrong poses by chance; where few landmarks are in view, few are enough."""
    pose, rng = FLIGHT_POSES[30], np.random.default_rng(9)
    color, _ = Room().view(pose)
    room = localizer._landmarks
    found = measure(localizer, color, pose, PRIOR)
    agreeing = found.visible[found.is_found]
    corners = corners_of(transform(invert(pose), room.points[agreeing].astype(np.float64)))
    few = rng.permutation(agreeing[np.isin(corners, np.unique(corners)[::4][:15])])[:50]
    strangers = np.float32(transform(pose, rng.uniform([-0.3, -0.2, 1.0], [0.3, 0.2, 1.5], (3000, 3))))
    noise = rng.integers(0, 256, (3000, room.descriptors.shape[1]), dtype=np.uint8)

    def is_found(known: NDArray[np.int64], others: int) -> bool:
        points = np.concatenate([room.points[known], strangers[:others]])
        descriptors = np.concatenate([room.descriptors[known], noise[:others]])
        return relocalize(OrbLandmarkLocalizer(Landmarks(points, descriptors), CAMERA), color) is not None

    assert is_found(few, 100) and not is_found(few, 3000)
    assert is_found(agreeing, 3000)


def test_landmarks_in_a_small_part_of_a_wide_image_relocalize(localizer: OrbLandmarkLocalizer) -> None:
    """They spread over as many degrees as in a narrower image that they fill."""
    pose, room = FLIGHT_POSES[30], localizer._landmarks
    local = transform(invert(pose), room.points)
    height = CAMERA.project(local)[:, 1]
    seen = CAMERA.in_sight(local) & (np.abs(height - CAMERA.cy) < 0.3 * CAMERA.height)
    known = Landmarks(room.points[seen], room.descriptors[seen])
    assert relocalize(OrbLandmarkLocalizer(known, CAMERA), Room().view(pose)[0]) is not None
    side = round(2.8 * CAMERA.focal_px)
    wide = Camera(side, side, CAMERA.focal_px, CAMERA.focal_px, (side - 1) / 2.0, (side - 1) / 2.0)
    found = relocalize(OrbLandmarkLocalizer(known, wide), Room().view(pose, wide)[0])
    assert found is not None
    assert pose_errors(found.pose[None], pose[None]).position_m[0] < 0.03


def test_vague_prior_tells_equal_places_apart_and_contradicts_a_pose_far_from_it(
    localizer: OrbLandmarkLocalizer,
) -> None:
    room = localizer._landmarks
    twin = room.points + np.array([12.0, 0.0, 0.0], np.float32)
    both = Landmarks(np.concatenate([room.points, twin]), np.tile(room.descriptors, (2, 1)))
    pose = FLIGHT_POSES[25]
    color, _ = Room().view(pose)
    covariance = np.diag([0.3, 0.3, 0.3, 0.1, 0.1, 0.1]) ** 2
    near_it, far = pose @ se3_exp([0.2, 0.1, -0.2, 0.05, 0.1, 0.0]), pose @ se3_exp([1.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = measure(OrbLandmarkLocalizer(both, CAMERA), color, near_it, covariance)
    assert found.pose is not None and found.found == len(found.pose.points) >= 20
    assert pose_errors(found.pose.pose[None], pose[None]).position_m[0] < 0.03
    # Which landmarks are missing tells where the map has changed, also from near a surface, where priors are vague.
    assert len(found.visible) == found.expected > found.found
    np.testing.assert_array_equal(both.points[found.visible[found.is_found]], found.pose.points)
    contradicted = measure(OrbLandmarkLocalizer(both, CAMERA), color, far, covariance)
    assert contradicted.expected > 60 and contradicted.found == 0 and contradicted.pose is None


def test_vague_prior_that_holds_two_places_that_look_alike_measures_nothing(localizer: OrbLandmarkLocalizer) -> None:
    """Nor does it speak against the belief that few landmarks are found."""
    room = localizer._landmarks
    twin = room.points + np.array([0.8, 0.0, 0.0], np.float32)
    kept = np.random.default_rng(7).uniform(size=len(room)) < 0.8
    both = Landmarks(
        np.concatenate([room.points[kept], twin]), np.concatenate([room.descriptors[kept], room.descriptors])
    )
    alone = Landmarks(room.points[kept], room.descriptors[kept])
    pose = FLIGHT_POSES[25]
    color, _ = Room().view(pose)
    for prior in (pose, pose @ se3_exp([0.4, 0.0, 0.0, 0.0, 0.0, 0.0])):
        vague = np.diag([0.4, 0.4, 0.4, 0.1, 0.1, 0.1]) ** 2
        assert measure(OrbLandmarkLocalizer(alone, CAMERA), color, prior, vague).pose is not None
        measured = measure(OrbLandmarkLocalizer(both, CAMERA), color, prior, vague)
        assert measured.pose is None and measured.expected == measured.found == 0


def test_no_pose_in_the_dark_or_in_another_room(localizer: OrbLandmarkLocalizer) -> None:
    """Walls with other paint have the same shape and other landmarks."""
    other = Room(seed=1)
    for pose in FLIGHT_POSES[::20]:
        for color in (BLACK, other.view(pose)[0]):
            assert relocalize(localizer, color) is None
            measured = measure(localizer, color, pose, PRIOR)
            assert measured.pose is None and measured.found < 8 and measured.expected > 100


def test_landmarks_in_view_are_expected_and_found_where_the_camera_is(localizer: OrbLandmarkLocalizer) -> None:
    """At a prior 1.5 m beside the camera, as many are in view, but few agree on a pose near it."""
    pose = FLIGHT_POSES[30]
    color, _ = Room().view(pose)
    right = measure(localizer, color, pose, PRIOR)
    detected = localizer.detector.camera
    in_view = detected.in_sight(transform(invert(pose), localizer._landmarks.points))
    assert right.pose is not None and right.found == len(right.pose.points) > 60
    assert right.expected == np.count_nonzero(in_view) > right.found
    np.testing.assert_array_equal(right.visible, np.flatnonzero(in_view))
    np.testing.assert_array_equal(localizer._landmarks.points[right.visible[right.is_found]], right.pose.points)
    wrong = measure(localizer, color, pose @ se3_exp([1.0, 0.0, -0.5, 0.0, 0.3, 0.0]), PRIOR)
    assert wrong.expected > 60 and wrong.found < 0.2 * right.found and wrong.pose is None
    away = make_pose(np.eye(3), np.array([0.0, -50.0, 0.0]))
    assert measure(localizer, color, away, PRIOR).expected == 0


@pytest.mark.parametrize("window", [(160, 0, 160, 256), (0, 0, 320, 150), (0, 106, 320, 150)])
def test_landmarks_beyond_the_border_of_a_cropped_image_are_not_expected(
    localizer: OrbLandmarkLocalizer, window: tuple[int, int, int, int]
) -> None:
    """The principal point of a cropped image is not in its middle."""
    left, top, width, height = window
    pose = FLIGHT_POSES[30]
    color = np.ascontiguousarray(Room().view(pose)[0][top : top + height, left : left + width])
    cropped = OrbLandmarkLocalizer(localizer._landmarks, CAMERA.cropped(left, top, width, height))
    detected = cropped.detector.camera
    measured = cropped.measure_near(cropped.detect(color), pose, PRIOR)
    pixels = detected.project(transform(invert(pose), localizer._landmarks.points[measured.visible]))
    assert measured.expected == len(pixels) > 60
    assert np.all((pixels > -1.5) & (pixels < [detected.width + 0.5, detected.height + 0.5]))


def test_landmarks_a_little_beyond_the_border_are_found_where_the_prior_is_wrong(
    localizer: OrbLandmarkLocalizer,
) -> None:
    left, top, width, height = 0, 0, 320, 150
    pose = FLIGHT_POSES[30]
    color = np.ascontiguousarray(Room().view(pose)[0][top : top + height, left : left + width])
    cropped = OrbLandmarkLocalizer(localizer._landmarks, CAMERA.cropped(left, top, width, height))
    prior = pose @ se3_exp([0.0, 0.0, 0.0, 0.06, 0.0, 0.0])  # looks up
    measured = measure(cropped, color, prior, PRIOR)
    found = measured.visible[measured.is_found]
    pixels = cropped.detector.camera.project(transform(invert(prior), localizer._landmarks.points[found]))
    assert measured.pose is not None and measured.expected > measured.found
    assert not cropped.detector.camera.contains(pixels).all()


@pytest.mark.parametrize("level", [30, 255])
def test_covered_half_of_an_image_says_nothing_of_landmarks_there(
    localizer: OrbLandmarkLocalizer, level: int
) -> None:
    pose = FLIGHT_POSES[30]
    color = Room().view(pose)[0].copy()
    whole = measure(localizer, color, pose, PRIOR)
    local = transform(invert(pose), localizer._landmarks.points[whole.visible])
    pixels = localizer.detector.camera.project(local)
    is_inside = localizer.detector.reaches(pixels)
    np.testing.assert_array_equal(whole.is_shown, is_inside)  # the border shows no keypoint
    color[:, : color.shape[1] // 2] = level
    covered = measure(localizer, color, pose, PRIOR)
    columns = pixels[:, 0] / localizer.detector.camera.width
    assert not covered.is_shown[columns < 0.4].any() and covered.is_shown[is_inside & (columns > 0.5)].all()
    assert covered.expected == whole.expected and covered.pose is not None
    given = LandmarkMeasurement(2, 1, None, np.array([3, 5]), np.array([True, False]))
    assert given.is_shown.tolist() == [True, True]  # of a localizer that does not tell


def test_landmarks_are_expected_from_three_times_as_far_as_the_build_found_them_wherever_the_camera_was(
    localizer: OrbLandmarkLocalizer,
) -> None:
    room, away = localizer._landmarks, np.array([0.0, 0.0, 30.0], np.float32)
    points = np.concatenate([room.points, room.points + away])
    nearest = np.linalg.norm(points - BUILD_POSES[0, :3, 3], axis=1).argmin()
    views = LandmarkViews(BUILD_POSES[:1], (np.arange(len(points)) == nearest)[None])
    sight_m = 3.0 * views.farthest_m(points)
    floor = OrbLandmarkLocalizer(Landmarks(points, np.tile(room.descriptors, (2, 1)), views), CAMERA)
    nothing = Keypoints(np.zeros((0, 2)), np.zeros((0, 32), np.uint8), np.zeros(0))
    for offset_m in (0.0, 1.0, 1.5, 30.0, 24.0, 0.0):
        pose = FLIGHT_POSES[30].copy()
        pose[2, 3] += offset_m
        local = transform(invert(pose), points.astype(np.float64))
        seen = floor.detector.camera.in_sight(local) & (np.linalg.norm(local, axis=1) < sight_m)
        measured = floor.measure_near(nothing, pose, PRIOR)
        assert measured.expected == np.count_nonzero(seen) and measured.found == 0
    everywhere = OrbLandmarkLocalizer(Landmarks(points, np.tile(room.descriptors, (2, 1))), CAMERA)
    measured = everywhere.measure_near(nothing, FLIGHT_POSES[30], PRIOR)
    local = transform(invert(FLIGHT_POSES[30]), points.astype(np.float64))
    assert measured.expected == np.count_nonzero(everywhere.detector.camera.in_sight(local))


def test_room_without_landmarks_expects_none() -> None:
    nothing = NoLandmarks().detect(BLACK)
    assert NoLandmarks().measure(nothing, np.eye(4), PRIOR) == LandmarkMeasurement(0, 0, None)
    assert NoLandmarks().relocalize(nothing) is None


def test_dim_images_show_most_landmarks(localizer: OrbLandmarkLocalizer) -> None:
    pose = FLIGHT_POSES[30]
    color, _ = Room().view(pose)
    bright, dim = (measure(localizer, (color / factor).astype(np.uint8), pose, PRIOR) for factor in (1, 8))
    assert bright.pose is not None and dim.pose is not None
    assert dim.expected == bright.expected and dim.found > 0.5 * bright.found


def test_camera_of_another_focal_length_is_localized(localizer: OrbLandmarkLocalizer) -> None:
    """Keypoints are detected at one focal length in pixels, so that their scales are comparable."""
    camera, pose = Camera(640, 480, 700.0, 700.0, 319.5, 239.5), FLIGHT_POSES[20]
    color, _ = Room().view(pose, camera)
    other = OrbLandmarkLocalizer(localizer._landmarks, camera)
    found = measure(other, color, pose @ se3_exp(np.full(6, 0.02)), PRIOR).pose
    assert found is not None
    assert pose_errors(found.pose[None], pose[None]).position_m[0] < 0.03  # 0.5 to 2.1 cm at fifteen poses


def test_search_radius_is_that_of_visible_landmarks() -> None:
    """Near a wall it is as large as the prior asks for, whatever the rest of the room."""
    rng = np.random.default_rng(4)
    camera = KeypointDetector(CAMERA).camera
    close = 0.5 * camera.rays(rng.uniform((0.0, 0.0), (camera.width, camera.height), (120, 2)))
    out_of_view = np.array([6.0, 0.0, 6.0]) * rng.uniform(1.0, 1.5, (400, 1))
    landmarks = Landmarks(
        np.concatenate([close, out_of_view]).astype(np.float32), rng.integers(0, 256, (520, 32)).astype(np.uint8)
    )
    seen = Keypoints(camera.project(close), landmarks.descriptors[:120], np.ones(120))
    prior = se3_exp([0.03, -0.03, 0.0, 0.0, 0.0, 0.0])  # 16 pixels for what is close, one or two for the rest
    covariance = np.diag([0.02, 0.02, 0.02, 0.003, 0.003, 0.003]) ** 2
    found = OrbLandmarkLocalizer(landmarks, CAMERA).measure_near(seen, prior, covariance).pose
    assert found is not None and len(found.points) > 100
    np.testing.assert_allclose(found.pose, np.eye(4), atol=1e-3)
