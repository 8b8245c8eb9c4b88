"""The rendered living room of the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.bundle import read_bundle
from monoloc.errors import BundleError
from monoloc.geometry import rotation_angle
from monoloc.io.registry import open_recording
from monoloc_lab.rooms import BUILD, BUNDLE, TESTS

LARGEST_BYTES = 8_000_000
LARGEST_BUNDLE_BYTES = 2_500_000


def test_room_is_small_and_complete() -> None:
    files = [file for flight in (BUILD.parent, TESTS["L1"].parent) for file in flight.rglob("*") if file.is_file()]
    assert sum(file.stat().st_size for file in files) < LARGEST_BYTES
    build = open_recording(f"folder:{BUILD}")
    assert len(build) >= 100 and build.has_depth
    assert list(TESTS) == ["L1", "L2", "L3"]
    for folder in TESTS.values():
        recording = open_recording(f"folder:{folder}")
        assert len(recording) >= 100 and recording.camera == build.camera and recording.has_depth
        for index in (0, len(recording) - 1):
            recording.color(index), recording.depth(index)


def test_test_flight_differs_from_the_build_flight_and_has_three_lights() -> None:
    build = open_recording(f"folder:{BUILD}")
    tests = [open_recording(f"folder:{folder}") for folder in TESTS.values()]
    assert build.poses is not None and tests[0].poses is not None
    for recording in tests[1:]:
        np.testing.assert_array_equal(recording.poses, tests[0].poses)
    distance_m = np.linalg.norm(tests[0].poses[:, None, :3, 3] - build.poses[None, :, :3, 3], axis=2)
    turned = rotation_angle(np.swapaxes(build.poses[None, :, :3, :3], -1, -2) @ tests[0].poses[:, None, :3, :3])
    # Decimetres from the build cameras, with a similar view.
    assert 0.2 < np.median(distance_m.min(axis=1)) < 1.5
    assert np.median(np.where(distance_m < 1.2, turned, np.inf).min(axis=1)) < np.deg2rad(45.0)
    brightness = [np.mean([recording.color(i).mean() for i in range(0, 100, 10)]) for recording in tests]
    assert brightness[0] > brightness[1] > 1.6 * brightness[2]


def test_shipped_bundle_is_of_this_version_and_of_the_build_flight() -> None:
    try:
        bundle = read_bundle(BUNDLE)
    except BundleError as error:
        pytest.fail(f"{error}: run make demo-bundle")
    build = open_recording(f"folder:{BUILD}")
    assert len(bundle.provenance.frames) == (len(build) + 1) // 2 and bundle.provenance.tune == "all"
    assert sum(file.stat().st_size for file in BUNDLE.iterdir()) < LARGEST_BUNDLE_BYTES
    text = (BUNDLE / "manifest.json").read_text()
    assert str(BUNDLE.parent) not in text and str(Path.home()) not in text
