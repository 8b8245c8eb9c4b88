"""``monoloc evaluate``: poses matched by time, and what cannot be compared."""

from __future__ import annotations

import re
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from altered_recordings import POSES, turning_path
from cli_helpers import json_of, refused, succeeds
from monoloc.cli.main import invoke
from monoloc.io.tum_trajectory import write_tum


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a recording of three posed frames."""
    synthetic.write_folder(tmp_path / "flight")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("truth", ["flight", "flight/poses.txt"])
def test_matched_unmatched_and_missed_poses_are_counted(
    capfd: pytest.CaptureFixture[str], here: Path, truth: str
) -> None:
    shifted = synthetic.make_poses(3)
    shifted[:, 0, 3] += 0.04
    write_tum(here / "trajectory.txt", [5.0, 5.05, 5.2], shifted[[0, 1, 2]])
    metrics = json_of(capfd, "evaluate", "trajectory.txt", truth)
    assert (metrics["frames"], metrics["unmatched"], metrics["missed"]) == (2, 1, 1)
    assert metrics["ate_rmse_m"] == metrics["ate_max_m"] == pytest.approx(0.04)
    assert metrics["rot_rmse_deg"] == pytest.approx(0.0, abs=1e-5)
    assert metrics["rpe_rmse_m"] > 0.0
    assert re.search(r"missed +│ +1 ", succeeds(capfd, "evaluate", "trajectory.txt", truth))


def test_true_poses_of_another_convention_are_named(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    poses, times = turning_path(40), np.arange(40) / 15.0
    write_tum(here / "trajectory.txt", times, poses)
    write_tum(here / "truth.txt", times, POSES["w first"].poses(poses))
    json_of(capfd, "evaluate", "trajectory.txt", "truth.txt")
    assert invoke(["evaluate", "trajectory.txt", "truth.txt"]) == 0
    said = "trajectory.txt: the true poses agree with the estimated ones as quaternions with w first; convert them"
    assert said in capfd.readouterr().err
    json_of(capfd, "evaluate", "trajectory.txt", "trajectory.txt")


def test_a_trajectory_of_a_higher_rate_has_no_errors_of_pairing(
    capfd: pytest.CaptureFixture[str], here: Path
) -> None:
    """Exact poses at 100 Hz of a camera at 1 m/s, against references at 10 Hz."""
    times = np.arange(400) / 100.0
    poses = np.tile(np.eye(4), (400, 1, 1))
    poses[:, 0, 3] = times
    write_tum(here / "fast.txt", times, poses)
    write_tum(here / "truth.txt", times[::10], poses[::10])
    for estimated, truth, unmatched, missed in (("fast", "truth", 360, 0), ("truth", "fast", 0, 360)):
        metrics = json_of(capfd, "evaluate", f"{estimated}.txt", f"{truth}.txt")
        assert (metrics["frames"], metrics["unmatched"], metrics["missed"]) == (40, unmatched, missed)
        assert metrics["ate_max_m"] == pytest.approx(0.0, abs=1e-9)
        assert metrics["rpe_rmse_m"] == pytest.approx(0.0, abs=1e-9)


def test_frames_choose_frames_of_the_truth(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    metrics = json_of(capfd, "evaluate", "flight/poses.txt", "flight", "--frames", "0:2")
    assert (metrics["frames"], metrics["unmatched"], metrics["missed"]) == (2, 1, 0)


def test_memory_is_linear_in_the_number_of_poses(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    times, poses = np.arange(2000) / 100.0, np.tile(np.eye(4), (2000, 1, 1))
    write_tum(here / "truth.txt", times, poses)
    write_tum(here / "trajectory.txt", times + 0.004, poses)
    command = ("evaluate", "trajectory.txt", "truth.txt")
    json_of(capfd, *command)  # what is imported on the way does not count
    tracemalloc.start()
    metrics = json_of(capfd, *command)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert metrics["frames"] == 2000 and metrics["ate_max_m"] == 0.0
    assert peak < 8 * 2000**2 / 2


def test_trajectories_that_cannot_be_compared_are_refused(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    write_tum(here / "late.txt", [1e6, 1e6 + 1], np.tile(np.eye(4), (2, 1, 1)))
    command = ("evaluate", "late.txt", "flight")
    refused(capfd, here, command, "late.txt", r"has no pose within 0.02 s", "same clock: fly .* --fast$")
    refused(capfd, here, (*command, "--frames", "2:"), "late.txt", "has no pose within", "--fast; and that --frames")
    for name in ("truth", "truth.csv"):
        shutil.copy(here / "flight" / "poses.txt", here / name)
        problem, fix = "is not recognised", "NAME.txt if it is a TUM"
        refused(capfd, here, ("evaluate", "late.txt", name), name, problem, fix)
    description = here / "flight" / "dataset.toml"
    description.write_text(synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', "rate_hz = 10"))
    refused(capfd, here, command, "flight", "has no poses", "recording or TUM")
    for option, value in (("--fix-poses", "opengl"), ("--fix-depth", "range")):
        against = ("evaluate", "late.txt", "flight/poses.txt", option, value)
        refused(capfd, here, against, f"{option}: ", "has no meaning for a trajectory", "leave it out")
