"""Runs and maps shown and recorded from the command line."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monoloc.bundle import Bundle, write_bundle
from monoloc.cli.main import invoke
from monoloc.evaluation.cloud_metrics import cloud_distances, matched_clouds
from monoloc.viz import viewer
from monoloc.viz.viewer import run_viewer
from monoloc_lab.cli import demo
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, room_bundle, write_recording
from viewer_helpers import Recorded, file_names

FRAMES = 4


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return room_bundle(60, FRAMES)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory, bundle: Bundle) -> Path:
    folder = tmp_path_factory.mktemp("workspace")
    write_recording(folder / "recording", RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA))
    write_bundle(folder / "room.monoloc", bundle)
    return folder


def test_localize_records_the_written_trajectory(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    localize = ["localize", "room.monoloc", "recording", "--start", "truth"]
    assert invoke([*localize, "--out", "plain.txt"]) == 0
    assert invoke([*localize, "--out", "recorded.txt", "--record", "run.rrd"]) == 0
    assert "written: run.rrd" in capfd.readouterr().err
    assert Path("plain.txt").read_bytes() == Path("recorded.txt").read_bytes()
    recorded = Recorded(Path("run.rrd"))
    assert recorded.static("/__properties", "RecordingInfo:name") == ["room.monoloc: recording"]
    translations = np.concatenate(list(recorded.frames("/world/camera", "Transform3D:translation").values()))
    np.testing.assert_allclose(translations, np.loadtxt("recorded.txt")[:, 1:4], atol=1e-5)


@pytest.mark.slow
def test_map_compare_records_clouds_and_distances(
    here: Path, bundle: Bundle, capfd: pytest.CaptureFixture[str]
) -> None:
    means = bundle.original.means + np.array([0.03, 0.0, 0.04])
    moved = replace(bundle, adapted=replace(bundle.original, means=means))
    write_bundle(here / "moved.monoloc", moved)
    assert invoke(["map", "compare", "moved.monoloc", "--record", "map.rrd", "--json"]) == 0
    figures = json.loads(capfd.readouterr().out)
    assert "picture" not in figures and not (here / "compare.png").exists()
    recorded = Recorded(here / "map.rrd")
    assert recorded.store.application_id == "monoloc map compare"
    clouds = matched_clouds(moved.original, moved.adapted, figures["points"], np.random.default_rng(0))
    for name, cloud in zip(("original", "adapted"), clouds, strict=True):
        np.testing.assert_allclose(recorded.static(f"/world/{name}", "Points3D:positions"), cloud, atol=1e-5)
        box = figures[f"box_{name}_m"]
        centre = np.add(box["upper"], box["lower"]) / 2.0
        np.testing.assert_allclose(recorded.static(f"/world/boxes/{name}", "Boxes3D:centers"), [centre], atol=1e-5)
    # Bars are shares of all points, of which one in a hundred lies beyond the last.
    (bars,) = recorded.static("/distances", "BarChart:values")
    (middles,) = recorded.static("/distances", "BarChart:abscissa")
    shares, middles_cm = np.array(bars["buffer"]), np.array(middles["buffer"])
    assert 98.9 < shares.sum() <= 100.0
    distances_cm = 100.0 * cloud_distances(*clouds)
    assert middles_cm @ shares / shares.sum() == pytest.approx(np.mean(distances_cm), abs=0.1)
    # The larger a point's distance, the brighter it is.
    brightness = np.array(recorded.static("/world/distance", "Points3D:colors"), dtype=np.uint32) >> 16 & 0xFF
    near, far = distances_cm < np.percentile(distances_cm, 10), distances_cm > np.percentile(distances_cm, 90)
    assert brightness[far].mean() > brightness[near].mean() + 50


@pytest.mark.parametrize("command", [("localize", "room.monoloc", "recording"), ("map", "compare", "room.monoloc")])
def test_unwritable_recording_is_refused_before_the_work(
    here: Path, capfd: pytest.CaptureFixture[str], command: tuple[str, ...]
) -> None:
    before = file_names(here)
    for path, problem in (("no/a.rrd", "no does not exist"), ("recording", "recording is a folder")):
        assert invoke([*command, "--record", path]) == 2
        out, err = capfd.readouterr()
        assert out == "" and err.count("\n") == 1
        assert err.startswith(f"monoloc: --record: {problem}; ")
        assert file_names(here) == before


def test_failed_run_leaves_the_older_recording(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    Path("run.rrd").write_bytes(b"older")
    Path("recording/color/000002.png").write_bytes(b"no image")
    before = file_names(here)
    assert invoke(["localize", "room.monoloc", "recording", "--start", "truth", "--record", "run.rrd"]) == 2
    assert "000002.png" in capfd.readouterr().err
    assert file_names(here) == before and Path("run.rrd").read_bytes() == b"older"


@pytest.mark.parametrize(
    ("command", "instead"),
    [
        (("localize", "room.monoloc", "recording"), "give --record FILE.rrd"),
        (("map", "compare", "room.monoloc"), "give --record FILE.rrd"),
        (("fly", "room.monoloc", "recording"), "give --view-port PORT"),
        (("demo", "--out", "out"), "leave it out"),
    ],
)
def test_missing_display_is_reported_before_the_work(
    here: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    command: tuple[str, ...],
    instead: str,
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(viewer, "_is_listening", lambda: False)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    before = file_names(here)
    assert invoke([*command, "--view"]) == 2
    out, err = capfd.readouterr()
    assert out == "" and err.count("\n") == 1
    assert err.startswith(f"monoloc: --view: there is no display; {instead}")
    assert file_names(here) == before


def test_demo_shows_every_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workspace: Path) -> None:
    shown = []

    def watch(name: str, view: bool, record: Path | None) -> Any:
        shown.append((name, view, record))
        return run_viewer(name, view=False, record=None)

    recording = str(workspace / "recording")
    flights = tuple(demo._Flight(name, None, recording, True) for name in ("one", "other"))
    monkeypatch.setattr(demo, "_living", lambda build: demo._Demo("a recording", flights, None))
    monkeypatch.setattr(demo, "BUNDLE", workspace / "room.monoloc")
    monkeypatch.setattr(demo, "check_viewing", lambda view, instead: None)
    monkeypatch.setattr(demo, "run_viewer", watch)
    assert invoke(["demo", "--out", str(tmp_path / "out"), "--view", "--json"]) == 0
    assert shown == [("one", True, None), ("other", True, None)]
