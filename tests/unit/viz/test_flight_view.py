"""What a viewer shows of a flight, and that the flight does not wait for it."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun

from mavlink_helpers import CAMERA, result_at, step_at
from monoloc.bundle import Bundle
from monoloc.errors import SettingError
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.flight_settings import Mount
from monoloc.flight.in_place import InPlace
from monoloc.geometry import invert, make_pose
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.particle_filter.particles import Particles
from monoloc.supervision.state import Reason
from monoloc.viz.flight_drawing import FlightDrawing, flight_blueprint
from monoloc.viz.flight_view import FlightView, _check_free, disconnect, has_connection
from synthetic_room import room_bundle
from viewer_helpers import Recorded

PARTICLES = Particles(np.eye(4)[None], np.zeros(1), np.zeros(1))
RESULT = result_at(1.0, step_at(np.eye(4)))
SOON_S = 20.0


def until(holds: Callable[[], bool]) -> None:
    end_s = time.monotonic() + SOON_S
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def in_place(result: FlightStep, entered: Bundle | None) -> FlightStep:
    return replace(result, in_place=InPlace("kitchen", entered, result.step.estimate, False))


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return room_bundle(60)


class Held:
    """A drawing that hangs until it is released."""

    def __init__(self) -> None:
        self.drawn: list[float] = []
        self.entered: list[Bundle | None] = []
        self.begun, self.release = threading.Event(), threading.Event()

    def show(self, result: FlightStep, particles: Particles) -> None:
        self.begun.set()
        self.release.wait(SOON_S)
        self.drawn.append(result.frame.captured_s)
        self.entered.append(None if result.in_place is None else result.in_place.entered)


def test_while_nobody_looks_nothing_is_drawn_nor_even_asked_for() -> None:
    drawing, looked = Held(), threading.Event()

    def is_watched() -> bool:
        looked.set()
        return False

    def particles() -> Particles:
        raise AssertionError("nobody looks")

    view = FlightView(drawing, particles, is_watched)
    assert looked.wait(SOON_S)
    for index in range(20):
        view.take(result_at(0.2 * index, step_at(np.eye(4))))
    view.close()
    assert drawing.drawn == []


def test_a_viewer_that_hangs_holds_up_nobody() -> None:
    drawing = Held()
    view = FlightView(drawing, lambda: PARTICLES, lambda: True)
    until(lambda: view.take(RESULT) or drawing.begun.is_set())
    for index in range(1, 50):
        view.take(result_at(1.0 + 0.2 * index, step_at(np.eye(4))))
    assert drawing.drawn == []  # it hangs still, and every frame was taken
    drawing.release.set()
    view.close()
    assert 1 <= len(drawing.drawn) <= 3


def test_a_room_that_was_entered_while_nobody_looked_is_drawn_with_the_next_frame(bundle: Bundle) -> None:
    drawing, is_watched = Held(), threading.Event()
    drawing.release.set()
    view = FlightView(drawing, lambda: PARTICLES, is_watched.is_set)
    view.take(in_place(RESULT, bundle))
    is_watched.set()
    until(lambda: view.take(in_place(RESULT, None)) or len(drawing.entered) > 0)
    view.close()
    assert drawing.entered[0] is bundle


def test_a_connection_is_seen_when_it_is_there() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert not has_connection(port)
        with socket.create_connection(("127.0.0.1", port)):
            assert has_connection(port)
        with pytest.raises(SettingError, match=f"^--view-port: needs the port {port}, .*; give another one"):
            _check_free(port)


def test_a_flight_is_drawn_with_obstacles_and_latency(bundle: Bundle, tmp_path: Path) -> None:
    """A wall two metres ahead of a camera that looks along the map's x axis, 30 cm ahead of the vehicle's origin."""
    mount = Mount(forward_m=0.3).T_body_camera
    frames = AutopilotFrames(mount, [0.0, 0.0, -1.0], 0.0)
    pose = invert(frames.T_ned_world) @ make_pose(np.eye(3), [0.5, 0.0, -1.0]) @ mount
    far = replace(bundle.original, means=bundle.original.means + 50.0)  # the map knows nothing of the wall
    tuned = bundle.provenance.model_copy(update={"tune": "last"})
    untuned, bundle = bundle, replace(bundle, original=far, provenance=tuned)
    stream = rerun.RecordingStream("monoloc fly")
    stream.set_log_tick_enabled(False)
    stream.set_log_time_enabled(False)
    stream.save(tmp_path / "flight.rrd", default_blueprint=flight_blueprint())
    drawing = FlightDrawing(stream, None, CAMERA, frames)
    drawing.show(RESULT, PARTICLES)  # not drawn: no room of the place is known
    drawing.show(in_place(result_at(5.0, step_at(pose), age_s=0.04), bundle), PARTICLES)
    for index in range(1, 3):
        drawing.show(result_at(5.0 + 0.1 * index, step_at(pose), age_s=0.04), PARTICLES)
    lost = replace(step_at(pose, "lost", frozenset({Reason.SEARCHING})), depth=None)
    drawing.show(result_at(5.3, lost, age_s=0.04), PARTICLES)
    drawing.show(result_at(5.4, step_at(pose), age_s=0.04), PARTICLES)
    drawing.show(in_place(result_at(5.5, step_at(pose), age_s=0.04), untuned), PARTICLES)
    stream.disconnect()
    recorded = Recorded(tmp_path / "flight.rrd")
    assert len(recorded.reader.blueprints()) == 1
    assert recorded.entities >= {
        "/world/map",
        "/world/camera/image",
        "/depth",
        "/world/particles",
        "/state",
        "/reasons",
    }
    latencies = np.concatenate(list(recorded.frames("/latency_ms", "Scalars:scalars", "seconds").values()))
    np.testing.assert_allclose(latencies, 40.0, atol=1e-6)
    by_time = recorded.frames("/world/obstacles", "LineStrips3D:strips", "seconds")
    shown = [arcs for _, arcs in sorted(by_time.items())]
    # Those of a frame before are not left while it is lost, nor in a room whose network was not tuned.
    assert [len(arcs) > 0 for arcs in shown] == [True, True, True, False, True, False]
    arcs = np.array(shown[2])
    middle = arcs.mean(axis=1)
    ahead = middle[np.abs(middle[:, 1]) < 0.1]
    np.testing.assert_allclose(ahead, [[2.8, 0.0, 1.0]], atol=0.03)


def test_a_window_that_hangs_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A viewer that takes a connection and reads nothing, as one forwarded to a laptop that sleeps."""
    left_out: list[bool] = []
    monkeypatch.setattr(rerun, "unregister_shutdown", lambda: left_out.append(True))
    with socket.create_server(("127.0.0.1", 0)) as viewer:
        stream = rerun.RecordingStream("test")
        stream.connect_grpc(f"rerun+http://127.0.0.1:{viewer.getsockname()[1]}/proxy")
        stream.log("text", rerun.TextLog("hello"))
        ended = threading.Thread(target=disconnect, args=[stream], daemon=True)
        ended.start()
        ended.join(SOON_S)
        assert not ended.is_alive() and left_out == [True]
