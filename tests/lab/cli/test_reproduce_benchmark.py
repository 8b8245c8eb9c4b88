"""``monoloc reproduce --benchmark``: the row of a scene, from its published layout to the JSON file."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import json_of, outputs
from monoloc.adapt.settings import QUICK
from monoloc.builder.build_config import BuildConfig
from monoloc.bundle import write_bundle
from monoloc.config import override
from monoloc_lab.experiments.published import read_scene, scene_runs
from monoloc_lab.experiments.task import RESULT, TASK
from study_helpers import NETWORK
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture
from twelve_scenes_room import KITCHEN, write_kitchen


def put_built(folder: Path, out: Path) -> Path:
    """Put a bundle of the room where the command looks for a build that is done; returns the folder of results."""
    scene = read_scene("12scenes", folder, KITCHEN)
    run = scene_runs(scene, NETWORK, override(BuildConfig(), adapt=QUICK))["sequence0"]
    place = out / "results" / run.needs[0].key
    place.mkdir(parents=True)
    recording = RoomRecording(Room(), make_path(12, rate_hz=2.0), SMALL_CAMERA)
    write_bundle(place / "room.monoloc", make_bundle(room_mixture(Room(), 60), recording, range(12)))
    (place / RESULT).write_text(json.dumps({"frames": 9, "recorded_frames": 9, "seconds": 1.0}))
    (place / TASK).write_text(json.dumps({"seconds": 1.0}))
    return out / "results" / run.key


def test_row_is_of_all_test_frames_and_is_written_once(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # A process of its own would import everything again, which takes longer than the flight.
    monkeypatch.setattr("monoloc_lab.experiments.engine._cores", lambda workers, out: ThreadPoolExecutor(workers))
    walks = write_kitchen(tmp_path / KITCHEN, [8, 2, 2])
    (tmp_path / KITCHEN / "data" / "frame-000003.pose.txt").write_text("\n".join(["-INF -INF -INF -INF"] * 4))
    flown = put_built(tmp_path, tmp_path / "out")
    arguments = ["reproduce", "--benchmark", "12scenes", "--data", str(tmp_path), "--scene", KITCHEN]
    arguments += ["--quick", "--size", "tiny", "--workers", "1", "--out", str(tmp_path / "out")]
    content = json_of(capfd, *arguments)
    assert content == json.loads((tmp_path / "out" / "12scenes.json").read_text())
    (row,) = content["rows"]
    assert (row["scene"], row["test_frames"], row["training_sequences"]) == (KITCHEN, 7, ["sequence1", "sequence2"])
    assert row["notes"] == ["1 of 12 frames are left out: 1 without a pose"]
    with np.load(flown / "trajectory.npz") as arrays:
        poses, truth = arrays["poses"], arrays["truth"]
    np.testing.assert_allclose(truth, np.delete(walks[0], 3, axis=0), atol=1e-9)
    errors_cm = 100.0 * np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)
    assert row["position_median_cm"] == pytest.approx(np.median(errors_cm))
    assert row["lost_frames"] == row["sequences"]["sequence0"]["lost_frames"]
    assert content["mean"]["position_median_cm"] == row["position_median_cm"]
    assert (content["builds"], content["all_scenes"], content["network"]) == (1, False, NETWORK)
    out, err = outputs(capfd, *arguments)  # nothing is computed again
    assert f"{row['lost_frames']} of 7" in out and "median" in out
    assert "12scenes.json" in err and f"note: {KITCHEN}: 1 of 12 frames are left out" in err
