"""Depth that is range, or not registered to the images, is recognised; other depth is not doubted."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from altered_recordings import Altered, Image, range_of
from monoloc.geometry import invert
from monoloc.io.corrected import Fixes, corrected
from monoloc.io.recording import Selection
from monoloc.io.registration import DepthRegistration
from monoloc.io.registry import open_recording, select_frames
from monoloc.io.seven_scenes import T_COLOR_DEPTH
from monoloc.recording_check.depth_check import DepthCheck, check_depth, front_edges, mean_correlation, spectrum
from monoloc.recording_check.inspection import inspect_recording
from monoloc_lab.rooms import BUILD
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


def test_correlation_with_edges_is_the_mean_of_template_matches() -> None:
    rng, search_px = np.random.default_rng(0), 16
    images, weights = (rng.uniform(0.0, 4.0, (3, 48, 64)).astype(np.float32) for _ in range(2))
    wide = [np.pad(image, search_px, mode="edge") for image in images]
    found = mean_correlation([spectrum(image, (48, 64)) for image in wide], list(weights))
    expected = np.mean([cv2.matchTemplate(*pair, cv2.TM_CCORR) for pair in zip(wide, weights, strict=True)], axis=0)
    assert found.shape == expected.shape == (33, 33)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_right_depth_is_not_doubted(right: RoomRecording) -> None:
    check = check_depth(right)
    assert check.problem is None and check.coverage == 1.0 and 1.0 < check.median_m < 4.0
    assert check.flatness is not None and check.flatness < 1.0


def test_one_view_is_not_certain_where_several_views_are() -> None:
    """Its edges fit its image nearby by chance; that depth is range, one view tells as well as many."""
    check = DepthCheck(1.0, 2.0, 0.5, 1.2, "moved by (-8, 2) pixels", has_few_views=True)
    problem = "depth is not registered to the images: its edges fit moved by (-8, 2) pixels"
    by_chance = f"{problem}, perhaps by chance, as the camera hovers in one view"
    assert (check.is_certain, check.problem) == (False, by_chance)
    several = replace(check, has_few_views=False)
    assert (several.is_certain, several.problem) == (True, problem)
    assert replace(check, fix="range").is_certain


@pytest.mark.parametrize(("side_m", "hovers"), [(0.05, True), (1.0, False)])
def test_a_camera_that_hovers_has_few_views(side_m: float, hovers: bool) -> None:
    poses = np.tile(make_path(1), (8, 1, 1))
    poses[:, 0, 3] += np.linspace(0.0, side_m, 8)
    assert check_depth(RoomRecording(Room(), poses, SMALL_CAMERA)).has_few_views is hovers


def test_depth_without_a_value_is_certain(right: RoomRecording) -> None:
    empty = Altered(right, depth=np.zeros_like)
    check = check_depth(empty)
    assert (check.coverage, check.flatness, check.edges, check.fix) == (0.0, None, None, None)
    assert check.is_certain and check.problem == "no pixel has depth"
    assert check.remedy.startswith("record within the sensor's range")
    depth = next(each for each in inspect_recording(empty).findings if each.name == "depth")
    assert (depth.level, depth.value) == ("bad", "0% of pixels")


def test_depth_along_z_that_is_taken_for_range_is_named(right: RoomRecording) -> None:
    wrong = Selection(corrected(right, Fixes(depth="range")), range(len(right)))
    check = check_depth(wrong)
    problem = r"depth is z already: planes are [\d.]+ times as flat without --fix-depth range"
    assert check.is_certain and re.fullmatch(problem, check.problem or "")
    assert check.remedy == "leave out --fix-depth range"


def test_range_is_named_and_fixed(right: RoomRecording) -> None:
    wrong = Altered(right, depth=range_of(right))
    check = check_depth(wrong)
    assert check.is_certain and re.match(r"depth is distance .* instead of z: planes ", check.problem or "")
    assert check.remedy == "give --fix-depth range"
    fixed = corrected(wrong, Fixes(depth="range"))
    np.testing.assert_allclose(fixed.depth(3), right.depth(3), rtol=1e-5)
    assert check_depth(fixed).problem is None


def test_depth_that_was_computed_from_the_images_is_not_compared_with_them(right: RoomRecording) -> None:
    """Its edges lie where there is texture: of a desk, they fitted 1.65 times as wide."""
    computed = Altered(right, depth=range_of(right))
    computed.scale_sd = 0.02
    check = check_depth(computed)
    assert check.problem is None and check.coverage == 1.0
    assert (check.flatness, check.edges, check.misfit, check.fix) == (None, None, None, None)


@pytest.mark.slow
@pytest.mark.parametrize("focal", [1.12, 0.65], ids=["Kinect", "wide stereo camera"])
def test_depth_of_another_camera_is_not_registered(focal: float) -> None:
    """In the rendered living room, whose surfaces have edges where depth has them."""
    living = select_frames(open_recording(str(BUILD)), "::3")
    assert check_depth(living).problem is None
    other = replace(living.camera, fx=focal * living.camera.fx, fy=focal * living.camera.fy)
    to_depth_camera = DepthRegistration(living.camera, other, invert(T_COLOR_DEPTH))
    check = check_depth(Altered(living, depth=to_depth_camera))
    assert check.zoom == pytest.approx(1.0 / focal, rel=0.025)
    fit = f"its edges fit {check.zoom:.2f} "
    assert check.is_certain and re.match(rf"depth is not registered to .*: {fit}", check.problem or "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("depth", "misfit", "remedy"),
    [
        (lambda depth: depth[:, ::-1], "mirrored", "store depth and colour images the same way around"),
        (lambda depth: depth[::-1], "mirrored top to bottom", "store depth and colour images the same way around"),
        (
            lambda depth: np.pad(depth, ((0, 0), (12, 0)))[:, :-12],
            r"moved by \(-1[1-3], [-0-9]+\) pixels",
            "align depth to .*",
        ),
    ],
    ids=["mirrored", "flipped", "shifted"],
)
def test_depth_that_is_moved_against_the_images_is_not_registered(
    depth: Callable[[Image], Image], misfit: str, remedy: str
) -> None:
    living = select_frames(open_recording(str(BUILD)), "::3")
    check = check_depth(Altered(living, depth=depth))
    assert check.is_certain and re.fullmatch(remedy, check.remedy)
    assert re.fullmatch(rf"depth is not registered to .*: its edges fit {misfit}", check.problem or "")


def test_edges_are_those_of_what_is_in_front_also_beside_narrow_holes() -> None:
    depth = np.full((8, 100), 2.0, dtype=np.float32)
    depth[:, 40:60] = 1.0
    depth[2, 60:62] = 0.0  # no wider than 2 % of the width
    depth[3, 60:65] = 0.0
    found = {(x, y) for x, y in front_edges(depth).tolist()}
    assert found == {(40, y) for y in range(8)} | {(59, y) for y in range(8) if y != 3}
