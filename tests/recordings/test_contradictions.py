"""Recordings of real rooms that contradict themselves are refused by what they would fit as; right ones are not."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from altered_recordings import POSES, Altered, Image, checked, range_of, refusal, upside_down, with_focal, with_noise
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.checks import check_recording
from monoloc.cli.pose_warning import warn_of_poses
from monoloc.io.corrected import Fixes, corrected
from monoloc.io.pose_files import interpolate_poses
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Recording, Selection
from monoloc.io.registry import open_recording, select_frames
from monoloc.recording_check.correspondences import Matches, match_corners
from monoloc.recording_check.depth_check import check_depth
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.explanations import small_delay
from monoloc.recording_check.lens_check import check_factors
from monoloc.recording_check.pose_check import check_matches, check_poses, compare_poses, require_agreement

KITCHEN, DESK = "7scenes/redkitchen", "office-desk"
PARTS = ((KITCHEN, "0:300:3"), (KITCHEN, "::4"), (DESK, "0:350:7"), (DESK, "0:350:2"))


def opened(data_root: Path, folder: str, frames: str, depth_scale: float | None = None) -> Selection:
    if not (data_root / folder).is_dir():
        pytest.skip(f"no recording at {data_root / folder}")
    return select_frames(open_recording(str(data_root / folder), ReaderOptions(depth_scale=depth_scale)), frames)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param((KITCHEN, "200:400:2"), id="kitchen", marks=pytest.mark.slow),
        pytest.param((DESK, "0:350:2"), id="desk"),
    ],
)
def room(request: pytest.FixtureRequest, data_root: Path) -> tuple[Recording, Matches]:
    recording = opened(data_root, *request.param)
    return recording, match_corners(recording)


@pytest.mark.parametrize(
    ("folder", "frames"),
    [
        (KITCHEN, "::4"),
        *(
            pytest.param(folder, frames, marks=pytest.mark.slow)
            for folder, all_frames in (
                (KITCHEN, ("::", "::3", "::12", "0:400:16", "200:", "0:100", "300:")),
                (DESK, ("350:", "::", "::4", "::14")),
            )
            for frames in all_frames
        ),
    ],
)
def test_right_recordings_are_not_doubted(
    data_root: Path, capfd: pytest.CaptureFixture[str], folder: str, frames: str
) -> None:
    recording = opened(data_root, folder, frames)
    check, evidence = compare_poses(recording, None)
    assert evidence is not None and small_delay(evidence) is None
    assert check.verdict == "agree" and require_agreement("walk", check, poses_are_refined=False) == []
    depth = check_depth(recording)
    assert depth.problem is None, depth
    warn_of_poses(recording)  # by fewer pairs of frames
    assert capfd.readouterr().err == ""


# Of each kind of change one by day: the axes, the matrix, the scale and the time.
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in ("OpenGL", "COLMAP", "centimetres", "late") else [pytest.mark.slow])
        for name in POSES
    ],
)
def test_poses_of_another_convention_are_named(room: tuple[Recording, Matches], name: str) -> None:
    recording, matches = room
    assert recording.poses is not None
    check = checked(Altered(recording, poses=POSES[name].poses(recording.poses)), matches)
    assert re.fullmatch(f".* as [^;]*{POSES[name].words}.*; give {POSES[name].option}", refusal(check))


@pytest.mark.parametrize("delay_s", [0.05, -0.05, 0.1, pytest.param(-0.1, marks=pytest.mark.slow), 0.2])
def test_delays_are_found_to_a_fiftieth_of_a_second(room: tuple[Recording, Matches], delay_s: float) -> None:
    """Poses of a time before their frames, between those of two; small ones are a warning."""
    selected, matches = room
    assert isinstance(selected, Selection) and selected.source.poses is not None
    source, times_s = selected.source, selected.source.timestamps_s
    _, poses = interpolate_poses(times_s - delay_s, times_s, selected.source.poses, np.inf)
    evidence = Evidence(Selection(Altered(source, poses=poses), selected.positions), matches, None)
    explanation, small = check_matches(evidence).explanation, small_delay(evidence)
    option = explanation.option if explanation is not None else "" if small is None else small[1]
    found = re.fullmatch(r"--fix-poses (late|early):([\d.]+)(s?)", option)
    assert found, option
    found_s = float(found[2]) * (1.0 if found[3] else evidence.frame_interval_s)
    assert found_s * (1.0 if found[1] == "late" else -1.0) == pytest.approx(delay_s, abs=0.02)


@pytest.mark.parametrize("noise_m", [0.01, pytest.param(0.02, marks=pytest.mark.slow), 0.03])
def test_noisy_poses_have_no_delay(room: tuple[Recording, Matches], noise_m: float) -> None:
    recording, matches = room
    evidence = Evidence(with_noise(recording, noise_m), matches, None)
    assert small_delay(evidence) is None and check_matches(evidence).explanation is None


@pytest.mark.slow  # tests/unit/recording_check/test_pose_check.py has it in a synthetic room
@pytest.mark.parametrize(("said", "right"), [(1000.0, 5000.0), (5000.0, 1000.0)])
def test_depth_scale_is_named_with_its_value(data_root: Path, said: float, right: float) -> None:
    """The depth of the kitchen, stored as ``right`` to the metre and read as ``said``."""
    whole = open_recording(str(data_root / KITCHEN))
    whole.depth_scale *= said / right  # type: ignore[attr-defined]
    line = refusal(check_poses(select_frames(whole, "::2")))
    stored = 1000  # of these files
    assert re.search(
        rf"factor of [45]\.\d+ \(to [23]%\); give --depth-scale {stored} if the poses are right, or --fix", line
    ), line


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_another_focal_length_is_named(room: tuple[Recording, Matches], factor: float) -> None:
    recording, matches = room
    camera = with_focal(recording.camera, factor)
    matches = replace(matches, camera=with_focal(matches.camera, factor))
    line = refusal(checked(Altered(recording, camera=camera), matches))
    found = re.search(r" as a focal length of (\d+) px .*; give --camera 640,480,([\d.]+),", line)
    assert found and float(found[2]) == pytest.approx(recording.camera.fx, rel=0.06), line


@pytest.mark.parametrize(("factor", "names"), [(1.0, []), (1.1, ["focal length by the corners"])])
def test_a_build_warns_of_a_focal_length_that_is_slightly_off(
    data_root: Path, factor: float, names: list[str]
) -> None:
    desk = opened(data_root, DESK, "0:350:2")
    altered = Altered(desk, camera=with_focal(desk.camera, factor))
    assert [line.split(":")[0] for line in check_recording(altered, None, BuildConfig())] == names


@pytest.mark.parametrize(
    ("folder", "frames"),
    [(KITCHEN, "::"), (DESK, "::"), *(pytest.param(*part, marks=pytest.mark.slow) for part in PARTS)],
)
@pytest.mark.parametrize(
    ("stated", "is_doubted"),
    [(1000.0, False), (1080.0, True), *(pytest.param(far, True, marks=pytest.mark.slow) for far in (900.0, 1150.0))],
)
def test_a_scale_that_is_8_percent_off_is_doubted_at_any_frame_rate(
    data_root: Path, folder: str, frames: str, stated: float, is_doubted: bool
) -> None:
    check, evidence = compare_poses(opened(data_root, folder, frames, depth_scale=stated), None)
    if check.verdict == "explained":
        assert is_doubted and "give --depth-scale 1000 if" in check.fix
        return
    assert evidence is not None
    doubts = [f"{found.value}; {found.remark}" for found in check_factors(evidence) if found.remark]
    assert any("times as far as the poses say" in doubt for doubt in doubts) == is_doubted, doubts


@pytest.mark.slow  # tests/unit/recording_check/test_pose_check.py has them in a synthetic room
def test_images_upside_down_are_named(room: tuple[Recording, Matches]) -> None:
    line = refusal(check_poses(Altered(room[0], color=upside_down)))
    assert line.endswith("; give --fix-depth turned-180 --fix-poses turned-180")


def test_range_is_named(room: tuple[Recording, Matches]) -> None:
    check = check_depth(Altered(room[0], depth=range_of(room[0])))
    assert check.problem is not None and check.problem.startswith("depth is distance from the camera instead of z")
    assert check.remedy == "give --fix-depth range"


def test_z_that_is_taken_for_range_is_named(room: tuple[Recording, Matches]) -> None:
    check = check_depth(corrected(room[0], Fixes(depth="range")))
    assert check.problem is not None and check.problem.startswith("depth is z already")


def test_depth_of_one_view_is_not_doubted(data_root: Path) -> None:
    """The edges of one view fit those of its image by chance; these were refused as 0.94 times as wide."""
    assert check_depth(opened(data_root, DESK, "0:15")).problem is None


@pytest.mark.parametrize(
    ("depth", "misfit"),
    [
        (lambda depth: depth[:, ::-1], "mirrored"),
        (lambda depth: np.pad(depth, ((0, 0), (30, 0)))[:, :-30], "moved by (-28, -6) pixels"),
    ],
    ids=["mirrored", "shifted"],
)
def test_depth_that_is_moved_is_not_registered(data_root: Path, depth: Callable[[Image], Image], misfit: str) -> None:
    check = check_depth(Altered(opened(data_root, DESK, "::"), depth=depth))
    assert check.misfit == misfit


def test_unregistered_depth_is_named_and_fixed(data_root: Path, tmp_path: Path) -> None:
    """The kitchen's stored depth, in a recording that says that it is registered."""
    kitchen = open_recording(str(data_root / KITCHEN))
    kitchen.registration, kitchen.folder = None, tmp_path  # type: ignore[attr-defined]
    recording = select_frames(kitchen, "::4")
    check = check_depth(recording)
    assert check.fix == "kinect" and check.remedy == "give --fix-depth kinect"
    assert check.problem is not None and "not registered to the colour camera of a Kinect" in check.problem
    assert check_depth(corrected(recording, Fixes(depth="kinect"))).problem is None


def test_own_camera_in_the_layout_of_7_scenes_is_named_and_fixed(data_root: Path, tmp_path: Path) -> None:
    desk = opened(data_root, DESK, "0:120:2")
    assert desk.poses is not None
    folder = tmp_path / "seq-01"
    folder.mkdir()
    for index in range(len(desk)):
        stem = folder / f"frame-{index:06d}"
        position = int(desk.positions[index])
        shutil.copy(data_root / DESK / f"color/{position:04d}.jpg", f"{stem}.color.jpg")
        shutil.copy(data_root / DESK / f"depth/{position:04d}.png", f"{stem}.depth.png")
        np.savetxt(f"{stem}.pose.txt", desk.poses[index])
    assert cv2.imread(f"{stem}.color.jpg") is not None
    recording = open_recording(f"7scenes:{tmp_path}")
    line = refusal(check_poses(recording))
    found = re.search(r"a camera of your own.*; give --fix-depth registered --camera 640,480,([\d.]+),", line)
    assert found and float(found[1]) == pytest.approx(desk.camera.fx, rel=0.06), line
    fixed = corrected(recording, Fixes(depth="registered"))
    assert fixed.poses is not None
    np.testing.assert_allclose(fixed.poses, desk.poses, atol=1e-6)
    np.testing.assert_array_equal(fixed.depth(0), desk.depth(0))
