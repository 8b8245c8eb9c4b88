"""The thread that keeps a camera's newest frame: nothing old is given, nothing that happens in it vanishes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from queue import Queue

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.live import newest_frame
from monoloc.live.frame_source import CameraGoneError, EndOfStreamError
from monoloc.live.newest_frame import NewestFrame

WAIT_S = 10.0  # for what comes at once, unless it never comes


class Camera:
    """A grabber that gives what is put into it: a number is an image captured then, an exception is raised."""

    def __init__(self, *opens: bool) -> None:
        self.name = "a camera"
        self.given: Queue[float | Exception] = Queue()
        self.opens = iter(opens)  # whether it can be opened, and always after that
        self.opened_s: list[float] = []  # times of the attempts
        self.grabs = 0
        self.is_open = False

    def open(self) -> None:
        assert not self.is_open
        self.opened_s.append(time.monotonic())
        if not next(self.opens, True):
            raise DataError(self.name, "is absent", "plug it in")
        self.is_open = True

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        assert self.is_open
        self.grabs += 1
        item = self.given.get()
        if isinstance(item, Exception):
            raise item
        return np.full((1, 1, 3), round(item), np.uint8), item

    def close(self) -> None:
        self.is_open = False

    @property
    def tried(self) -> int:
        return len(self.opened_s)


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(newest_frame, "_FIRST_RETRY_S", 0.01)
    monkeypatch.setattr(newest_frame, "_LAST_RETRY_S", 0.02)


@contextmanager
def source_of(camera: Camera) -> Iterator[NewestFrame]:
    with closing(NewestFrame(camera)) as source:
        try:
            yield source
        finally:
            camera.given.put(EndOfStreamError())  # lets the thread out of the driver


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.002)


def test_a_slow_reader_is_given_the_newest_frame_once_and_its_number_tells_what_was_dropped() -> None:
    camera = Camera()
    with source_of(camera) as source:
        for captured_s in range(5):
            camera.given.put(float(captured_s))
        wait_for(lambda: camera.grabs == 6)
        frame = source.next(WAIT_S)
        assert frame is not None and (frame.captured_s, frame.sequence) == (4.0, 4) and frame.color[0, 0, 0] == 4
        assert source.next(0.0) is None
        camera.given.put(9.0)
        frame = source.next(WAIT_S)
        assert frame is not None and (frame.captured_s, frame.sequence) == (9.0, 5)


def test_a_camera_that_was_gone_comes_back_and_counts_when_it_gives_an_image() -> None:
    """Three attempts fail, one opens a camera that is gone at once."""
    camera = Camera(True, False, False, False, True, True)
    with source_of(camera) as source:
        camera.given.put(1.0)
        assert source.next(WAIT_S) is not None
        camera.given.put(CameraGoneError())
        camera.given.put(CameraGoneError())
        wait_for(lambda: camera.tried == 6)
        assert source.next(0.0) is None and source.reconnections == 0
        camera.given.put(2.0)
        frame = source.next(WAIT_S)
        assert frame is not None and (frame.captured_s, frame.sequence) == (2.0, 1)
        assert source.reconnections == 1


def test_a_camera_that_opens_and_gives_nothing_is_tried_ever_more_rarely(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(newest_frame, "_LAST_RETRY_S", 0.08)
    camera = Camera()
    with source_of(camera) as source:
        for _ in range(6):
            camera.given.put(CameraGoneError())
        wait_for(lambda: camera.tried == 7)
        assert (np.diff(camera.opened_s) >= [0.01, 0.02, 0.04, 0.08, 0.08, 0.08]).all()
        assert source.reconnections == 0


def test_the_last_frame_is_given_before_the_end_is_said_every_time() -> None:
    camera = Camera()
    with source_of(camera) as source:
        camera.given.put(1.0)
        camera.given.put(EndOfStreamError())
        wait_for(lambda: not camera.is_open)
        assert source.next(WAIT_S) is not None
        for _ in range(2):
            with pytest.raises(EndOfStreamError):
                source.next(WAIT_S)


@pytest.mark.parametrize("failure", [DataError("a camera", "gives nonsense", "mend it"), ZeroDivisionError("a bug")])
def test_what_fails_in_the_thread_is_raised_in_the_reader_and_the_camera_released(failure: Exception) -> None:
    camera = Camera()
    with source_of(camera) as source:
        camera.given.put(failure)
        with pytest.raises(type(failure)) as raised:
            source.next(WAIT_S)
        assert raised.value is failure
        wait_for(lambda: not camera.is_open)


def test_a_camera_that_is_absent_at_the_start_is_an_error_and_leaves_no_thread() -> None:
    before = threading.active_count()
    with pytest.raises(DataError, match="is absent"):
        NewestFrame(Camera(False))
    assert threading.active_count() == before


def test_close_stops_the_thread_also_where_the_camera_is_gone_and_twice_is_once() -> None:
    before = threading.active_count()
    camera = Camera(True, *[False] * 1000)
    source = NewestFrame(camera)
    camera.given.put(CameraGoneError())
    wait_for(lambda: camera.tried > 2)
    source.close()
    assert threading.active_count() == before and not camera.is_open
    source.close()


def test_close_does_not_wait_for_a_driver_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(newest_frame, "_JOIN_S", 0.05)
    camera = Camera()
    source = NewestFrame(camera)  # it waits in grab()
    began_s = time.monotonic()
    source.close()
    assert time.monotonic() - began_s < WAIT_S
    camera.given.put(1.0)  # the driver returns
    wait_for(lambda: not camera.is_open)
