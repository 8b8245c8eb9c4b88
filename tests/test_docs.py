"""Code in documents does what it says, in a made-up room."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from repository import REPOSITORY
from monoloc.bundle import write_bundle
from monoloc.geometry import se3_exp, se3_log
from synthetic_room import Room, RoomRecording, make_bundle, make_path, room_mixture

FRAMES = 12


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, recording: RoomRecording) -> Path:
    """A folder with ``room.monoloc`` and ``flight.avi``, which documents only read."""
    folder = tmp_path_factory.mktemp("docs")
    write_bundle(folder / "room.monoloc", make_bundle(room_mixture(Room()), recording, range(0, FRAMES, 2)))
    size = (recording.camera.width, recording.camera.height)
    writer = cv2.VideoWriter(str(folder / "flight.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 15.0, size)
    for index in range(FRAMES):
        writer.write(cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2BGR))
    writer.release()
    return folder


@pytest.fixture(autouse=True)
def _there(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made)


def pieces_of(document: str) -> list[str]:
    """The pieces of Python in a document."""
    return re.findall(r"```python\n(.*?)```", (REPOSITORY / document).read_text(encoding="utf-8"), re.DOTALL)


def python_of(document: str) -> str:
    """The one piece of Python in a document."""
    (code,) = pieces_of(document)
    return code


def run(document: str, recording: RoomRecording, **given: Any) -> dict[str, Any]:
    """What a document's Python leaves behind, with the recording's camera and start."""
    own, found = re.subn(r"camera = Camera\(640, 480, .*\)\n", "camera = given_camera\n", python_of(document))
    assert found == 1
    names = {"given_camera": recording.camera, "T_world_camera": recording.poses[0], **given}
    exec(compile(own.replace("flight.mp4", "flight.avi"), document, "exec"), names)
    return names


def test_readme_follows_a_camera(recording: RoomRecording) -> None:
    frames = [(recording.color(index), 1.0 / 15.0) for index in range(FRAMES)]
    step = run("README.md", recording, frames=frames)["step"]
    assert step.state in ("tracking", "uncertain") and step.estimate.covariance.shape == (6, 6)
    assert np.linalg.norm(step.estimate.pose[:3, 3] - recording.poses[-1][:3, 3]) < 0.1


def test_a_flight_controller_is_told_where_the_drone_is(recording: RoomRecording) -> None:
    """North, east, down of its centre, 6 cm behind the camera, whose axes are the body's right, down and forward."""
    names = run("docs/flying.md", recording)
    assert names["before_s"] == pytest.approx((FRAMES - 1) / 15.0)
    T_ned_body, covariance = names["T_ned_body"], names["covariance"]
    pose = names["step"].estimate.pose
    right, down, forward = pose[:3, :3].T
    centre = pose[:3, 3] - 0.06 * forward
    np.testing.assert_allclose(T_ned_body[:3, 3], centre * (1.0, -1.0, -1.0), atol=1e-12)
    for axis, direction in zip(T_ned_body[:3, :3].T, (forward, right, down), strict=True):
        np.testing.assert_allclose(axis, direction * (1.0, -1.0, -1.0), atol=1e-12)
    assert np.linalg.norm(pose[:3, 3] - recording.poses[-1][:3, 3]) < 0.1
    # The spread of the poses that the belief allows, as the flight controller sees them.
    belief, seen = names["step"].estimate, []
    for twist in np.random.default_rng(0).multivariate_normal(np.zeros(6), 1e-6 * belief.covariance, 4000):
        moved, _ = names["for_autopilot"](replace(belief, pose=pose @ se3_exp(twist)))
        turned = se3_log(np.linalg.inv(T_ned_body) @ moved)[3:]
        seen.append([*(moved[:3, 3] - T_ned_body[:3, 3]), *turned])
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        1e6 * np.cov(np.transpose(seen)) / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=0.1
    )


def test_a_rendered_room_is_edited() -> None:
    names: dict[str, Any] = {}
    exec(compile(pieces_of("docs/synth.md")[0], "docs/synth.md", "exec"), names)
    assert names["moved"] != names["room"] and set(names["room"].names) - set(names["emptier"].names) == {"plant"}


@pytest.mark.slow
def test_a_likelihood_of_one_s_own_is_held_against_ours(
    recording: RoomRecording, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    short = RoomRecording(Room(), make_path(FRAMES // 2))
    monkeypatch.setattr("monoloc.io.registry.open_recording", {"folder:second-walk": short}.__getitem__)
    exec(compile(python_of("docs/research.md"), "docs/research.md", "exec"), {})
    lines = re.findall(r"(.*): (.*) cm \((.*) to (.*)\)\n", capsys.readouterr().out)
    assert [name for name, *_ in lines] == ["along rays", "nearest component"]
    assert lines[0][1:] != lines[1][1:] and all(float(median) < 12.0 for _, median, *_ in lines)
