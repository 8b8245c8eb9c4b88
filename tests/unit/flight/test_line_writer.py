"""Lines to a pipe that is read, is full, or is closed."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator

import pytest

from monoloc.flight.line_writer import LineWriter


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """Its ends for reading and for writing."""
    reading, writing = os.pipe()
    yield reading, writing
    for end in (reading, writing):
        with contextlib.suppress(OSError):  # a test closed it
            os.close(end)


def test_lines_come_in_order_and_close_waits_for_them(pipe: tuple[int, int]) -> None:
    writer = LineWriter(pipe[1])
    for number in range(50):
        writer.write(f"{number}°")
    writer.close()
    assert os.read(pipe[0], 1 << 16).decode() == "".join(f"{number}°\n" for number in range(50))
    assert writer.dropped == 0


def test_a_full_pipe_makes_nobody_wait_and_what_was_dropped_is_said(pipe: tuple[int, int]) -> None:
    writer = LineWriter(pipe[1])
    ended = threading.Event()

    def speak() -> None:
        for _ in range(1000):
            writer.write("x" * 1000)  # a megabyte, of which a pipe takes 64 KiB
        writer.close()
        ended.set()

    threading.Thread(target=speak, daemon=True).start()
    assert ended.wait(30.0)
    assert writer.dropped > 500
    read = b""
    while b"lines were not written" not in read:
        read += os.read(pipe[0], 1 << 16)


def test_a_pipe_that_nobody_will_read_again_ends_the_writing_alone(pipe: tuple[int, int]) -> None:
    writer = LineWriter(pipe[1])
    os.close(pipe[0])
    writer.write("a")
    writer.write("b")
    writer.close()
    assert writer.dropped == 2


def test_a_full_pipe_that_does_not_wait_is_written_to_again_when_it_is_read(pipe: tuple[int, int]) -> None:
    """As a terminal that a program beside this one has made so."""
    os.set_blocking(pipe[1], False)
    writer = LineWriter(pipe[1])
    for _ in range(80):
        writer.write("x" * 1000)  # of which a pipe takes 64 KiB
    writer.close()  # does not wait for them
    assert writer.dropped == 0
    read = b""
    while len(read) < 80 * 1001:
        read += os.read(pipe[0], 1 << 16)
