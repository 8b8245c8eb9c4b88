"""Landmarks: found again, of a room's build frames, and the pose that they tell, as exact as it says."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.camera import Camera
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, invert, se3_exp, se3_log, transform
from monoloc.landmarks.features import MATCH_BITS, KeypointDetector, Keypoints, match_descriptors
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.landmarks.pnp import OrbLandmarkLocalizer, solve
from monoloc.progress import NoProgress
from synthetic_room import BLACK, CAMERA, Room, RoomRecording, make_path

BUILT, FLOWN = make_path(60), make_path(60, start_s=0.03)  # two walks along one way, half a frame apart
NEAR = np.diag([0.05, 0.05, 0.05, 0.03, 0.03, 0.03]) ** 2
WIDE = np.diag(np.full(6, 1.0))


@pytest.fixture(scope="module")
def walk() -> RoomRecording:
    return RoomRecording(Room(), BUILT)


@pytest.fixture(scope="module")
def built(walk):
    return build_landmarks(walk, walk.depth, NoProgress())


@pytest.fixture(scope="module")
def sight(built) -> OrbLandmarkLocalizer:
    return OrbLandmarkLocalizer(built[0], CAMERA)


def beside(pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A belief that is off by what NEAR says."""
    return pose @ se3_exp(np.sqrt(np.diag(NEAR)) * rng.standard_normal(6))


# Which keypoint is which landmark.


@given(seed=st.integers(0, 2**32 - 1), landmarks=st.integers(0, 25), keypoints=st.integers(0, 25))
def test_pairs_are_each_others_likest_within_reach(seed, landmarks, keypoints):
    """Against the formula: every landmark's likest keypoint, if it is that one's likest landmark."""
    rng = np.random.default_rng(seed)
    expected, pixels = rng.uniform(0.0, 40.0, (landmarks, 2)), rng.uniform(0.0, 40.0, (keypoints, 2))
    looks = rng.integers(0, 256, (5, 32)).astype(np.uint8)
    known, seen = (
        looks[rng.integers(5, size=count)] ^ (rng.uniform(size=(count, 32)) < 0.2).astype(np.uint8)
        for count in (landmarks, keypoints)
    )
    bits = np.unpackbits(known[:, None] ^ seen[None], axis=2).sum(axis=2, dtype=int)
    far = np.abs(expected[:, None] - pixels[None]).max(axis=2) >= 10.0
    bits[far | (bits >= MATCH_BITS)] = 999
    which, where = match_descriptors(expected, known, pixels, seen, 10.0)
    assert len(set(which.tolist())) == len(which) and len(set(where.tolist())) == len(where)
    for landmark, keypoint in zip(which, where, strict=True):
        assert bits[landmark, keypoint] == bits[landmark].min() == bits[:, keypoint].min() < 999
    # Nothing is left out where both have a likest and are alone in it.
    for landmark in range(landmarks):
        for keypoint in range(keypoints):
            least = bits[landmark, keypoint]
            alone = (bits[landmark] <= least).sum() == 1 == (bits[:, keypoint] <= least).sum()
            assert not (least < 999 and alone) or (landmark, keypoint) in set(zip(which, where, strict=True))


# The pose of points.


def seen_from(
    pose: FloatArray, rng: np.random.Generator, camera: Camera = CAMERA, count: int = 80
) -> tuple[FloatArray, FloatArray]:
    """Points, world frame, and where a camera sees them."""
    pixels = rng.uniform((0.0, 0.0), (camera.width, camera.height), (count, 2))
    points = transform(pose, camera.rays(pixels) * rng.uniform(1.0, 4.0, (count, 1)))
    return points, pixels


def keypoints(pixels: FloatArray, sd_px: FloatArray | float = 1.0) -> Keypoints:
    count = len(pixels)
    return Keypoints(pixels, np.zeros((count, 32), np.uint8), np.broadcast_to(sd_px, (count,)))


@pytest.mark.parametrize("seed", range(5))
def test_a_pose_is_found_though_two_fifths_are_others(seed):
    rng = np.random.default_rng(seed)
    pose = se3_exp(rng.normal(size=6))
    points, pixels = seen_from(pose, rng)
    others = rng.choice(80, 32, replace=False)
    pixels[others] += rng.uniform(-40.0, 40.0, (32, 2))
    found = solve(points, keypoints(pixels), CAMERA, beside(pose, rng), NEAR)
    assert found is not None and 48 <= len(found.points) <= 55
    errors = pose_errors(found.pose[None], pose[None])
    assert errors.position_m[0] < 0.01 and errors.rotation_rad[0] < 0.004


def test_the_pose_is_of_the_points_alone():
    """The belief says which points are others, and nothing beside: it is joined with the pose afterwards."""
    rng = np.random.default_rng(0)
    pose = se3_exp(rng.normal(size=6))
    points, pixels = seen_from(pose, rng)
    pixels += rng.normal(size=pixels.shape)
    one, other = (
        solve(points, keypoints(pixels), CAMERA, pose @ se3_exp(np.full(6, off)), NEAR) for off in (-0.02, 0.02)
    )
    assert one is not None and other is not None
    np.testing.assert_allclose(se3_log(invert(one.pose) @ other.pose), 0.0, atol=3e-4)


BARREL = Camera(320, 256, 272.0, 272.0, 159.5, 127.5, (-0.25, 0.0, 0.0, 0.0, 0.0))
TALL_PIXELS = Camera(320, 256, 272.0, 400.0, 159.5, 127.5)


@pytest.mark.parametrize("camera", [CAMERA, BARREL, TALL_PIXELS], ids=["plain", "barrel", "tall pixels"])
def test_errors_are_as_large_as_stated(camera):
    """Squared, in units of the covariance, their mean is six; of 300, its standard deviation is 0.2."""
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(300):
        pose = se3_exp(rng.normal(size=6))
        points, pixels = seen_from(pose, rng, camera)
        sd_px = rng.uniform(0.5, 2.0, 80)
        pixels += sd_px[:, None] * rng.normal(size=pixels.shape)
        found = solve(points, keypoints(pixels, sd_px), camera, beside(pose, rng), NEAR)
        assert found is not None
        error = se3_log(invert(found.pose) @ pose)
        squares.append(error @ np.linalg.solve(found.covariance, error))
    # Points a little off count for less than they could, so a fifth less is stated to be known.
    assert 4.2 < np.mean(squares) < 6.5


def test_an_exact_belief_is_a_belief():
    rng = np.random.default_rng(2)
    points, pixels = seen_from(np.eye(4), rng)
    found = solve(points, keypoints(pixels), CAMERA, np.eye(4), np.zeros((6, 6)))
    assert found is not None
    np.testing.assert_allclose(found.pose, np.eye(4), atol=1e-6)


def test_too_few_or_too_narrow_points_tell_nothing():
    rng = np.random.default_rng(3)
    points, pixels = seen_from(np.eye(4), rng)
    assert solve(points[:14], keypoints(pixels[:14]), CAMERA, np.eye(4), NEAR) is None
    assert solve(points[:0], keypoints(pixels[:0]), CAMERA, np.eye(4), NEAR) is None
    # All at one place, seen from afar: where the camera is about it stays open.
    narrow = np.array([0.0, 0.0, 4.0]) + 0.02 * rng.normal(size=(80, 3))
    assert solve(narrow, keypoints(CAMERA.project(narrow)), CAMERA, np.eye(4), NEAR) is None


# Of a room.


def test_landmarks_lie_on_the_rooms_surfaces(built):
    landmarks, _ = built
    assert len(landmarks) > 300 and landmarks.bytes == 44 * len(landmarks)
    assert np.percentile(Room().distance_m(landmarks.points), 90.0) < 0.01


def test_errors_at_the_viewpoints_are_as_measured(built, sight):
    """On another walk along the same way, no larger: squared, in units of the covariance, six at most in the mean.

    Corners of a room that is drawn without noise are seen better than to a pixel.
    """
    _, lasting = built
    rng, squares = np.random.default_rng(0), []
    for pose in FLOWN[::3]:
        sighting = sight(Room().view(pose)[0], beside(pose, rng), NEAR)
        error = se3_log(invert(sighting.pose) @ pose)
        squares.append(error @ np.linalg.solve(sighting.covariance + np.diag(lasting.widths(0.0) ** 2), error))
    assert 0.4 < np.mean(squares) < 6.0
    assert lasting.sd_at_reference_m < 0.005 and lasting.sd_at_reference_rad < 0.003
    assert lasting.sd_growth_m > 0.0 and lasting.sd_growth_rad > 0.0 and lasting.relocalization_sd_m == 0.0


def test_poses_that_err_make_landmarks_that_do(built):
    """Poses of another system: what landmarks err by is measured against them, and so is at least as large."""
    rng = np.random.default_rng(1)
    noisy = RoomRecording(Room(), BUILT[::2])
    noisy.poses = BUILT[::2] @ se3_exp(rng.normal(size=(30, 6)) * np.repeat([0.01, 0.005], 3))
    landmarks, lasting = build_landmarks(noisy, noisy.depth, NoProgress())
    assert len(landmarks) > 100
    exact = built[1]
    assert (
        2.0 * exact.sd_at_reference_m < lasting.sd_at_reference_m < 0.03
        and 0.002 < lasting.sd_at_reference_rad < 0.015
    )


def test_without_a_belief_a_camera_is_found_by_one_image(sight):
    for pose in FLOWN[::10]:
        color, _ = Room().view(pose)
        for sighting in (sight(color, BUILT[0], WIDE), sight.anywhere(color)):
            assert sighting is not None and len(sighting.points) >= 20
            errors = pose_errors(sighting.pose[None], pose[None])
            assert errors.position_m[0] < 0.03 and errors.rotation_rad[0] < 0.015


def test_in_the_dark_and_in_another_room_none_is_seen(sight):
    """Walls that are painted differently have the same shape, and other landmarks."""
    others = Room(seed=1)
    for pose in FLOWN[::20]:
        for color in (BLACK, others.view(pose)[0]):
            assert sight.anywhere(color) is None
            assert sight(color, pose, NEAR) is None


def test_dim_images_have_the_same_landmarks(sight):
    pose = FLOWN[30]
    color, _ = Room().view(pose)
    bright, dim = (sight((color / by).astype(np.uint8), pose, NEAR) for by in (1, 8))
    assert bright is not None and dim is not None
    assert len(dim.points) > 0.5 * len(bright.points)


def test_a_camera_of_another_focal_length_sees_them(sight, built):
    """Corners are looked for at one focal length in pixels, so that they have one size."""
    near, pose = OrbLandmarkLocalizer(built[0], Camera(640, 480, 700.0, 700.0, 319.5, 239.5)), FLOWN[20]
    sharper = Camera(640, 480, 700.0, 700.0, 319.5, 239.5)
    sighting = near(Room().view(pose, sharper)[0], pose @ se3_exp(np.full(6, 0.02)), NEAR)
    assert sighting is not None
    assert pose_errors(sighting.pose[None], pose[None]).position_m[0] < 0.02


def test_keypoints_lie_in_the_image_that_was_given():
    """A bright square's corners, at half the size, are found where they are."""
    camera = Camera(640, 480, 2.0 * 260.0, 2.0 * 260.0, 319.5, 239.5)
    image = np.zeros((480, 640, 3), np.uint8)
    cv2.rectangle(image, (240, 180), (399, 299), (200, 200, 200), -1)
    detector = KeypointDetector(camera)
    assert (detector.camera.width, detector.camera.height) == (320, 240)
    found = detector(image)
    corners = np.array([[119.5, 89.5], [199.5, 89.5], [119.5, 149.5], [199.5, 149.5]])
    apart = np.linalg.norm(found.pixels[:, None] - corners[None], axis=2)
    assert np.all(apart.min(axis=0) < 3.0)
    assert len(detector(np.zeros((480, 640, 3), np.uint8)).pixels) == 0


def test_frames_that_show_nothing_have_no_landmarks():
    walk = RoomRecording(Room(), make_path(6))
    walk._views = [(BLACK, depth) for _, depth in walk._views]
    landmarks, lasting = build_landmarks(walk, walk.depth, NoProgress())
    assert len(landmarks) == 0 and lasting.sd_at_reference_m == 0.0


def test_frames_without_depth_have_none_either():
    walk = RoomRecording(Room(), make_path(6))
    landmarks, _ = build_landmarks(walk, lambda index: np.zeros_like(walk.depth(index)), NoProgress())
    assert len(landmarks) == 0


def test_near_a_wall_landmarks_are_looked_for_as_far_as_they_may_be():
    """The reach is that of what is in sight, not of the rest of the room."""
    rng = np.random.default_rng(4)
    camera = KeypointDetector(CAMERA).camera
    seen, _ = seen_from(np.eye(4), rng, camera, 120)
    near = 0.5 * seen / seen[:, 2:]
    aside = np.array([6.0, 0.0, 6.0]) * rng.uniform(1.0, 1.5, (400, 1))
    landmarks = Landmarks(
        np.concatenate([near, aside]).astype(np.float32), rng.integers(0, 256, (520, 32)).astype(np.uint8)
    )
    sight, at = (
        OrbLandmarkLocalizer(landmarks, CAMERA),
        Keypoints(camera.project(near), landmarks.descriptors[:120], np.ones(120)),
    )
    believed = se3_exp([0.03, -0.03, 0.0, 0.0, 0.0, 0.0])  # 16 pixels for what is near, one or two for the rest
    sighting = sight.near(at, believed, np.diag([0.02, 0.02, 0.02, 0.003, 0.003, 0.003]) ** 2)
    assert sighting is not None and len(sighting.points) > 100
    np.testing.assert_allclose(sighting.pose, np.eye(4), atol=1e-3)


@pytest.mark.parametrize(("width", "height", "focal_px"), [(640, 480, 3000.0), (640, 64, 272.0), (90, 70, 60.0)])
def test_images_of_any_shape_have_corners(width, height, focal_px):
    """ORB leaves a margin of 31 pixels out, of which these would be, at the usual focal length."""
    rng = np.random.default_rng(0)
    image = cv2.resize(rng.integers(0, 256, (height // 8, width // 8, 3)).astype(np.uint8), (width, height))
    camera = Camera(width, height, focal_px, focal_px, width - 0.5, height / 2.0)  # at the image's very border
    detector = KeypointDetector(camera)
    found = detector(image)
    assert len(found.pixels) > 15
    assert np.all(found.pixels >= 0.0) and np.all(found.pixels < [detector.camera.width, detector.camera.height])


def test_of_many_frames_some_are_enough(walk, built, monkeypatch):
    monkeypatch.setattr("monoloc.builder.landmark_mapping._MOST_FRAMES", 20)
    landmarks, lasting = build_landmarks(walk, walk.depth, NoProgress())
    assert 100 < len(landmarks) < len(built[0]) and lasting.sd_at_reference_m < 0.01


def test_a_camera_that_stands_still_is_not_taken_for_an_exact_one():
    still = RoomRecording(Room(), np.repeat(make_path(1), 6, axis=0))
    _, lasting = build_landmarks(still, still.depth, NoProgress())
    assert lasting.sd_at_reference_m > 3e-4 and lasting.sd_at_reference_rad > 1e-4


def test_types_are_checked():
    with pytest.raises(ValueError, match="must be float32 and uint8, got float64 and uint8"):
        Landmarks(np.zeros((2, 3)), np.zeros((2, 32), np.uint8))


def test_shapes_are_checked():
    with pytest.raises(ValueError, match=r"must be \(L, 3\) and \(L, 32\), got \(2, 3\) and \(2, 31\)"):
        Landmarks(np.zeros((2, 3), np.float32), np.zeros((2, 31), np.uint8))
