"""Code in documents does what it says, in a synthetic room."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.bundle import write_bundle
from monoloc.geometry import invert, se3_log
from monoloc.start import Start
from monoloc.step import Step
from monoloc_lab.rooms import TESTS
from repository import REPOSITORY
from synthetic_room import (
    BLUE_SPAN,
    NEAREST_M,
    SMALL_CAMERA,
    FloatArray,
    Room,
    RoomRecording,
    make_bundle,
    make_path,
    room_mixture,
)

FRAMES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, recording: RoomRecording) -> Path:
    """Holds ``room.monoloc`` and ``flight.avi``, which documents only read."""
    folder = tmp_path_factory.mktemp("documents")
    bundle = make_bundle(room_mixture(Room()), recording, range(0, FRAMES, 2))
    settings = bundle.settings.model_copy(update={"particles": 300, "scan_points": 150})
    write_bundle(folder / "room.monoloc", replace(bundle, settings=settings))
    size = (recording.camera.width, recording.camera.height)
    writer = cv2.VideoWriter(str(folder / "flight.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 15.0, size)
    for index in range(FRAMES):
        writer.write(cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2BGR))
    writer.release()
    return folder


@pytest.fixture(autouse=True)
def _working_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


def code_blocks(document: str) -> list[str]:
    """The blocks of Python in a document."""
    return re.findall(r"```python\n(.*?)```", (REPOSITORY / document).read_text(encoding="utf-8"), re.DOTALL)


def execute(document: str, code: str, names: dict[str, Any]) -> dict[str, Any]:
    """The names after the code."""
    exec(compile(code, document, "exec"), names)
    return names


def execute_flight(document: str, recording: RoomRecording, **given: Any) -> dict[str, Any]:
    """The names after a document's first block, with the recording's camera, start and video."""
    code = code_blocks(document)[0]
    code, cameras = re.subn(r"camera = monoloc\.Camera\(640, 480, .*\n", "camera = given_camera\n", code)
    code, starts = re.subn(r"start = None .*\n", "start = given_start\n", code)
    assert (cameras, starts) == (1, 1)
    names = {"given_camera": recording.camera, "given_start": Start(recording.poses[0]), **given}
    return execute(document, code.replace("flight.mp4", "flight.avi"), names)


def is_followed(step: Step, recording: RoomRecording) -> bool:
    off_m = np.linalg.norm(step.estimate.pose[:3, 3] - recording.poses[-1][:3, 3])
    return step.state in ("tracking", "uncertain") and bool(off_m < 0.1)


def test_camera_is_followed(recording: RoomRecording) -> None:
    assert is_followed(execute_flight("docs/how-to/fly.md", recording)["step"], recording)


def test_recording_is_followed(recording: RoomRecording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("monoloc.io.registry.open_recording", {f"folder:{TESTS['L2']}": recording}.__getitem__)
    document = "docs/tutorial.md"
    assert is_followed(execute(document, code_blocks(document)[0], {})["step"], recording)


def test_camera_is_followed_with_a_gyroscope(recording: RoomRecording) -> None:
    """Black images in which the camera, as its gyroscope says, turns by 0.1 rad."""
    document = "docs/how-to/fly.md"
    names = execute_flight(document, recording)
    after = execute(document, code_blocks(document)[1], {**names, "R_camera_imu": np.eye(3)})
    for time_s in np.arange(100.0, 101.0, 0.01):
        after["on_sample"](time_s, [0.0, 1.0, 0.0])
    black = np.zeros_like(recording.color(0))
    step = after["on_frame"](black, 100.3, 100.4)
    turn = invert(names["step"].estimate.pose) @ step.estimate.pose
    np.testing.assert_allclose(se3_log(turn), [0.0, 0.0, 0.0, 0.0, 0.1, 0.0], atol=1e-6)


def test_rendered_room_is_edited() -> None:
    document = "docs/how-to/rendered-rooms.md"
    names = execute(document, code_blocks(document)[0], {})
    assert names["moved"] != names["room"] and set(names["room"].names) - set(names["emptier"].names) == {"plant"}


def test_camera_is_followed_by_a_depth_network_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    document = "docs/how-to/change-a-part.md"
    second = RoomRecording(Room(), make_path(FRAMES, rate_hz=5.0), SMALL_CAMERA)
    monkeypatch.setattr("monoloc.io.registry.open_recording", {"folder:second-recording": second}.__getitem__)
    images = []

    def my_network(small: NDArray[np.uint8]) -> FloatArray:
        images.append(small)
        return np.asarray(NEAREST_M * np.exp(BLUE_SPAN * small[..., 2] / 255.0))

    names = execute(document, code_blocks(document)[0], {"my_network": my_network})
    assert images and {image.shape for image in images} == {(32, 40, 3)}
    step = names["step"]
    assert step.state in ("tracking", "uncertain")
    assert np.linalg.norm(step.estimate.pose[:3, 3] - second.poses[-1][:3, 3]) < 0.1


@pytest.mark.slow  # two calibrations; tests/unit/builder/test_calibrate.py has one
def test_likelihood_of_ones_own_tracks_far_better_than_odometry(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """After the one call of ``calibrate`` that the page shows."""
    document = "docs/how-to/change-a-part.md"
    second = RoomRecording(Room(), make_path(FRAMES, rate_hz=5.0), SMALL_CAMERA)
    monkeypatch.setattr("monoloc.io.registry.open_recording", {"folder:second-recording": second}.__getitem__)
    execute(document, code_blocks(document)[1], {})
    lines = re.findall(r"(.*): (.*) cm, odometry (.*) cm, (.*)% tracking\n", capsys.readouterr().out)
    assert [name for name, *_ in lines] == ["ray", "likelihood field"]
    for _, error_cm, odometry_cm, tracking_percent in lines:
        assert float(error_cm) < 0.6 * float(odometry_cm)
        assert float(tracking_percent) >= 70.0  # of twelve frames, the first are in doubt
