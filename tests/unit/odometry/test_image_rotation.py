"""The rotation between two whole images."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, rotation_angle, so3_exp
from monoloc.odometry.image_rotation import ImageRotation
from synthetic_room import CAMERA, Room, RoomRecording, make_path

BLURRED_VIEWS = 7


def gray(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)


def view(room: Room, twist: FloatArray, camera: Camera) -> NDArray[np.uint8]:
    """A grey view of a camera that is turned by a rotation vector, in the middle of the room."""
    pose = np.eye(4)
    pose[:3, :3] = so3_exp(twist)
    return gray(RoomRecording(room, pose[None], camera).color(0))


def blurred(room: Room, twist: FloatArray, turn: FloatArray, camera: Camera) -> NDArray[np.uint8]:
    """The mean view of a camera that turns by a half of ``turn`` while the shutter is open."""
    exposure = np.linspace(-0.25, 0.25, BLURRED_VIEWS)
    return np.mean([view(room, twist + share * turn, camera) for share in exposure], axis=0).astype(np.uint8)


@pytest.mark.parametrize("camera", [CAMERA, replace(CAMERA, distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))])
def test_blurred_turns_are_measured_to_a_tenth(camera: Camera) -> None:
    """Of 6 degrees, whatever their axis; images are blurred by 14 of 320 pixels."""
    room, measure = Room(), ImageRotation(camera)
    for axis in np.array([[0.0, 1.0, 0.0], [-0.6, 0.7, 0.4]]):
        turn = np.deg2rad(6.0) * axis / np.linalg.norm(axis)
        motion = measure.between(blurred(room, np.zeros(3), turn, camera), blurred(room, turn, turn, camera))
        assert motion is not None and motion.translation == "unknown"
        error = rotation_angle(so3_exp(turn).T @ motion.T_previous_current[:3, :3])
        assert error < 0.1 * np.deg2rad(6.0), axis


def test_images_of_different_places_have_no_rotation() -> None:
    room, measure = Room(), ImageRotation(CAMERA)
    recording = RoomRecording(room, make_path(10))
    here = gray(recording.color(0))
    others = [
        gray(Room(seed=7).view(recording.poses[0])[0]),
        here[:, ::-1].copy(),
        np.random.default_rng(0).integers(0, 256, here.shape, dtype=np.uint8),
        np.full_like(here, 120),
    ]
    assert [measure.between(here, other) for other in others] == [None] * len(others)
    assert measure.between(here, here) is not None
