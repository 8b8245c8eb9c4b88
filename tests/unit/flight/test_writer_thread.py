"""A writer that stands still: nobody waits longer than asked, and nothing that was taken is lost."""

from __future__ import annotations

import threading
import time

import pytest

from monoloc.flight.writer_thread import WriterThread


def test_a_writer_that_stands_still_holds_nobody_up_and_writes_later_what_it_took() -> None:
    written: list[int] = []
    begun, goes_on = threading.Event(), threading.Event()

    def write(item: int) -> None:
        begun.set()
        assert goes_on.wait(30.0)
        written.append(item)

    thread = WriterThread("test", write, 3)
    assert thread.put(0) and begun.wait(30.0)
    began_s = time.monotonic()
    assert [thread.put(item) for item in range(1, 6)] == [True, True, True, False, False]
    assert time.monotonic() - began_s < 1.0 and thread.waiting == 3
    assert not thread.put(6, wait_s=0.05)
    assert written == []
    goes_on.set()
    thread.close()
    assert written == [0, 1, 2, 3]


def test_after_a_failure_nothing_is_written_and_it_is_raised_once() -> None:
    written: list[int] = []

    def write(item: int) -> None:
        written.append(10 // item)

    thread = WriterThread("test", write, 100)
    with pytest.raises(ZeroDivisionError):
        for item in (5, 0, 2):
            assert thread.put(item)
        thread.close()  # if it was not known before
    assert written == [2] and thread.has_failed
    thread.close()
