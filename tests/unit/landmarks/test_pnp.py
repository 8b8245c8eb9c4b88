"""Poses from landmarks: the solver on points, and the localizer in a room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.camera import Camera
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, se3_log, transform
from monoloc.landmarks.features import KeypointDetector, Keypoints
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.landmarks.pnp import PRIOR_COVARIANCE as PRIOR
from monoloc.landmarks.pnp import LandmarkMeasurement, NoLandmarks, OrbLandmarkLocalizer, pose_from_matches
from monoloc.progress import NoProgress
from monoloc.supervision.camera_check import WELL_OBSERVED_SD
from synthetic_room import BLACK, CAMERA, Room, RoomRecording, make_path

BUILD_POSES, FLIGHT_POSES = make_path(60)[::3], make_path(60, start_s=0.03)  # the same path, half a frame apart
VAGUE_PRIOR = np.eye(6)


def near(pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A pose whose error has the covariance PRIOR."""
    return np.asarray(pose @ se3_exp(np.sqrt(np.diag(PRIOR)) * rng.standard_normal(6)))


# --- The pose of points ---


def seen_from(
    pose: FloatArray, rng: np.random.Generator, camera: Camera = CAMERA, count: int = 80
) -> tuple[FloatArray, FloatArray]:
    """Points, world frame, and where a camera sees them."""
    pixels = rng.uniform((0.0, 0.0), (camera.width, camera.height), (count, 2))
    points = transform(pose, camera.rays(pixels) * rng.uniform(1.0, 4.0, (count, 1)))
    return points, pixels


def keypoints_at(pixels: FloatArray, sd_px: FloatArray | float = 1.0) -> Keypoints:
    count = len(pixels)
    return Keypoints(pixels, np.zeros((count, 32), np.uint8), np.broadcast_to(sd_px, (count,)))


@pytest.mark.parametrize("seed", range(3))
def test_pose_is_exact_despite_two_fifths_of_wrong_matches(seed):
    rng = np.random.default_rng(seed)
    pose = se3_exp(rng.normal(size=6))
    points, pixels = seen_from(pose, rng)
    wrong = rng.choice(80, 32, replace=False)
    pixels[wrong] += rng.uniform(-40.0, 40.0, (32, 2))
    agree, found = pose_from_matches(points, keypoints_at(pixels), CAMERA, near(pose, rng), PRIOR)
    assert found is not None and 48 <= len(found.points) <= 55
    np.testing.assert_array_equal(points[agree], found.points)
    errors = pose_errors(found.pose[None], pose[None])
    assert errors.position_m[0] < 0.01 and errors.rotation_rad[0] < 0.004


def test_pose_does_not_contain_the_prior():
    """The prior only rejects wrong matches: the filter fuses it with the pose afterwards."""
    rng = np.random.default_rng(0)
    pose = se3_exp(rng.normal(size=6))
    points, pixels = seen_from(pose, rng)
    pixels += rng.normal(size=pixels.shape)
    one, other = (
        pose_from_matches(points, keypoints_at(pixels), CAMERA, pose @ se3_exp(np.full(6, off)), PRIOR)[1]
        for off in (-0.02, 0.02)
    )
    assert one is not None and other is not None
    np.testing.assert_allclose(se3_log(invert(one.pose) @ other.pose), 0.0, atol=3e-4)


BARREL = Camera(320, 256, 272.0, 272.0, 159.5, 127.5, (-0.25, 0.0, 0.0, 0.0, 0.0))
TALL_PIXELS = Camera(320, 256, 272.0, 400.0, 159.5, 127.5)


@pytest.mark.parametrize("camera", [CAMERA, BARREL, TALL_PIXELS], ids=["plain", "barrel", "tall pixels"])
def test_squared_errors_match_the_covariance(camera):
    """In units of the covariance their mean is six; over 150 poses its standard deviation is 0.3."""
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(150):
        pose = se3_exp(rng.normal(size=6))
        points, pixels = seen_from(pose, rng, camera)
        sd_px = rng.uniform(0.5, 2.0, 80)
        pixels += sd_px[:, None] * rng.normal(size=pixels.shape)
        _, found = pose_from_matches(points, keypoints_at(pixels, sd_px), camera, near(pose, rng), PRIOR)
        assert found is not None
        error = se3_log(invert(found.pose) @ pose)
        squares.append(error @ np.linalg.solve(found.covariance, error))
    # Points with large errors have less weight than they could, so the covariance is a fifth too large.
    assert 4.2 < np.mean(squares) < 6.5


def test_exact_prior_is_accepted():
    rng = np.random.default_rng(2)
    points, pixels = seen_from(np.eye(4), rng)
    _, found = pose_from_matches(points, keypoints_at(pixels), CAMERA, np.eye(4), np.zeros((6, 6)))
    assert found is not None
    np.testing.assert_allclose(found.pose, np.eye(4), atol=1e-6)


def test_too_few_or_too_concentrated_points_give_no_pose():
    rng = np.random.default_rng(3)
    points, pixels = seen_from(np.eye(4), rng)
    for count in (14, 0):
        agree, found = pose_from_matches(points[:count], keypoints_at(pixels[:count]), CAMERA, np.eye(4), PRIOR)
        assert agree.tolist() == [True] * count and found is None
    # All at one place, seen from afar: the camera's position around it is undetermined.
    narrow = np.array([0.0, 0.0, 4.0]) + 0.02 * rng.normal(size=(80, 3))
    seen = keypoints_at(CAMERA.project(narrow))
    agree, found = pose_from_matches(narrow, seen, CAMERA, np.eye(4), PRIOR)
    assert agree.sum() == 80 and found is None


@pytest.mark.parametrize("factor", [0.8, 0.9, 1.0, 1.1, 1.3])
def test_wrong_focal_length_is_recovered(factor: float) -> None:
    """From a pose near the true one; the corners' noise explains what remains."""
    rng = np.random.default_rng(5)
    true = replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)
    deviations = []
    for _ in range(30):
        pose = se3_exp(rng.normal(size=6))
        points, pixels = seen_from(pose, rng, true)
        seen = keypoints_at(pixels + rng.normal(size=pixels.shape))
        _, found = pose_from_matches(points, seen, CAMERA, near(pose, rng), PRIOR)
        if found is None:
            continue
        assert found.log_focal_sd < 0.01
        deviations.append((found.log_focal - np.log(factor)) / found.log_focal_sd)
    assert len(deviations) > 20
    assert np.median(np.abs(deviations)) < 1.5 and np.percentile(np.abs(deviations), 90.0) < 4.0


def test_focal_length_is_undetermined_where_all_points_are_at_one_depth_and_near_the_centre() -> None:
    """A step along the view looks the same."""
    rng = np.random.default_rng(6)
    pixels = rng.uniform((120.0, 90.0), (200.0, 165.0), (80, 2))
    points = 3.0 * CAMERA.rays(pixels)
    seen = keypoints_at(pixels + rng.normal(size=pixels.shape), 1.0)
    _, found = pose_from_matches(points, seen, CAMERA, np.eye(4), PRIOR)
    assert found is not None and found.log_focal_sd > WELL_OBSERVED_SD


# --- The pose in a room ---


@pytest.fixture(scope="module")
def localizer() -> OrbLandmarkLocalizer:
    recording = RoomRecording(Room(), BUILD_POSES)
    landmarks, _, _ = build_landmarks(recording, recording.depth, NoProgress())
    return OrbLandmarkLocalizer(landmarks, CAMERA)


def test_camera_is_relocalized_by_one_image(localizer: OrbLandmarkLocalizer) -> None:
    """Without a prior, or with one that is too vague."""
    for pose in FLIGHT_POSES[5::20]:
        color, _ = Room().view(pose)
        for found in (localizer.relocalize(color), localizer.measure(color, BUILD_POSES[0], VAGUE_PRIOR).pose):
            assert found is not None and len(found.points) >= 20
            errors = pose_errors(found.pose[None], pose[None])
            assert errors.position_m[0] < 0.03 and errors.rotation_rad[0] < 0.015


def test_two_places_that_look_alike_give_no_pose(localizer: OrbLandmarkLocalizer) -> None:
    """A second room is equal to the first, whose map lacks three landmarks of ten."""
    room = localizer._landmarks
    rng = np.random.default_rng(7)
    kept = rng.uniform(size=len(room)) < 0.7
    twin = Landmarks(room.points + np.array([12.0, 0.0, 0.0], np.float32), room.descriptors)
    both = Landmarks(
        np.concatenate([room.points[kept], twin.points]), np.concatenate([room.descriptors[kept], twin.descriptors])
    )
    for pose in FLIGHT_POSES[5::20]:
        color, _ = Room().view(pose)
        mistaken = OrbLandmarkLocalizer(twin, CAMERA).relocalize(color)
        assert mistaken is not None and mistaken.pose[0, 3] - pose[0, 3] == pytest.approx(12.0, abs=0.03)
        assert OrbLandmarkLocalizer(both, CAMERA).relocalize(color) is None


def test_landmarks_in_a_narrow_band_do_not_relocalize(localizer: OrbLandmarkLocalizer) -> None:
    """The same number of landmarks all over the image does."""
    pose = FLIGHT_POSES[30]
    color, _ = Room().view(pose)
    room, camera = localizer._landmarks, localizer._detect.camera
    local = transform(invert(pose), room.points)
    seen = np.flatnonzero(camera.in_sight(local))
    height = camera.project(local[seen])[:, 1]
    band = seen[np.abs(height - np.median(height)) < 0.12 * camera.height]
    anywhere = np.random.default_rng(8).choice(seen, len(band), replace=False)
    narrow, wide = (
        OrbLandmarkLocalizer(Landmarks(room.points[chosen], room.descriptors[chosen]), CAMERA)
        for chosen in (band, anywhere)
    )
    found = narrow.measure(color, pose, PRIOR)
    assert found.found >= 20 and found.pose is not None
    assert narrow.relocalize(color) is None and wide.relocalize(color) is not None


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
    found = OrbLandmarkLocalizer(both, CAMERA).measure(color, near_it, covariance)
    assert found.pose is not None and found.found == len(found.pose.points) >= 20
    assert pose_errors(found.pose.pose[None], pose[None]).position_m[0] < 0.03
    contradicted = OrbLandmarkLocalizer(both, CAMERA).measure(color, far, covariance)
    assert contradicted.expected > 60 and contradicted.found == 0 and contradicted.pose is None


def test_no_pose_in_the_dark_or_in_another_room(localizer: OrbLandmarkLocalizer) -> None:
    """Walls with other paint have the same shape and other landmarks."""
    other = Room(seed=1)
    for pose in FLIGHT_POSES[::20]:
        for color in (BLACK, other.view(pose)[0]):
            assert localizer.relocalize(color) is None
            measured = localizer.measure(color, pose, PRIOR)
            assert measured.pose is None and measured.found < 8 and measured.expected > 100


def test_landmarks_in_view_are_expected_and_found_where_the_camera_is(localizer: OrbLandmarkLocalizer) -> None:
    """At a prior 1.5 m beside the camera, as many are in view, but few agree on a pose near it."""
    pose = FLIGHT_POSES[30]
    color, _ = Room().view(pose)
    right = localizer.measure(color, pose, PRIOR)
    detected = localizer._detect.camera
    in_view = detected.in_sight(transform(invert(pose), localizer._landmarks.points))
    assert right.pose is not None and right.found == len(right.pose.points) > 60
    assert right.expected == np.count_nonzero(in_view) > right.found
    np.testing.assert_array_equal(right.visible, np.flatnonzero(in_view))
    np.testing.assert_array_equal(localizer._landmarks.points[right.visible[right.is_found]], right.pose.points)
    wrong = localizer.measure(color, pose @ se3_exp([1.0, 0.0, -0.5, 0.0, 0.3, 0.0]), PRIOR)
    assert wrong.expected > 60 and wrong.found < 0.2 * right.found and wrong.pose is None
    away = make_pose(np.eye(3), np.array([0.0, -50.0, 0.0]))
    assert localizer.measure(color, away, PRIOR).expected == 0


def test_room_without_landmarks_expects_none() -> None:
    assert NoLandmarks().measure(BLACK, np.eye(4), PRIOR) == LandmarkMeasurement(0, 0, None)
    assert NoLandmarks().relocalize(BLACK) is None


def test_dim_images_show_most_landmarks(localizer: OrbLandmarkLocalizer) -> None:
    pose = FLIGHT_POSES[30]
    color, _ = Room().view(pose)
    bright, dim = (localizer.measure((color / factor).astype(np.uint8), pose, PRIOR) for factor in (1, 8))
    assert bright.pose is not None and dim.pose is not None
    assert dim.expected == bright.expected and dim.found > 0.5 * bright.found


def test_camera_of_another_focal_length_is_localized(localizer: OrbLandmarkLocalizer) -> None:
    """Keypoints are detected at one focal length in pixels, so that their scales are comparable."""
    camera, pose = Camera(640, 480, 700.0, 700.0, 319.5, 239.5), FLIGHT_POSES[20]
    color, _ = Room().view(pose, camera)
    other = OrbLandmarkLocalizer(localizer._landmarks, camera)
    found = other.measure(color, pose @ se3_exp(np.full(6, 0.02)), PRIOR).pose
    assert found is not None
    assert pose_errors(found.pose[None], pose[None]).position_m[0] < 0.02


def test_search_radius_is_that_of_visible_landmarks() -> None:
    """Near a wall it is as large as the prior asks for, whatever the rest of the room."""
    rng = np.random.default_rng(4)
    camera = KeypointDetector(CAMERA).camera
    points, _ = seen_from(np.eye(4), rng, camera, 120)
    close = 0.5 * points / points[:, 2:]
    out_of_view = np.array([6.0, 0.0, 6.0]) * rng.uniform(1.0, 1.5, (400, 1))
    landmarks = Landmarks(
        np.concatenate([close, out_of_view]).astype(np.float32), rng.integers(0, 256, (520, 32)).astype(np.uint8)
    )
    seen = Keypoints(camera.project(close), landmarks.descriptors[:120], np.ones(120))
    prior = se3_exp([0.03, -0.03, 0.0, 0.0, 0.0, 0.0])  # 16 pixels for what is close, one or two for the rest
    covariance = np.diag([0.02, 0.02, 0.02, 0.003, 0.003, 0.003]) ** 2
    found = OrbLandmarkLocalizer(landmarks, CAMERA).measure_keypoints(seen, prior, covariance).pose
    assert found is not None and len(found.points) > 100
    np.testing.assert_allclose(found.pose, np.eye(4), atol=1e-3)
