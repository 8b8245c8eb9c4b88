"""``monoloc reproduce``: refusals before any work is done, and one figure from start to end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from cli_helpers import json_of, python, refused, succeeds
from monoloc.cli.main import invoke
from monoloc_lab.experiments.study import recorded
from study_helpers import write_room
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, write_recording


@pytest.mark.parametrize(
    ("arguments", "names", "problem", "fix"),
    [
        (("fig9",), "FIGURE", "is 'fig9'", "choose from fig1, fig2, .*map-size, lambda, frames"),
        (("--data", "nowhere"), "", "nowhere: does not exist", ""),
        (("--data", "nofo:x"), "--data", "unknown format 'nofo'", "known formats: folder"),
        (("--encoder", "weights.npz"), "--encoder", "weights.npz does not exist", "give MobileNetV2 weights as .npz"),
        (("--encoder", "weights.txt"), "--encoder", "weights.txt is no .npz", "give MobileNetV2 weights as .npz"),
        (("--encoder", "other.npz"), "other.npz", "has no tensor", "torchvision's MobileNetV2 names"),
        (
            ("--workers", "2", "--dask", "tcp://127.0.0.1:1"),
            "--workers",
            "is for this machine",
            "leave one of them out",
        ),
        (("--build-frames", "0:9:3"), "--build-frames", "has no meaning for a rendered room", "leave it out"),
        (("--data", "rendered:nowhere"), "", "nowhere: has no folder build", "give the --out of"),
        (("--builds", "6"), "--builds", "is 6, and runs have 5 seeds", "give at most that many"),
        (("--size", "half"), "--size", "is 'half'", "choose from full, two-thirds, one-third, tiny"),
        (("lambda", "frames", "--quick"), "--quick", "leaves out lambda, frames", "run without it"),
        (("--scene", "chess"), "--scene", "has no meaning without --benchmark", "leave it out"),
        (("fig2", "--benchmark", "7scenes"), "FIGURE", "has no meaning with --benchmark", "leave it out"),
        (("--benchmark", "tum"), "--benchmark", "is 'tum'", "choose from 7scenes, 12scenes"),
        (("--benchmark", "12scenes", "--scene", "x"), "--scene", "is 'x'", "choose from apt1/kitchen, .*office2/5b"),
        (("--benchmark", "7scenes"), "--data", "is needed with --benchmark", "give the folder"),
        (("--benchmark", "7scenes", "--size", "half"), "--size", "is 'half'", "choose from full"),
        (("--benchmark", "7scenes", "--size", "full", "--size", "tiny"), "--size", "is given 2 times", "one size"),
        (("--benchmark", "7scenes", "--data", "nowhere"), "", "nowhere/chess: is missing", "--scene"),
        (("--dask", "tcp://127.0.0.1:1"), "--dask", "no scheduler answers at tcp://127.0.0.1:1", "dask scheduler"),
    ],
)
def test_bad_options_are_refused_before_any_work(
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    names: str,
    problem: str,
    fix: str,
) -> None:
    monkeypatch.setattr("monoloc_lab.experiments.engine._ANSWER_S", 0.5)
    monkeypatch.chdir(tmp_path)
    Path("weights.txt").touch()
    np.savez("other.npz", weights=np.zeros(3))
    refused(capfd, tmp_path, ("reproduce", *arguments, "--out", str(tmp_path / "out")), names, problem, fix)


@pytest.mark.parametrize(
    ("frames", "problem", "fix"),
    [
        ("0:x:3", "is '0:x:3'", "START:STOP:STEP, three numbers"),
        ("0:12:3", "is 0:12:3, and there are 12 frames", "leave some after STOP"),
    ],
)
def test_build_frames_that_leave_nothing_are_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], frames: str, problem: str, fix: str
) -> None:
    write_room(tmp_path / "room", 12)
    options = ("--data", f"folder:{tmp_path / 'room'}", "--build-frames", frames, "--out", str(tmp_path / "out"))
    refused(capfd, tmp_path, ("reproduce", "ladder", *options), "--build-frames", problem, fix)


@pytest.mark.parametrize("lacking", ["poses", "depth"])
def test_recording_without_poses_or_depth_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], lacking: str
) -> None:
    synthetic.write_folder(tmp_path / "room")
    description = tmp_path / "room" / "dataset.toml"
    lines = [line for line in description.read_text().splitlines() if not line.startswith(lacking)]
    text = "\n".join(lines)
    description.write_text(text.replace('"sequence"', '"pairs"') if lacking == "poses" else text)
    arguments = ("reproduce", "--data", str(tmp_path / "room"), "--out", str(tmp_path / "out"))
    refused(capfd, tmp_path, arguments, "", f"has no {lacking}", "give --data builtin, or one with poses and depth")


@pytest.mark.slow
def test_recording_too_short_for_posenets_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / "short", RoomRecording(Room(), make_path(48), SMALL_CAMERA))
    arguments = ("reproduce", "fig4d", "--quick", "--data", f"folder:{tmp_path / 'short'}")
    refused(
        capfd,
        tmp_path,
        (*arguments, "--out", str(tmp_path / "out")),
        "short",
        "gives 12 build frames, and PoseNets need 32",
        "give one of 128 frames or more",
    )
    for split in recorded("folder:room", "room", 128, quick=False).splits:
        assert len(range(128)[slice(*map(int, split.frames.split(":")))]) >= 32


@pytest.mark.slow
def test_failed_task_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Twelve frames give three build frames, too few for a map."""
    write_recording(tmp_path / "short", RoomRecording(Room(), make_path(12), SMALL_CAMERA))
    arguments = ["reproduce", "fig3", "--quick", "--data", f"folder:{tmp_path / 'short'}", "--workers", "1"]
    assert invoke([*arguments, "--out", str(tmp_path / "out")]) == 2
    message = capfd.readouterr().err.splitlines()[-1]
    assert (
        "monoloc: bundle of full-0.35" in message
        and "short: has too few frames (3); build from at least 5" in message
    )


def test_command_is_offered_without_the_libraries_of_its_work() -> None:
    heavy = ("torch", "joblib", "distributed", "dask", "matplotlib", "scipy", "reportlab")
    script = "import sys; from monoloc.cli.app import command_line; command_line([]); "
    script += f"sys.exit(', '.join(m for m in {heavy!r} if m in sys.modules) or 0)"
    assert python(script).returncode == 0


@pytest.mark.slow
def test_figure_without_tasks_is_reported(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / "room", RoomRecording(Room(), make_path(16), SMALL_CAMERA))
    out = tmp_path / "out"
    arguments = ["reproduce", "fig2", "--quick", "--builds", "2", "--data", f"folder:{tmp_path / 'room'}"]
    arguments += ["--size", "tiny", "--size", "two-thirds", "--out", str(out)]
    content = json_of(capfd, *arguments)
    assert set(content) == {"claims", "figures", "report", "seconds"}
    assert list(content["figures"]) == ["fig2"] and content["claims"] == [] and content["seconds"] > 0.0
    assert Path(content["report"]) == out / "report.html" and (out / "report.pdf").stat().st_size > 1000
    numbers = content["figures"]["fig2"]["numbers"]
    assert json.loads((out / "fig2.json").read_text()) == numbers and list(numbers) == ["two-thirds", "tiny"]
    assert json.loads((out / "report.json").read_text())["study"]["builds"].startswith("2; ")
    assert succeeds(capfd, *arguments) == ""  # without claims there is no table
