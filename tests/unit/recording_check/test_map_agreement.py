"""A second recording is found in a bundle's map, in the same world or one rigid transform away."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from altered_recordings import POSES, Altered, with_focal
from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.bundle import Bundle
from monoloc.geometry import make_pose, so3_exp
from monoloc.progress import NoProgress
from monoloc.recording_check.inspection import inspect_recording
from monoloc.recording_check.map_agreement import compare_with_map
from synthetic_room import CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture

FRAMES = 30


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(FRAMES, rate_hz=5.0), CAMERA)


@pytest.fixture(scope="module")
def bundle(recording: RoomRecording) -> Bundle:
    landmarks, *_ = build_landmarks(recording, recording.depth, NoProgress())
    return replace(make_bundle(room_mixture(Room()), recording), landmarks=landmarks)


def test_same_world(bundle: Bundle, recording: RoomRecording) -> None:
    agreement = compare_with_map(bundle, recording)
    assert agreement.found > 0.8 * agreement.frames and agreement.agreeing == agreement.found
    assert agreement.offset_m is not None and agreement.offset_m < 0.03


def test_another_world_is_one_transform_away(bundle: Bundle, recording: RoomRecording) -> None:
    T_map_world = make_pose(so3_exp(np.deg2rad([0.0, 40.0, 0.0])), np.array([1.2, 0.0, 1.6]))
    assert recording.poses is not None
    other = Altered(recording, poses=np.linalg.inv(T_map_world) @ recording.poses)
    agreement = compare_with_map(bundle, other)
    assert agreement.T_map_world is not None
    np.testing.assert_allclose(agreement.T_map_world, T_map_world, atol=0.04)
    findings = {finding.name: finding for finding in inspect_recording(other, bundle=bundle).findings}
    assert findings["poses"].level == "good"
    assert findings["world"].level == "warning"
    assert findings["world"].value in {f"one rigid transform away: {cm} cm, 40 degrees" for cm in range(196, 205)}


@pytest.mark.parametrize("has_depth", [True, False])
def test_poses_of_another_convention_are_named_by_the_map(
    bundle: Bundle, recording: RoomRecording, has_depth: bool
) -> None:
    """Without depth, the map alone tells."""
    assert recording.poses is not None
    opengl = Altered(recording, poses=POSES["OpenGL"].poses(recording.poses), has_depth=has_depth)
    findings = {each.name: each for each in inspect_recording(opengl, bundle=bundle).findings}
    assert ("world" in findings) != has_depth  # else the poses have been explained already
    remark = findings["poses" if has_depth else "world"].remark
    assert remark.endswith("as camera axes of OpenGL (y up, z backward); give --fix-poses opengl")


def test_without_depth_a_build_needs_a_cloud(recording: RoomRecording) -> None:
    """The level is that of a build, which would refuse it."""
    inspection = inspect_recording(Altered(recording, has_depth=False))
    (depth,) = [each for each in inspection.findings if each.name == "depth"]
    assert inspection.level == depth.level == "bad" and depth.remark.startswith("give a cloud of the room (--cloud)")


@pytest.mark.slow
def test_poses_that_fit_by_no_transform_are_bad(bundle: Bundle, recording: RoomRecording) -> None:
    assert recording.poses is not None
    mixed = Altered(recording, poses=recording.poses[np.random.default_rng(0).permutation(FRAMES)])
    (world,) = [each for each in inspect_recording(mixed, bundle=bundle).findings if each.name == "world"]
    assert world.level == "bad" and "by any rigid transform" in world.remark


@pytest.mark.slow
def test_another_room_and_another_lens_are_told(bundle: Bundle, recording: RoomRecording) -> None:
    other = RoomRecording(Room(seed=9), make_path(8, rate_hz=2.0), CAMERA)
    findings = {finding.name: finding for finding in inspect_recording(other, bundle=bundle).findings}
    assert findings["map"].level == "bad" and findings["map"].remark.startswith("another room")
    wrong = Altered(recording, camera=with_focal(CAMERA, 1.1))
    agreement = compare_with_map(bundle, wrong)
    assert agreement.focal is not None and agreement.focal.value == pytest.approx(1.0 / 1.1, rel=0.03)


def test_images_stretched_along_one_axis_are_named(bundle: Bundle, recording: RoomRecording) -> None:
    """As those of a wide stream that was squeezed into the proportions of the stated camera."""
    squeezed = Altered(recording, camera=replace(CAMERA, fy=0.9 * CAMERA.fy))
    (camera,) = [each for each in inspect_recording(squeezed, bundle=bundle).findings if each.name == "camera"]
    assert camera.level == "bad"
    assert re.fullmatch(
        r"the images are stretched: landmarks fit 1\.1\d times the stated fy over fx; .*", camera.remark
    )
