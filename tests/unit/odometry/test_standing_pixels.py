"""What stands still in a camera's images: quarter discs over two corners, as a drone's guards, or nothing."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import invert, make_pose, so3_exp
from monoloc.odometry.motion import Motion
from monoloc.odometry.standing_pixels import StandingMask, StandingPixels
from synthetic_room import CAMERA, Room, RoomRecording, make_path

FloatArray = NDArray[np.float64]
IMAGES = 30
POSES = make_path(IMAGES)
RECORDING = RoomRecording(Room(), POSES)
GUARDS = np.zeros((CAMERA.height, CAMERA.width), dtype=np.uint8)
for corner in ((0, CAMERA.height), (CAMERA.width, CAMERA.height)):
    cv2.circle(GUARDS, corner, 80, 1, -1)
COLORS = np.random.default_rng(0).integers(0, 256, (16, 20, 3), dtype=np.uint8)
PICTURE = cv2.resize(COLORS, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_NEAREST)


def guarded(index: int) -> NDArray[np.uint8]:
    return np.where(GUARDS[..., None] > 0, PICTURE, RECORDING.color(index)).astype(np.uint8)


def depth_of(index: int) -> DepthPrediction:
    return DepthPrediction(RECORDING.depth(index), CAMERA)


def true_motion(index: int) -> Motion | None:
    return Motion(invert(POSES[index - 1]) @ POSES[index]) if index else None


def after(
    color: Callable[[int], NDArray[np.uint8]],
    motion: Callable[[int], Motion | None] = true_motion,
    landmark_pose: Callable[[int], FloatArray | None] = lambda index: None,
    depth: Callable[[int], DepthPrediction | None] = depth_of,
) -> StandingPixels:
    pixels = StandingPixels(CAMERA)
    for index in range(IMAGES):
        pixels.update(color(index), motion(index), depth(index), landmark_pose(index))
    return pixels


def marked(pixels: StandingPixels) -> NDArray[np.bool_]:
    """The mask at the camera's size."""
    size = (CAMERA.width, CAMERA.height)
    return cv2.resize(pixels.found.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0


def test_guards_are_found_and_the_room_is_not_taken_for_them() -> None:
    found = marked(after(guarded))
    assert found[GUARDS > 0].mean() > 0.9
    margin = cv2.dilate(GUARDS, np.ones((17, 17), np.uint8)) > 0
    assert found[~margin].mean() < 0.01


def test_a_point_behind_the_camera_is_not_hidden() -> None:
    """Landmarks that were ahead at the expected pose may be behind the measured one."""
    mask = StandingMask(CAMERA, np.ones((12, 16), dtype=np.bool_))
    is_hidden = mask.hides([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.1, 0.0, -0.02]], np.eye(4))
    assert is_hidden.tolist() == [True, False, False]


def test_without_guards_nothing_stands() -> None:
    pixels = after(RECORDING.color)
    assert not pixels.found.mask.any() and pixels.share == 0.0
    depth = depth_of(0)
    assert pixels.found.without(depth) is depth


def test_a_hovering_camera_whose_pose_jumps_marks_nothing() -> None:
    """As where landmarks of a flat view lead to one pose and to another in turn; half of the view is a bare wall."""
    rng = np.random.default_rng(0)

    def noisy(index: int) -> NDArray[np.uint8]:
        image = RECORDING.color(0).copy()
        image[:, : CAMERA.width // 2] = 128
        return np.clip(image + rng.normal(0.0, 3.0, image.shape), 0, 255).astype(np.uint8)

    jumping = after(noisy, landmark_pose=lambda index: POSES[2 * (index % 2)], depth=lambda index: depth_of(0))
    assert not jumping.found.mask.any()


def test_a_person_who_walks_past_a_hovering_camera_does_not_make_the_room_stand() -> None:
    """Odometry follows the person, who fills most of the view; landmarks say that the camera stands."""
    step_px = 6
    walking = Motion(make_pose(so3_exp([0.0, step_px / CAMERA.fx, 0.0]), np.zeros(3)))

    def passed(index: int) -> NDArray[np.uint8]:
        image = RECORDING.color(0).copy()
        image[:, 100:260] = np.roll(PICTURE, -step_px * index, axis=1)[:, 100:260]
        return image

    followed = after(passed, motion=lambda index: walking, depth=lambda index: depth_of(0))
    assert followed.found.mask.any(), "without landmarks, nothing tells"
    known = after(passed, lambda index: walking, lambda index: POSES[0], lambda index: depth_of(0))
    assert not known.found.mask.any()


def test_landmark_poses_replace_an_odometry_that_stands_with_the_guards() -> None:
    standing = after(guarded, motion=lambda index: Motion(np.eye(4)))
    assert not standing.found.mask.any()
    known = after(guarded, motion=lambda index: Motion(np.eye(4)), landmark_pose=lambda index: POSES[index])
    assert marked(known)[GUARDS > 0].mean() > 0.9


def test_images_are_compared_across_frames_without_depth() -> None:
    """As where a budget leaves depth out every second time: the motion is taken in all the same."""
    pixels = after(guarded, depth=lambda index: depth_of(index) if index % 2 else None)
    assert marked(pixels)[GUARDS > 0].mean() > 0.8


def test_after_a_gap_the_next_image_is_not_compared_with_the_last_one() -> None:
    pixels = StandingPixels(CAMERA)
    for index in range(IMAGES):
        pixels.update(guarded(index), None, depth_of(index), None)
    assert not pixels.found.mask.any()


def test_depth_has_none_where_pixels_stand_whatever_its_camera() -> None:
    pixels = after(guarded)
    for camera in (CAMERA, CAMERA.resized(64, 48), CAMERA.cropped(40, 30, 240, 200)):
        depth = DepthPrediction(np.full((camera.height, camera.width), 2.0, np.float32), camera)
        corners = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=2).reshape(-1, 2)
        stands = pixels.found.stands(CAMERA.project(camera.rays(corners.astype(np.float32))))
        hidden = pixels.found.without(depth).depth_m.ravel() == 0.0
        np.testing.assert_array_equal(hidden, stands)
        assert 0.02 < hidden.mean() < 0.5


def test_what_stands_longer_is_reported_once() -> None:
    pixels, grown = StandingPixels(CAMERA), 0
    for index in range(IMAGES):
        pixels.update(guarded(index), true_motion(index), depth_of(index), None)
        grown += pixels.has_grown
    assert 1 <= grown <= 4


def test_a_mask_is_forgotten_when_its_pixels_move() -> None:
    pixels = after(guarded)
    assert pixels.share > 0.05
    for index in range(IMAGES):
        pixels.update(RECORDING.color(index), true_motion(index), depth_of(index), None)
    assert pixels.share == 0.0


def test_guards_are_found_while_the_exposure_changes() -> None:
    def exposed(index: int) -> NDArray[np.uint8]:
        return (guarded(index) * (0.5 if index % 2 else 0.9)).astype(np.uint8)

    assert marked(after(exposed))[GUARDS > 0].mean() > 0.9


def test_a_mask_of_most_of_the_image_is_not_used() -> None:
    def covered(index: int) -> NDArray[np.uint8]:
        part = round(0.73 * CAMERA.width)
        return np.concatenate([PICTURE[:, :part], RECORDING.color(index)[:, part:]], axis=1)

    pixels = after(covered, landmark_pose=lambda index: POSES[index])
    assert not pixels.found.mask.any()
