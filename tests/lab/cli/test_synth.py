"""``monoloc synth``: files that other commands read, and refusals."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_helpers import json_of, refused, succeeds
from monoloc.cli.main import invoke
from monoloc.io.pose_files import read_tum
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.rooms import read_room


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the room of seed 1."""
    out = tmp_path_factory.mktemp("synth") / "home"
    assert invoke(["synth", "room", "--seed", "1", "--out", str(out)]) == 0
    return out


def test_room_is_that_of_the_seed(home: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert read_room(home / "room.json") == generate_room(1)
    described = json_of(capfd, "synth", "room", "--seed", "1", "--out", str(tmp_path / "home"))
    assert described["size_m"] == list(generate_room(1).size) and "door" in described["objects"]


def test_flight_is_in_the_room_of_the_folder(home: Path, capfd: pytest.CaptureFixture[str]) -> None:
    described = json_of(capfd, "synth", "flight", "--seed", "2", "--seconds", "3", "--out", str(home))
    assert described["frames"] == 90 and 0.1 < described["length_m"] < 4.0
    times, poses = read_tum(home / "flight.txt")
    np.testing.assert_allclose(np.diff(times), 1.0 / 30.0, atol=1e-6)
    assert generate_room(1).clearance_m(poses[:, :3, 3]).min() > 0.25
    drifting = read_tum(home / "odometry.txt")[1]
    assert 0.0 < np.linalg.norm(drifting[-1, :3, 3] - poses[-1, :3, 3]) < 0.5
    assert len((home / "imu.csv").read_text().splitlines()) == 3 * 200 + 2


def test_seed_determines_the_files(home: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "other"):
        room = ["--room", str(home / "room.json")]
        succeeds(capfd, "synth", "flight", "--seed", "5", "--seconds", "2", *room, "--out", str(tmp_path / name))
    for file in ("room.json", "flight.txt", "odometry.txt", "imu.csv"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "other" / file).read_bytes()


def test_rendering_without_mitsuba_names_the_extra(
    home: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    for command in ("render", "views"):
        refused(capfd, home, ("synth", command, "--out", str(home)), "", 'the extra "synth"', "pip install")


def test_blur_uses_the_velocities_of_the_whole_flight(
    home: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, Any] = {}

    def record(room: Any, poses: Any, timestamps_s: Any, velocities: Any, *others: Any) -> list[Path]:
        given.update(poses=poses, times_s=timestamps_s, velocities=velocities)
        return []

    monkeypatch.setattr("monoloc_lab.cli.synth.render_sequence", record)
    monkeypatch.setattr("monoloc_lab.cli.synth.require_mitsuba", lambda: None)
    out = str(tmp_path / "flight")
    succeeds(capfd, "synth", "flight", "--seconds", "2", "--room", str(home / "room.json"), "--out", out)
    times_s, poses = read_tum(tmp_path / "flight" / "flight.txt")
    render = ("synth", "render", "--seconds", "2", "--out", out)
    refused(capfd, tmp_path, render, "--seconds", "has no effect: the flight is that of .*flight.txt", "leave it out")
    succeeds(capfd, "synth", "render", "--every", "6", "--light", "L2", "--out", out)
    np.testing.assert_array_equal(given["poses"], poses[::6])
    np.testing.assert_array_equal(given["velocities"], velocities(poses, times_s)[::6])
    assert np.abs(given["velocities"] - velocities(given["poses"], given["times_s"])).max() > 0.01


def test_unknown_light_is_refused(home: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ("synth", "render", "--light", "L9", "--out", str(home))
    refused(capfd, home, arguments, "--light", "is 'L9'", "L1, L2, L3")


def test_folder_of_another_room_is_refused(home: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    succeeds(capfd, "synth", "room", "--seed", "1", "--out", str(home))  # the same room again
    succeeds(capfd, "synth", "room", "--seed", "2", "--out", str(tmp_path / "other"))
    for command in (("room", "--seed", "2"), ("flight", "--room", str(tmp_path / "other" / "room.json"))):
        arguments = ("synth", *command, "--out", str(home))
        refused(capfd, home, arguments, "--out", "room.json is another room", "name another folder")
