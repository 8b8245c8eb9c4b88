"""The room that comes with monoloc, and the demo on it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from monoloc.cli.main import invoke
from monoloc.geometry import rotation_angle
from monoloc.io.registry import open_recording
from monoloc_lab.rooms import BUILD, TESTS

LARGEST_BYTES = 8_000_000
LIGHTS = ["L1", "L2", "L3"]


def test_embedded_room_is_small_and_whole():
    files = [file for file in BUILD.parents[1].rglob("*") if file.is_file()]
    assert sum(file.stat().st_size for file in files) < LARGEST_BYTES
    build = open_recording(f"folder:{BUILD}")
    assert len(build) >= 100 and build.has_depth
    assert list(TESTS) == LIGHTS
    for folder in TESTS.values():
        recording = open_recording(f"folder:{folder}")
        assert len(recording) >= 100 and recording.camera == build.camera and recording.has_depth
        for index in (0, len(recording) - 1):
            recording.color(index), recording.depth(index)


def test_the_test_flight_is_another_one_and_its_lights_are_three():
    build = open_recording(f"folder:{BUILD}")
    tests = [open_recording(f"folder:{folder}") for folder in TESTS.values()]
    assert build.poses is not None and tests[0].poses is not None
    for recording in tests[1:]:
        np.testing.assert_array_equal(recording.poses, tests[0].poses)
    apart = np.linalg.norm(tests[0].poses[:, None, :3, 3] - build.poses[None, :, :3, 3], axis=2)
    turned = rotation_angle(np.swapaxes(build.poses[None, :, :3, :3], -1, -2) @ tests[0].poses[:, None, :3, :3])
    # Decimetres from any build view, but in view of the same room.
    assert 0.2 < np.median(apart.min(axis=1)) < 1.5
    assert np.median(np.where(apart < 1.2, turned, np.inf).min(axis=1)) < np.deg2rad(45.0)
    brightness = [np.mean([recording.color(i).mean() for i in range(0, 100, 10)]) for recording in tests]
    assert brightness[0] > brightness[1] > 1.6 * brightness[2]


@pytest.mark.slow
def test_demo_on_the_embedded_room(tmp_path: Path, capfd):
    assert invoke(["demo", "--out", str(tmp_path / "out"), "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert [(run["light"], run["adapted"]) for run in told["runs"]] == [(n, a) for n in LIGHTS for a in (False, True)]
    assert told["seconds"] > 0.0
    for run in told["runs"]:
        assert run["frames"] == run["unseen_frames"] >= 100
        assert {"name", "ate_median_m", "rot_median_deg", "step_ms_median", "lost_frames", "depth_absrel"} <= set(run)
        stem = tmp_path / "out" / run["name"].replace(" ", "-")
        assert stem.with_suffix(".png").is_file() and stem.with_suffix(".txt").is_file()
    assert (tmp_path / "out" / "adapted.monoloc").is_dir()
    # Half was seen, over two builds and three starts each; 0.65 at worst in one light.
    unadapted, adapted = (
        np.array([r["ate_median_m"] for r in told["runs"] if r["adapted"] == a]) for a in (False, True)
    )
    assert np.all(adapted < unadapted) and adapted.mean() < 0.75 * unadapted.mean()
    for run in told["runs"]:
        # 0.64 to 0.70.
        assert not run["adapted"] or run["ate_rmse_m"] < 1.1 * run["odometry_from_start_ate_rmse_m"]
