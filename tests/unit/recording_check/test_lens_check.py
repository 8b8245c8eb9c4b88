"""Corners show a wrong focal length or a wrong scale of depth, and tell which of the two fits."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from altered_recordings import Altered, turning_path, with_focal
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.checks import check_recording
from monoloc.camera import Camera
from monoloc.geometry import make_pose
from monoloc.io.recording import Recording, Selection
from monoloc.recording_check.correspondences import Matches, match_corners
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.lens_check import camera_doubts, check_factors, intrinsics_warnings
from monoloc.recording_check.wide_pairs import match_wide
from synthetic_room import SMALL_CAMERA, Room, RoomRecording

CALIBRATE = "calibrate the camera, or check that the intrinsics are of this image size"


def test_right_intrinsics_are_not_doubted(room: tuple[Recording, Matches]) -> None:
    recording, matches = room
    assert list(intrinsics_warnings(Evidence(recording, matches, None), recording.camera)) == []


def test_a_wrong_focal_length_is_not_taken_for_a_wrong_scale(room: tuple[Recording, Matches]) -> None:
    recording, matches = room
    camera = with_focal(recording.camera, 1.1)
    evidence = Evidence(
        Altered(recording, camera=camera), replace(matches, camera=with_focal(matches.camera, 1.1)), None
    )
    (of_focal,) = check_factors(evidence)
    name, value, remark = of_focal.name, of_focal.value, of_focal.remark
    found = re.fullmatch(rf"([\d.]+) ± [\d.]+ of the stated {camera.focal_px:.0f} px", value)
    assert found and float(found[1]) == pytest.approx(1.0 / 1.1, rel=0.03)
    assert (name, remark) == ("focal length", CALIBRATE)
    assert list(intrinsics_warnings(evidence, camera)) == [f"focal length by the corners: {value}; {remark}"]


@pytest.mark.parametrize("factor", [1.07, 0.9, 1.2])
def test_a_wrong_scale_is_not_taken_for_a_wrong_focal_length(room: tuple[Recording, Matches], factor: float) -> None:
    recording, matches = room
    scaled = Altered(recording, depth=lambda depth: factor * depth)
    (of_scale,) = check_factors(Evidence(scaled, matches, None))
    name, value, remark = of_scale.name, of_scale.value, of_scale.remark
    found = re.fullmatch(r"depth is ([\d.]+) ± [\d.]+ times as far as the poses say", value)
    assert found and float(found[1]) == pytest.approx(factor, rel=0.02)
    assert (name, remark) == (
        "scale",
        "check the scale of the depth, unit and scatter of the poses, and the principal point",
    )


def test_a_scale_that_images_gave_is_not_doubted(room: tuple[Recording, Matches]) -> None:
    recording, matches = room
    scaled = Altered(recording, depth=lambda depth: 1.07 * depth)
    scaled.scale_sd = 0.1  # type: ignore[attr-defined]
    assert [(of.name, of.remark) for of in check_factors(Evidence(scaled, matches, None))] == [("focal length", "")]


@pytest.mark.parametrize(("factor", "remark"), [(1.0, ""), (1.1, CALIBRATE)])
def test_a_camera_that_only_turns_tells_the_focal_length_and_no_scale(factor: float, remark: str) -> None:
    poses = turning_path(40)
    tripod = RoomRecording(Room(), make_pose(poses[:, :3, :3], np.zeros(3)), SMALL_CAMERA)
    matches = match_corners(tripod)
    matches = replace(matches, camera=with_focal(matches.camera, factor))
    altered = Altered(tripod, camera=with_focal(tripod.camera, factor))
    found = check_factors(Evidence(altered, matches, None))
    assert [(of.name, of.remark) for of in found] == [("focal length", remark)]


def test_a_build_warns_as_check_does(room: tuple[Recording, Matches]) -> None:
    recording, _ = room
    camera = replace(recording.camera, fy=0.94 * recording.camera.fx)
    warnings = check_recording(Selection(Altered(recording, camera=camera), range(24)), None, BuildConfig())
    assert any(line.startswith("pixels: fx = ") for line in warnings), warnings


@pytest.mark.parametrize(
    ("changes", "names"),
    [({}, []), ({"fy": 0.75 * SMALL_CAMERA.fx}, ["pixels"]), ({"cx": 0.0}, ["principal point"])],
)
def test_intrinsics_that_no_camera_has_give_a_warning(changes: dict[str, float], names: list[str]) -> None:
    camera: Camera = replace(SMALL_CAMERA, **changes)  # type: ignore[arg-type]
    assert [doubt.name for doubt in camera_doubts(camera)] == names
    assert [line.split(":")[0] for line in intrinsics_warnings(None, camera)] == names


def test_scale_is_measured_over_the_same_distances_at_any_frame_rate() -> None:
    distances_m = []
    for rate in (1, 4):
        recording = RoomRecording(Room(), turning_path(20 * rate, rate_hz=15.0 * rate), SMALL_CAMERA)
        wide = match_wide(Evidence(recording, match_corners(recording), None))
        assert wide is not None
        distances_m.append(np.median(np.linalg.norm(wide.relative(wide.poses)[:, :3, 3], axis=1)))
    assert distances_m[1] == pytest.approx(distances_m[0], rel=0.2)
