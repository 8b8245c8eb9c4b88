"""The MCAP file of a flight: times by ROS's clock, and a disk that fills up is said once."""

from __future__ import annotations

import resource
import threading
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from numpy.typing import NDArray

from mavlink_helpers import CAMERA, result_at, step_at
from monoloc.bundle import Bundle
from monoloc.errors import DataError
from monoloc.flight import mcap_log
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.mcap_log import McapLog, ros_frames_of, step_recorder
from monoloc.obstacles import tells_obstacles
from monoloc.ros.mcap_file import StepRecorder
from monoloc.step import Step
from synthetic_room import room_bundle


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return room_bundle(60, 6)


def recorder_of(path: Path, bundle: Bundle, obstacles: bool = True) -> StepRecorder:
    settings = FlightSettings(obstacles=obstacles)
    return step_recorder(path, True, bundle, CAMERA, settings, tells_obstacles(bundle))


def topics_and_times(path: Path) -> list[tuple[str, int]]:
    with path.open("rb") as file:
        return [(channel.topic, message.log_time) for _, channel, message in make_reader(file).iter_messages()]


@pytest.mark.parametrize(
    ("tune", "obstacles", "has_cloud"), [("none", True, False), ("decoder", True, True), ("decoder", False, False)]
)
def test_times_are_those_of_capture_since_1970_and_obstacles_need_a_tuned_network(
    bundle: Bundle, tmp_path: Path, tune: str, obstacles: bool, has_cloud: bool
) -> None:
    bundle = replace(bundle, provenance=bundle.provenance.model_copy(update={"tune": tune}))
    path = tmp_path / "flight.mcap"
    log = McapLog(recorder_of(path, bundle, obstacles), 1.7e9, Counter())
    for index in range(3):
        log.take(result_at(50.0 + index, step_at(np.eye(4))))
    log.close()
    found = topics_and_times(path)
    assert {time_ns for _, time_ns in found} == {(1_700_000_050 + index) * 10**9 for index in range(3)}
    assert ("/monoloc/obstacles" in {topic for topic, _ in found}) == has_cloud


def test_the_settings_say_where_down_is_and_how_the_camera_sits(bundle: Bundle) -> None:
    settings = FlightSettings.model_validate({"down": (0.0, 1.0, 0.0), "mount": {"pitch_deg": -90.0, "down_m": 0.1}})
    frames = ros_frames_of(bundle, settings)
    np.testing.assert_allclose(frames.T_map_room[:3, :3] @ [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(frames.T_base_camera[:3, 2], [0.0, 0.0, -1.0], atol=1e-12)  # it looks down
    np.testing.assert_allclose(frames.T_base_camera[:3, 3], [0.0, 0.0, -0.1], atol=1e-12)


def test_a_disk_that_fills_up_is_said_once(bundle: Bundle, tmp_path: Path) -> None:
    path, before = tmp_path / "flight.mcap", resource.getrlimit(resource.RLIMIT_FSIZE)
    log = McapLog(recorder_of(path, bundle), 0.0, Counter())
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(DataError, match=r"flight\.mcap: cannot be written \(File too large\); make room"):
            for index in range(2000):
                log.take(result_at(float(index), step_at(np.eye(4))))
            log.close()  # if the thread was slower
        log.take(result_at(2000.0, step_at(np.eye(4))))
        log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_stands_still_costs_images_first_then_frames_and_never_time(
    bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_log, "_MOST_IMAGES", 4)
    monkeypatch.setattr(mcap_log, "_MOST_FRAMES", 10)
    path, dropped = tmp_path / "flight.mcap", Counter[str]()
    recorder = recorder_of(path, bundle)
    add, begun, goes_on = recorder.add, threading.Event(), threading.Event()

    def slowly(time_s: float, color: NDArray[np.uint8] | None, step: Step, room: str | None) -> None:
        begun.set()
        assert goes_on.wait(30.0)
        add(time_s, color, step, room)

    monkeypatch.setattr(recorder, "add", slowly)
    log = McapLog(recorder, 0.0, dropped)
    log.take(result_at(0.0, step_at(np.eye(4))))
    assert begun.wait(30.0)  # with the first frame, which no longer waits
    began_s = time.monotonic()
    for index in range(1, 20):
        log.take(result_at(float(index), step_at(np.eye(4))))
    assert time.monotonic() - began_s < 1.0
    assert dropped == {"mcap images": 6, "mcap frames": 9}
    goes_on.set()
    log.close()  # which waits for all that was taken
    found = topics_and_times(path)
    assert [time_ns // 10**9 for topic, time_ns in found if topic == "/camera/image/compressed"] == [0, 1, 2, 3, 4]
    assert [time_ns // 10**9 for topic, time_ns in found if topic == "/monoloc/state"] == list(range(11))
