"""A viewer in flight: in Rerun's window, or served to a browser. While nobody looks, it costs nothing."""

from __future__ import annotations

import queue
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol
from uuid import uuid4

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.flight.flight_loop import FlightOutput, FlightStep
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.particle_filter.particles import Particles
from monoloc.rate_limiter import RateLimiter
from monoloc.viz.viewer import WINDOW_PORT, open_window

if TYPE_CHECKING:
    from rerun import RecordingStream

_MOST_HZ = 10.0  # frames that are shown
_LOOK_S = 1.0  # between looks for a viewer
_MEMORY = "128MiB"  # of what a viewer that comes later is shown
_SOCKETS = ("/proc/net/tcp", "/proc/net/tcp6")
_ESTABLISHED = "01"


class Drawing(Protocol):
    """Shows a frame; :class:`monoloc.viz.flight_drawing.FlightDrawing` is one."""

    def show(self, result: FlightStep, particles: Particles) -> None: ...


class FlightView:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that shows ten frames a second, in a thread of its own.

    The flight hands over the newest frame and waits for nothing: a frame that comes while another is drawn is not
    shown.

    Args:
        drawing: shows a frame.
        particles: of the localizer, after its last step.
        is_watched: whether anybody looks; asked once a second.
    """

    def __init__(self, drawing: Drawing, particles: Callable[[], Particles], is_watched: Callable[[], bool]) -> None:
        self._drawing, self._particles, self._is_watched = drawing, particles, is_watched
        self._queue: queue.Queue[tuple[FlightStep, Particles] | None] = queue.Queue(1)
        self._entered: Bundle | None = None  # of a place, since the last frame that was shown
        self._has_watcher = False
        self._rate = RateLimiter(_MOST_HZ)
        self._closing = threading.Event()
        self._threads = [threading.Thread(target=run, name="view", daemon=True) for run in (self._look, self._draw)]
        for thread in self._threads:
            thread.start()

    def take(self, result: FlightStep) -> None:
        if result.in_place is not None:
            self._entered = result.in_place.entered or self._entered
            result = replace(result, in_place=replace(result.in_place, entered=self._entered))
        if not self._has_watcher or not self._rate.is_due(result.done_s):
            return
        try:
            self._queue.put_nowait((result, self._particles()))
            self._entered = None
            self._rate.use(result.done_s)
        except queue.Full:
            pass

    def idle(self, now_s: float) -> None:
        """Nothing: there is no image."""

    def close(self) -> None:
        self._closing.set()
        try:
            self._queue.put(None, timeout=_LOOK_S)
        except queue.Full:  # a viewer that hangs
            return
        self._threads[1].join(_LOOK_S)

    def _look(self) -> None:
        while not self._closing.is_set():
            self._has_watcher = self._is_watched()
            self._closing.wait(_LOOK_S)

    def _draw(self) -> None:
        while (given := self._queue.get()) is not None:
            self._drawing.show(*given)


@contextmanager
def flight_view(
    name: str,
    port: int | None,
    room: Bundle | None,
    camera: Camera,
    frames: AutopilotFrames | None,
    particles: Callable[[], Particles],
) -> Iterator[tuple[FlightOutput, str]]:
    """Context for a viewer, and what to tell the user.

    Args:
        name: of the recording in the viewer.
        port: of the web page, the next one is that of the data; None opens a window.
        room, camera: of the flight; no room in a place.
        frames: of the vehicle, for obstacles; None shows none.
        particles: see :class:`FlightView`.

    Raises:
        SettingError: the window cannot be opened, or the port is taken.
    """
    import rerun

    from monoloc.viz.flight_drawing import FlightDrawing, flight_blueprint

    stream = rerun.RecordingStream("monoloc fly", recording_id=uuid4())
    stream.set_log_tick_enabled(False)
    stream.set_log_time_enabled(False)
    if port is None:
        open_window()
        stream.connect_grpc(f"rerun+http://127.0.0.1:{WINDOW_PORT}/proxy", default_blueprint=flight_blueprint())
        data_port, remark = WINDOW_PORT, "view: in Rerun's window"
    else:
        data_port, remark = port + 1, _serve(stream, port)
    stream.send_recording_name(name)
    try:
        drawing = FlightDrawing(stream, room, camera, frames)
        yield FlightView(drawing, particles, lambda: has_connection(data_port)), remark
    finally:
        disconnect(stream)


def disconnect(stream: RecordingStream) -> None:
    """Hand over what a viewer was not given yet, within a second.

    For a viewer that hangs, Rerun itself would wait for ever: here, where no signal would end it, and when the
    program ends.
    """
    import rerun

    thread = threading.Thread(target=stream.disconnect, name="view", daemon=True)
    thread.start()
    thread.join(_LOOK_S)
    if thread.is_alive():
        rerun.unregister_shutdown()


def _serve(stream: RecordingStream, port: int) -> str:
    """Serve the data and a page that shows it; returns the page's address."""
    import rerun

    from monoloc.viz.flight_drawing import flight_blueprint

    for each in (port, port + 1):
        _check_free(each)
    rerun.serve_grpc(
        grpc_port=port + 1,
        default_blueprint=flight_blueprint(),
        recording=stream,
        server_memory_limit=_MEMORY,
        newest_first=True,
        cors_allow_origin=[f"http://*:{port}"],
    )
    rerun.serve_web_viewer(web_port=port, open_browser=False)
    host = socket.gethostname()
    return f"view: http://{host}:{port}/?url=rerun%2Bhttp://{host}:{port + 1}/proxy"


def _check_free(port: int) -> None:
    try:
        with socket.create_server(("0.0.0.0", port)):
            pass
    except OSError as error:
        problem = f"needs the port {port}, which is not free ({error.strerror})"
        raise SettingError("--view-port", problem, "give another one") from error


def has_connection(port: int) -> bool:
    """Whether a TCP connection to a port of this machine exists; true where the system does not tell."""
    if sys.platform != "linux":
        return True
    ending = f":{port:04X}"
    for table in _SOCKETS:
        try:
            lines = Path(table).read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue
        for line in lines:
            _, local, _, state, *_ = line.split()
            if state == _ESTABLISHED and local.endswith(ending):
                return True
    return False
