"""Depth that is range, or not registered to the images, is recognised; other depth is not doubted."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from altered_recordings import Altered, range_of
from monoloc.errors import DataError
from monoloc.geometry import invert
from monoloc.io.corrected import Fixes, corrected
from monoloc.io.registration import DepthRegistration
from monoloc.io.registry import open_recording, select_frames
from monoloc.io.seven_scenes import T_COLOR_DEPTH
from monoloc.recording_check.depth_check import check_depth, mean_correlation, require_registered_z, spectrum
from monoloc_lab.rooms import BUILD
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


@pytest.fixture(scope="module")
def right() -> RoomRecording:
    return RoomRecording(Room(), make_path(24, rate_hz=3.0), SMALL_CAMERA)


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
    require_registered_z("walk", check)


def test_range_is_named_and_fixed(right: RoomRecording) -> None:
    wrong = Altered(right, depth=range_of(right))
    with pytest.raises(
        DataError, match=r"^walk: depth is distance .* instead of z: planes .*; give --fix-depth range"
    ):
        require_registered_z("walk", check_depth(wrong))
    fixed = corrected(wrong, Fixes(depth="range"))
    np.testing.assert_allclose(fixed.depth(3), right.depth(3), rtol=1e-5)
    assert check_depth(fixed).problem is None


@pytest.mark.slow
def test_depth_of_another_camera_is_not_registered() -> None:
    """In the rendered living room, whose surfaces have edges where depth has them."""
    living = select_frames(open_recording(str(BUILD)), "::3")
    assert check_depth(living).problem is None
    longer = replace(living.camera, fx=1.12 * living.camera.fx, fy=1.12 * living.camera.fy)
    to_depth_camera = DepthRegistration(living.camera, longer, invert(T_COLOR_DEPTH))
    check = check_depth(Altered(living, depth=to_depth_camera))
    assert check.zoom == pytest.approx(1.0 / 1.12, abs=0.021)
    with pytest.raises(
        DataError, match=r"^walk: depth is not registered to the images: its edges fit 0\.(88|89|90|91) "
    ):
        require_registered_z("walk", check)


def test_depth_without_edges_or_pixels_is_not_judged(right: RoomRecording) -> None:
    check = check_depth(Altered(right, depth=np.zeros_like))
    assert (check.coverage, check.flatness, check.edges, check.problem) == (0.0, None, None, None)
