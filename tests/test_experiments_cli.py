"""``monoloc reproduce``: what it refuses, in one line, before any work is done; and one figure, start to end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import synthetic_recordings as synthetic
from monoloc.cli.common import check_folder
from monoloc.cli.main import invoke
from monoloc.errors import SettingError
from monoloc.io.registry import absolute_source
from monoloc_lab.experiments.study import recorded
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, write_recording


def refused(capfd: pytest.CaptureFixture[str], out: Path, *arguments: str) -> str:
    """What is said in one line, with exit code 2 and nothing written."""
    capfd.readouterr()
    assert invoke(["reproduce", *arguments, "--out", str(out)]) == 2
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert not out.exists()
    return captured.err


def test_unknown_figure_names_the_known(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said = refused(capfd, tmp_path / "out", "fig9")
    assert "FIGURE: is 'fig9'; choose from fig1, fig2," in said and "map-size, lambda, frames" in said


def test_source_that_cannot_be_read(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert "does not exist" in refused(capfd, tmp_path / "out", "--data", str(tmp_path / "nowhere"))
    assert "unknown format 'kitti'" in refused(capfd, tmp_path / "out", "--data", "kitti:somewhere")


def test_recording_without_poses_or_depth(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for lacking in ("poses", "depth"):
        folder = tmp_path / lacking
        synthetic.write_folder(folder)
        description = folder / "dataset.toml"
        lines = [line for line in description.read_text().splitlines() if not line.startswith(lacking)]
        kept = "\n".join(lines)
        description.write_text(kept.replace('"sequence"', '"pairs"') if lacking == "poses" else kept)
        said = refused(capfd, tmp_path / "out", "--data", str(folder))
        assert f"has no {lacking}; give --data builtin, or one with poses and depth" in said


def test_scheduler_that_does_not_answer(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monoloc_lab.experiments.engine._ANSWER_S", 0.5)
    said = refused(capfd, tmp_path / "out", "--dask", "tcp://127.0.0.1:1")
    assert "--dask: no scheduler answers at tcp://127.0.0.1:1; start one with: dask scheduler" in said


def test_weights_that_are_not_there(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said = refused(capfd, tmp_path / "out", "--encoder", str(tmp_path / "weights.npz"))
    assert "--encoder:" in said and "weights.npz does not exist; give MobileNetV2 weights as .npz" in said


def test_folder_that_cannot_be_made(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said = refused(capfd, tmp_path / "not" / "there")
    assert "--out:" in said and "make the folder first" in said


def test_folder_that_is_there_but_cannot_be_written_to(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And one that can, in a folder that cannot."""
    closed = tmp_path / "closed"
    inside = closed / "open"
    inside.mkdir(parents=True)
    monkeypatch.setattr(
        "monoloc.cli.common.os.access", lambda path, mode: not (mode & os.W_OK and Path(path) == closed)
    )
    assert invoke(["reproduce", "--out", str(closed)]) == 2
    said = capfd.readouterr().err
    assert said == f"monoloc: --out: {closed} cannot be written to; choose another folder\n"
    check_folder(inside, "--out")
    with pytest.raises(SettingError, match="closed cannot be written to"):
        check_folder(closed / "new", "--out")


def test_what_is_asked_for_must_go_together(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    said = refused(capfd, tmp_path / "out", "--workers", "2", "--dask", "tcp://127.0.0.1:1")
    assert "--workers: is of this machine, and --dask of others; leave one of them out" in said
    said = refused(capfd, tmp_path / "out", "--builds", "6")
    assert "--builds: is 6, and runs have 5 seeds; give no more than that" in said
    said = refused(capfd, tmp_path / "out", "--size", "half")
    assert "--size: there is no half; give some of full, two-thirds, one-third, tiny" in said
    said = refused(capfd, tmp_path / "out", "lambda", "frames", "--quick")
    assert "--quick: leaves out lambda, frames, and nothing else is asked for; run without it" in said


def test_recording_too_short_for_posenets(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_recording(tmp_path / "short", RoomRecording(Room(), make_path(48), SMALL_CAMERA))
    said = refused(capfd, tmp_path / "out", "fig4d", "--quick", "--data", f"folder:{tmp_path / 'short'}")
    assert "short: gives 12 frames to build from, and PoseNets need 32; give one of 128 frames or more" in said
    for split in recorded("folder:room", "room", 128, quick=False).splits:
        assert len(range(128)[slice(*map(int, split.frames.split(":")))]) >= 32


def test_task_that_the_recording_makes_impossible_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Twelve frames are three to build from: fewer than a map takes."""
    write_recording(tmp_path / "short", RoomRecording(Room(), make_path(12), SMALL_CAMERA))
    arguments = ["reproduce", "fig3", "--quick", "--data", f"folder:{tmp_path / 'short'}", "--workers", "1"]
    assert invoke([*arguments, "--out", str(tmp_path / "out")]) == 2
    said = capfd.readouterr().err.splitlines()[-1]
    assert "monoloc: bundle of full-0.35" in said and "short: gives 3 frames; build from at least 5" in said


def test_source_is_found_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert absolute_source("folder:walks/one") == f"folder:{tmp_path}/walks/one"
    assert absolute_source("walk.mp4") == f"{tmp_path}/walk.mp4"
    assert absolute_source("tum:/elsewhere") == "tum:/elsewhere"


def test_the_command_is_offered_without_what_its_work_needs() -> None:
    heavy = ("torch", "joblib", "distributed", "dask", "matplotlib", "scipy", "reportlab")
    script = f"import sys, monoloc.cli.app; sys.exit(', '.join(m for m in {heavy!r} if m in sys.modules) or 0)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_a_figure_start_to_end(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """One that needs no task: what is left is all that is around the engine."""
    write_recording(tmp_path / "walk", RoomRecording(Room(), make_path(48), SMALL_CAMERA))
    out = tmp_path / "out"
    asked = ["reproduce", "fig2", "--quick", "--builds", "2", "--data", f"folder:{tmp_path / 'walk'}"]
    asked += ["--size", "tiny", "--size", "two-thirds"]
    arguments = [*asked, "--out", str(out), "--json"]
    assert invoke(arguments) == 0
    told = json.loads(capfd.readouterr().out)
    assert set(told) == {"claims", "figures", "report", "seconds"}
    assert list(told["figures"]) == ["fig2"] and told["claims"] == [] and told["seconds"] > 0.0
    assert Path(told["report"]) == out / "report.html" and (out / "report.pdf").stat().st_size > 1000
    assert invoke(arguments[:-1]) == 0
    captured = capfd.readouterr()
    assert captured.out == "" and "report: " in captured.err  # no claim, no table
    assert json.loads((out / "fig2.json").read_text()) == told["figures"]["fig2"]["numbers"]
    study = json.loads((out / "report.json").read_text())["study"]
    assert study["builds"].startswith("2; ") and list(told["figures"]["fig2"]["numbers"]) == ["two-thirds", "tiny"]
