"""``monoloc synth``: files that other commands read, and one line for what cannot be done."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from monoloc.cli.main import invoke
from monoloc.io.pose_files import read_tum
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.rooms import read_room


@pytest.fixture(scope="module")
def home(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("synth") / "home"
    assert invoke(["synth", "room", "--seed", "1", "--out", str(out)]) == 0
    return out


def refused(capfd: pytest.CaptureFixture[str], arguments: list[str], *words: str) -> None:
    capfd.readouterr()
    assert invoke(["synth", *arguments]) == 2
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    for word in words:
        assert word in captured.err


def test_room_is_that_of_the_seed(home):
    assert read_room(home / "room.json") == generate_room(1)


def test_room_as_json(tmp_path, capfd):
    assert invoke(["synth", "room", "--seed", "1", "--out", str(tmp_path / "home"), "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["size_m"] == list(generate_room(1).size) and "door" in told["objects"]


def test_flight_through_the_folder_s_room(home, capfd):
    capfd.readouterr()
    assert invoke(["synth", "flight", "--seed", "2", "--seconds", "4", "--out", str(home), "--json"]) == 0
    told = json.loads(capfd.readouterr().out)
    assert told["frames"] == 120 and 0.1 < told["length_m"] < 4.0
    times, poses = read_tum(home / "flight.txt")
    np.testing.assert_allclose(np.diff(times), 1.0 / 30.0, atol=1e-6)
    assert generate_room(1).clearance_m(poses[:, :3, 3]).min() > 0.25
    drifting = read_tum(home / "odometry.txt")[1]
    assert 0.0 < np.linalg.norm(drifting[-1, :3, 3] - poses[-1, :3, 3]) < 0.5
    assert len((home / "imu.csv").read_text().splitlines()) == 4 * 200 + 2


def test_same_seed_same_files(home, tmp_path):
    for name in ("one", "other"):
        room = ["--room", str(home / "room.json")]
        assert invoke(["synth", "flight", "--seed", "5", "--seconds", "3", *room, "--out", str(tmp_path / name)]) == 0
    for file in ("room.json", "flight.txt", "odometry.txt", "imu.csv"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "other" / file).read_bytes()


def test_rendering_without_mitsuba_names_the_extra(home, capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    for command in ("render", "views"):
        refused(capfd, [command, "--out", str(home)], 'the extra "synth"', 'pip install ".[synth]"')


def test_blur_is_of_the_whole_flight_not_of_the_frames_rendered(home, tmp_path, monkeypatch):
    given = {}

    def noted(room, poses, timestamps_s, velocities, *others):
        given.update(poses=poses, times_s=timestamps_s, velocities=velocities)
        return []

    monkeypatch.setattr("monoloc_lab.cli.synth.render_sequence", noted)
    monkeypatch.setattr("monoloc_lab.cli.synth.require_mitsuba", lambda: None)
    out = tmp_path / "flight"
    assert invoke(["synth", "flight", "--seconds", "3", "--room", str(home / "room.json"), "--out", str(out)]) == 0
    times_s, poses = read_tum(out / "flight.txt")
    assert invoke(["synth", "render", "--every", "6", "--light", "L2", "--out", str(out)]) == 0
    np.testing.assert_array_equal(given["poses"], poses[::6])
    np.testing.assert_array_equal(given["velocities"], velocities(poses, times_s)[::6])
    assert np.abs(given["velocities"] - velocities(given["poses"], given["times_s"])).max() > 0.01


def test_what_cannot_be(home, tmp_path, capfd):
    refused(capfd, ["render", "--light", "L9", "--out", str(home)], "--light", "is 'L9'", "L1, L2, L3")
    refused(capfd, ["room", "--mesh", "no.ply", "--out", str(home)], "no.ply", "cannot be read", "check the path")
    refused(
        capfd, ["flight", "--room", "no.json", "--out", str(home)], "no.json", "cannot be read", "monoloc synth room"
    )
    refused(capfd, ["room", "--out", str(home / "room.json")], "--out", "is a file", "name a folder")
    refused(
        capfd, ["room", "--out", str(tmp_path / "no" / "home")], "--out", "does not exist", "make the folder first"
    )
    assert invoke(["synth", "flight", "--seconds", "3", "--out", str(home)]) == 0
    assert invoke(["synth", "room", "--seed", "1", "--out", str(home)]) == 0  # the same again
    for command in (["room", "--seed", "2"], ["flight", "--room", str(tmp_path / "else" / "room.json")]):
        assert invoke(["synth", "room", "--seed", "2", "--out", str(tmp_path / "else")]) == 0
        refused(capfd, [*command, "--out", str(home)], "--out", "room.json is another room", "name another folder")
    assert read_room(home / "room.json") == generate_room(1)
    (tmp_path / "other.json").write_text("{}")
    refused(
        capfd, ["flight", "--room", str(tmp_path / "other.json"), "--out", str(home)], "other.json", "is not a room"
    )
