"""``monoloc inspect``: what a recording holds, read as far as its first frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from cli_helpers import json_of, refused, succeeds


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    synthetic.write_folder(tmp_path / "flight")
    synthetic.write_video(tmp_path / "flight.avi")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_recording_is_described(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    content = json_of(capfd, "inspect", "flight", "--frames", "0:2")
    assert content["kind"] == "recording" and content["frames"] == 2
    assert content["image"] == [32, 24] and content["intrinsics"] == [30.0, 31.0, 15.5, 11.5]
    assert content["has_poses"] and content["has_depth"] and content["depth_share"] == pytest.approx(23 / 24)
    assert content["seconds"] == pytest.approx(0.1)
    step = np.diff(synthetic.make_poses(2)[:, :3, 3], axis=0)
    assert content["path_m"] == pytest.approx(np.linalg.norm(step), abs=1e-6)
    assert content["depth_median_m"] == pytest.approx(1.5)


@pytest.mark.filterwarnings("error")
def test_frame_without_depth_has_no_median_depth(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    synthetic.write_depth(here / "flight/depth/000010.png", np.zeros((24, 32), dtype=np.uint16))
    content = json_of(capfd, "inspect", "flight")
    assert content["depth_share"] == 0.0 and content["depth_median_m"] is None


def test_video_is_described_with_its_distortion(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    command = ("inspect", "flight.avi", "--intrinsics", "64,48,50,50,31,23,-0.08,0.01,0.001,-0.002,0.0004")
    content = json_of(capfd, *command)
    assert content["frames"] == 6 and content["intrinsics"] == [50.0, 50.0, 31.0, 23.0]
    assert content["distortion"] == [-0.08, 0.01, 0.001, -0.002, 0.0004]
    assert not content["has_poses"] and not content["has_depth"]
    assert "-0.08, 0.01, 0.001, -0.002, 0.0004" in succeeds(capfd, *command)


def test_missing_file_is_named(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    (here / "flight/color/000020.jpg").unlink()
    refused(capfd, here, ("inspect", "flight"), "flight/color/000020.jpg", "is missing", "restore it")
