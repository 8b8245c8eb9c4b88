"""Recordings under harder conditions."""

from __future__ import annotations

import numpy as np

from monoloc.builder.kept_depth import KeptDepth
from monoloc.evaluation.trajectory import pose_errors
from monoloc.io.recording import Selection
from monoloc_lab.experiments.altered import NarrowLens, with_pose_noise
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


def test_narrow_lens_sees_the_same_rays() -> None:
    recording = Selection(RoomRecording(Room(), make_path(1), SMALL_CAMERA), [0])
    narrow = NarrowLens(recording)
    assert (narrow.camera.width, narrow.camera.height) == (96, 76)
    assert narrow.color(0).shape == (76, 96, 3) and narrow.depth(0).shape == (76, 96)
    np.testing.assert_array_equal(narrow.color(0)[10, 20], recording.color(0)[36, 52])
    np.testing.assert_allclose(
        narrow.camera.rays(np.array([20.0, 10.0])), recording.camera.rays(np.array([52.0, 36.0]))
    )
    assert narrow.depth(0)[10, 20] == recording.depth(0)[36, 52]


def test_pose_noise_is_repeatable_and_has_its_size() -> None:
    recording = Selection(RoomRecording(Room(), make_path(3), SMALL_CAMERA), np.zeros(400, dtype=np.int64))
    noisy = with_pose_noise(recording)
    assert noisy.poses is not None and recording.poses is not None
    np.testing.assert_array_equal(noisy.poses, with_pose_noise(recording).poses)
    errors = pose_errors(noisy.poses, recording.poses)
    np.testing.assert_allclose(np.sqrt(np.mean(errors.position_m**2) / 3.0), 0.02, rtol=0.1)
    np.testing.assert_allclose(np.sqrt(np.mean(errors.rotation_rad**2) / 3.0), np.deg2rad(1.0), rtol=0.1)


def test_builds_see_the_altered_recording() -> None:
    recording = Selection(RoomRecording(Room(), make_path(3), SMALL_CAMERA), [0, 1])
    noisy, narrow = with_pose_noise(recording), NarrowLens(recording)
    kept = KeptDepth(noisy)
    np.testing.assert_array_equal(kept.poses, noisy.poses)
    assert kept.source is recording
    kept = KeptDepth(narrow)
    assert kept.camera == narrow.camera and kept.color(1).shape == (*kept.depth(1).shape, 3) == (76, 96, 3)
