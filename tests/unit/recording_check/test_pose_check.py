"""Poses, depth and camera that contradict the images are recognised and named; right ones are not doubted."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from altered_recordings import (
    POSES,
    Altered,
    checked,
    late,
    range_of,
    refusal,
    turning_path,
    turning_path_at,
    upside_down,
    with_focal,
    with_noise,
)
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.checks import check_recording
from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, make_pose, se3_exp, so3_exp
from monoloc.io.corrected import Fixes, corrected
from monoloc.io.pose_fixes import parse_pose_fixes
from monoloc.io.recording import Recording, Selection
from monoloc.io.registry import open_recording
from monoloc.io.upright import Turned
from monoloc.recording_check.correspondences import Matches
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.explanations import small_delay
from monoloc.recording_check.inspection import inspect_recording
from monoloc.recording_check.pose_check import PoseCheck, check_matches, check_poses, compare_poses, require_agreement
from monoloc_lab.rooms import BUILD, TESTS
from synthetic_room import FRAME_RATE_HZ, SMALL_CAMERA, Room, RoomRecording, make_path


def test_right_recordings_agree(room: tuple[Recording, Matches]) -> None:
    check = checked(*room)
    assert check.verdict == "agree" and check.share is not None and check.share < 0.12 and check.jumps == ()
    assert require_agreement("walk", check, poses_are_refined=False) == []


@pytest.mark.parametrize("name", POSES)
def test_poses_of_another_convention_are_named_and_fixed(room: tuple[Recording, Matches], name: str) -> None:
    recording, matches = room
    assert recording.poses is not None
    altered = POSES[name].poses(recording.poses)
    check = checked(Altered(recording, poses=altered), matches)
    assert re.fullmatch(f".*% as [^;]*{POSES[name].words}.*; give {POSES[name].option}", refusal(check))
    if name not in ("late", "early"):  # which cannot be undone at the ends
        fixes = parse_pose_fixes(POSES[name].option.removeprefix("--fix-poses "))
        np.testing.assert_allclose(fixes.convert(altered), recording.poses, atol=1e-6)


def test_another_convention_is_that_of_the_stored_poses(room: tuple[Recording, Matches]) -> None:
    """A phone in portrait, whose images gravity turned upright: --fix-poses is of the poses before that."""
    recording = room[0]
    assert recording.poses is not None
    for name in ("OpenGL", "world-to-camera"):
        stored = Altered(recording, poses=POSES[name].poses(recording.poses))
        assert refusal(check_poses(Turned(stored, 1))).endswith(f"; give {POSES[name].option}")


def late_by(delay_s: float) -> FloatArray:
    """Poses of the room's path, each that of a time before its frame."""
    frames = np.arange(60) / FRAME_RATE_HZ - delay_s
    return turning_path_at(frames)


@pytest.mark.parametrize(("delay_s", "word"), [(0.1, "late"), (-0.1, "early"), (0.17, "late"), (-0.3, "early")])
def test_poses_late_by_no_whole_number_of_frames_are_named_in_seconds(
    room: tuple[Recording, Matches], delay_s: float, word: str
) -> None:
    recording, matches = room
    altered = Altered(recording, poses=late_by(delay_s))
    line = refusal(checked(altered, matches))
    found = re.fullmatch(rf".*% as poses {word} by ([\d.]+) s; give --fix-poses {word}:([\d.]+)s", line)
    assert found and found[1] == found[2], line
    assert float(found[1]) == pytest.approx(abs(delay_s), abs=0.02)
    fixed = check_poses(corrected(altered, Fixes(poses=f"{word}:{found[1]}s")))
    assert fixed.verdict == "agree" and fixed.share is not None and fixed.share < 0.12


def test_a_delay_that_remains_is_named_after_the_fix_that_was_given(room: tuple[Recording, Matches]) -> None:
    altered = Altered(room[0], poses=late_by(0.3))
    line = refusal(check_poses(corrected(altered, Fixes(poses="late:3"))))
    found = re.fullmatch(r".* give --fix-poses late:3,late:(0\.\d\d)s", line)
    assert found and float(found[1]) == pytest.approx(0.1, abs=0.02), line


def test_poses_that_agree_although_they_are_late_give_a_warning(room: tuple[Recording, Matches]) -> None:
    recording, matches = room
    for delay_s, word in ((0.04, "late"), (-0.04, "early")):
        evidence = Evidence(Altered(recording, poses=late_by(delay_s)), matches, None)
        assert check_matches(evidence).verdict == "agree"
        found = small_delay(evidence)
        assert found is not None
        named = re.fullmatch(rf"--fix-poses {word}:(0\.\d\d)s", found[1])
        assert named and float(named[1]) == pytest.approx(0.04, abs=0.015)
        assert found[0] == f"poses {word} by {named[1]} s"


def test_check_and_build_warn_of_a_small_delay(room: tuple[Recording, Matches]) -> None:
    altered = Altered(room[0], poses=late_by(0.04))
    (found,) = [finding for finding in inspect_recording(altered).findings if finding.name == "pose times"]
    assert found.level == "warning"
    assert re.fullmatch(r"poses late by 0\.0\d s", found.value)
    assert re.fullmatch(r"give --fix-poses late:0\.0\ds", found.remark)
    assert f"{found.value}, by the corners; {found.remark}" in check_recording(altered, None, BuildConfig())


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
def test_right_poses_have_no_delay(room: tuple[Recording, Matches], noise_m: float) -> None:
    recording, matches = room
    evidence = Evidence(with_noise(recording, noise_m), matches, None)
    explanation = check_matches(evidence).explanation
    assert small_delay(evidence) is None and explanation is None


@pytest.mark.parametrize(
    "given", ["opengl", "world-to-camera", "left-handed", "millimetres", "w-first", "late:4", "late:0.3s"]
)
def test_a_fix_that_a_right_recording_did_not_need_is_to_be_left_out(
    room: tuple[Recording, Matches], given: str
) -> None:
    line = refusal(check_poses(Selection(corrected(room[0], Fixes(poses=given)), range(50))))
    assert re.fullmatch(rf".*% as they are stored; leave out --fix-poses {given}", line)


@pytest.mark.parametrize(
    ("poses", "words", "left_out"),
    [
        (None, "the depth is stored", "--fix-depth turned-180"),
        ("opengl", "poses and depth are stored", "--fix-depth turned-180 and --fix-poses opengl"),
    ],
)
def test_a_fix_of_the_depth_that_a_right_recording_did_not_need_is_to_be_left_out(
    poses: str | None, words: str, left_out: str
) -> None:
    given = corrected(open_recording(f"folder:{BUILD}"), Fixes(poses, "turned-180"))
    line = refusal(check_poses(Selection(given, range(0, 150, 3))))
    assert re.fullmatch(rf".*% as {words}; leave out {left_out}", line)


@pytest.mark.parametrize(
    ("name", "given", "fix"),
    [("robot", "opengl", "robot in place of opengl"), ("COLMAP", "w-first", "w-first,world-to-camera")],
)
def test_a_fix_is_named_in_place_of_or_after_the_one_that_was_given(
    room: tuple[Recording, Matches], name: str, given: str, fix: str
) -> None:
    recording, matches = room
    assert recording.poses is not None
    stored = Altered(recording, poses=POSES[name].poses(recording.poses))
    assert refusal(checked(corrected(stored, Fixes(poses=given)), matches)).endswith(f"; give --fix-poses {fix}")


def test_one_pose_for_all_frames_is_refused(room: tuple[Recording, Matches]) -> None:
    recording, matches = room
    assert recording.poses is not None
    line = refusal(checked(Altered(recording, poses=np.repeat(recording.poses[:1], len(recording), axis=0)), matches))
    assert "motions correlate by 0.00" in line and "check the poses' convention" in line


@pytest.mark.parametrize(("turn_rad", "offset_m"), [(0.7, (0.8, 0.0, 0.5)), (0.0, (0.2, 0.0, 0.0))])
def test_poses_that_go_on_in_another_world_give_a_warning_that_names_the_frame(
    room: tuple[Recording, Matches], turn_rad: float, offset_m: tuple[float, float, float]
) -> None:
    """As where tracking was lost; between all other frames, these poses agree with the images."""
    recording, _ = room
    assert recording.poses is not None
    poses = recording.poses.copy()
    poses[30:] = make_pose(so3_exp(np.array([0.0, turn_rad, 0.0])), np.array(offset_m)) @ poses[30:]
    wrong = Altered(recording, poses=poses)
    for frames in (range(60), range(0, 60, 3)):
        check = check_poses(Selection(wrong, frames))
        (warning,) = require_agreement("walk", check, poses_are_refined=False)
        names = f"from frame {recording.frame_names[29]} to {recording.frame_names[30]}"
        assert names in warning and "give --frames :30 or 30:" in warning
    assert check_poses(Selection(wrong, range(30))).jumps == ()


@pytest.mark.parametrize("factor", [0.001, 0.2, 1.4, 5.0, 1000.0])
def test_depth_of_another_scale_is_named(room: tuple[Recording, Matches], factor: float) -> None:
    """Metres that are read as millimetres too, which positions in millimetres would fit as well."""
    recording, matches = room
    line = refusal(checked(Altered(recording, depth=lambda depth: depth * factor), matches))
    found = re.fullmatch(
        r".* differ by a factor of ([\d.]+) \(to 2%\); give --fix-poses scaled:([\d.]+) if the .*", line
    )
    assert found, line
    assert float(found[1]) == pytest.approx(max(factor, 1.0 / factor), rel=0.05)
    assert float(found[2]) == pytest.approx(factor, rel=0.05)


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_another_focal_length_is_named(room: tuple[Recording, Matches], factor: float) -> None:
    recording, matches = room
    right = recording.camera.focal_px
    camera = with_focal(recording.camera, factor)
    matches = replace(matches, camera=with_focal(matches.camera, factor))
    line = refusal(checked(Altered(recording, camera=camera), matches))
    found = re.fullmatch(r".* as a focal length of (\d+) px .*; give --camera \d+,\d+,([\d.]+),.*", line)
    assert found, line
    assert float(found[1]) == pytest.approx(right, rel=0.06)
    assert float(found[2]) == pytest.approx(recording.camera.fx, rel=0.06)


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_intrinsics_of_another_image_size_are_named(room: tuple[Recording, Matches], factor: float) -> None:
    """As of images that were resized after the camera was calibrated."""
    recording, matches = room

    def of_another_size(camera: Camera) -> Camera:
        cx, cy = (factor * (value + 0.5) - 0.5 for value in (camera.cx, camera.cy))
        return replace(with_focal(camera, factor), cx=cx, cy=cy)

    right = recording.camera
    matches = replace(matches, camera=of_another_size(matches.camera))
    line = refusal(checked(Altered(recording, camera=of_another_size(right)), matches))
    found = re.fullmatch(r".* as intrinsics of images ([\d.]+) times as large.*; give --camera (.*)", line)
    assert found, line
    assert float(found[1]) == pytest.approx(factor, rel=0.06)
    named = [float(value) for value in found[2].split(",")]
    assert named == pytest.approx([right.width, right.height, right.fx, right.fy, right.cx, right.cy], rel=0.06)


def test_named_intrinsics_are_those_of_the_stored_images(room: tuple[Recording, Matches]) -> None:
    """Of a phone in portrait, before the images are turned upright: --camera is of these."""
    right = room[0].camera
    wrong = Altered(room[0], camera=with_focal(right, 1.3))
    line = refusal(check_poses(Turned(wrong, 1)))
    named = [float(value) for value in line.partition("give --camera ")[2].split(",")]
    assert named == pytest.approx([right.width, right.height, right.fx, right.fy, right.cx, right.cy], rel=0.06)


def test_images_upside_down_are_named(room: tuple[Recording, Matches]) -> None:
    """Turned by software, with depth and poses as they were, or the camera with its depth."""
    recording, _ = room
    line = refusal(check_poses(Altered(recording, color=upside_down)))
    assert line.endswith("; give --fix-depth turned-180 --fix-poses turned-180") and "images upside down" in line
    line = refusal(check_poses(Altered(recording, color=upside_down, depth=upside_down)))
    assert line.endswith("; give --fix-poses turned-180")


@pytest.mark.slow
def test_noisy_poses_give_a_warning_and_unrelated_poses_are_refused(room: tuple[Recording, Matches]) -> None:
    recording, matches = room
    assert recording.poses is not None
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(len(recording), 6)) * np.repeat([0.01, np.deg2rad(0.5)], 3)
    noisy = checked(Altered(recording, poses=recording.poses @ se3_exp(noise)), matches)
    assert noisy.verdict in ("agree", "doubtful")
    assert len(require_agreement("walk", noisy, poses_are_refined=False)) == (noisy.verdict == "doubtful")
    other = recording.poses[rng.permutation(len(recording))]
    check = checked(Altered(recording, poses=other), matches)
    line = refusal(check)
    assert re.search(r"by their own motion, and motions correlate by -?0\.\d\d\); check the poses", line)
    assert require_agreement("walk", check, poses_are_refined=True) == []  # refinement starts from any


@pytest.mark.slow
def test_poses_with_a_cloud_in_place_of_depth(room: tuple[Recording, Matches]) -> None:
    recording, _ = room
    cloud = Room().cloud(0.04)
    assert compare_poses(Altered(recording, has_depth=False), cloud)[0].verdict == "agree"
    assert recording.poses is not None
    wrong = Altered(recording, poses=POSES["OpenGL"].poses(recording.poses), has_depth=False)
    assert refusal(compare_poses(wrong, cloud)[0]).endswith("; give --fix-poses opengl")


def test_noisy_poses_without_depth_are_not_to_be_refined(
    room: tuple[Recording, Matches], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only depth can refine them."""
    doubtful = PoseCheck("doubtful", 20, 900, 0.4, 0.1, 0.8)
    monkeypatch.setattr("monoloc.builder.checks.compare_poses", lambda recording, cloud: (doubtful, None))
    for has_depth, advice in ((True, "--refine-poses may help"), (False, doubtful.fix)):
        recording = Selection(Altered(room[0], has_depth=has_depth), np.arange(4))
        warnings = check_recording(recording, Room().cloud(0.04), BuildConfig())
        assert any(re.fullmatch(rf"poses fit the images poorly: .*; {advice}", each) for each in warnings)


def test_poses_that_see_nothing_of_the_cloud_are_named(room: tuple[Recording, Matches]) -> None:
    """Of millimetres, no frame is in the room."""
    recording, _ = room
    assert recording.poses is not None
    wrong = Altered(recording, poses=POSES["millimetres"].poses(recording.poses), has_depth=False)
    inspection = inspect_recording(wrong, Room().cloud(0.04))
    (finding,) = [each for each in inspection.findings if each.name == "poses"]
    assert (finding.level, finding.value) == ("bad", "0 pairs of frames see the cloud")
    assert re.fullmatch(
        r"\d% of the corners' motion off as millimetres; give --fix-poses millimetres", finding.remark
    )
    assert inspection.poses is not None
    with pytest.raises(DataError, match=r"^walk: .* 0 pairs .* see the cloud; .*; give --fix-poses millimetres$"):
        require_agreement("walk", inspection.poses, poses_are_refined=False)


def test_cloud_in_another_frame_is_not_to_be_mended_by_more_frames(room: tuple[Recording, Matches]) -> None:
    recording = Altered(room[0], has_depth=False)
    check = compare_poses(recording, Room().cloud(0.04) + np.array([50.0, 0.0, 0.0]))[0]
    (warning,) = require_agreement("walk", check, poses_are_refined=False)
    assert warning.endswith(" 0 pairs of frames see the cloud; give poses and cloud in one frame, in metres")


def test_delay_counts_frames_of_the_whole_recording() -> None:
    """Where every third frame is selected, poses late by two frames are no whole number of selected frames late."""
    recording = RoomRecording(Room(), turning_path(90), SMALL_CAMERA)
    assert recording.poses is not None
    recording.poses = late(recording.poses, 2)
    check = check_poses(Selection(recording, range(0, 90, 3)))
    assert refusal(check).endswith("; give --fix-poses late:2")


def test_scale_and_axes_together_are_named(room: tuple[Recording, Matches]) -> None:
    """As from structure from motion with OpenGL's axes."""
    recording, matches = room
    assert recording.poses is not None
    poses = POSES["OpenGL"].poses(recording.poses)
    poses[:, :3, 3] *= 3.7
    line = refusal(checked(Altered(recording, poses=poses), matches))
    assert re.search(r"; give --fix-poses opengl,scaled:0\.27\d? if the depth is right", line), line


def test_too_little_motion_is_not_judged_and_a_build_says_so() -> None:
    still = np.repeat(make_path(1), 30, axis=0)
    check = check_poses(RoomRecording(Room(), still, SMALL_CAMERA))
    assert check.verdict == "unknown"
    (warning,) = require_agreement("walk", check, poses_are_refined=False)
    assert "not compared with the images: 0 pairs of frames show corners that move" in warning
    assert "give more frames" in warning


def test_range_leaves_the_pose_check_silent(room: tuple[Recording, Matches]) -> None:
    """Its effect on corners is as small as that of noisy poses: planes tell it (test_depth_check.py)."""
    recording, matches = room
    assert checked(Altered(recording, depth=range_of(recording)), matches).verdict == "agree"


def test_fixed_recording_agrees(room: tuple[Recording, Matches]) -> None:
    recording, _ = room
    assert recording.poses is not None
    wrong = Altered(recording, poses=late(POSES["COLMAP"].poses(recording.poses), 4))
    fixed = corrected(wrong, Fixes(poses="w-first,world-to-camera,late:4"))
    assert len(fixed) == 56 and fixed.frame_names == recording.frame_names[:56]
    assert check_poses(fixed).verdict == "agree"


@pytest.mark.parametrize(
    "folder",
    [
        pytest.param(BUILD, id="build"),
        *(
            pytest.param(folder, id=light, marks=[pytest.mark.slow] if light != "L3" else [])
            for light, folder in TESTS.items()
        ),
    ],
)
def test_living_room_is_not_doubted(folder: Path) -> None:
    assert check_poses(open_recording(str(folder))).verdict == "agree"
