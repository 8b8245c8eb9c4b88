"""A thread that writes, so that a flight does not wait for a disk."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class WriterThread(Generic[T]):
    """Hands items to a function in a thread of its own, in order.

    After a failure nothing more is written. The failure is raised once, to who hands over or closes next.

    Args:
        name: of the thread.
        write: is called with each item, by the thread alone.
        most_waiting: items that wait at most.
    """

    def __init__(self, name: str, write: Callable[[T], None], most_waiting: int) -> None:
        self._write = write
        self._queue: queue.Queue[T | None] = queue.Queue(most_waiting)
        self._failure: Exception | None = None
        self._is_known = False  # to the flight, that it failed
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Number of items that are not being written yet."""
        return self._queue.qsize()

    @property
    def has_failed(self) -> bool:
        """Whether an item could not be written."""
        return self._failure is not None

    def put(self, item: T, wait_s: float = 0.0) -> bool:
        """Hand over an item, and return whether there was room for it within a time.

        Raises:
            Exception: what an earlier item raised, unless it was raised before.
        """
        self._raise_failure()
        try:
            self._queue.put(item, block=wait_s > 0.0, timeout=wait_s)
        except queue.Full:
            return False
        return True

    def fail(self, failure: Exception) -> None:
        """Write nothing more of what waits, and raise the failure, once.

        Raises:
            Exception: the failure.
        """
        self._failure = failure
        self._raise_failure()

    def close(self, release: Callable[[], None] = lambda: None) -> None:
        """Wait until all is written.

        Args:
            release: closes the file that the thread wrote to. Where an interrupt ends the wait it is not called: the
                thread may hang in a write, and holds a lock of the file, for which no interrupt ends a wait.

        Raises:
            Exception: as :meth:`put`.
        """
        self._queue.put(None)
        self._thread.join()
        try:
            self._raise_failure()
        finally:
            release()

    def _raise_failure(self) -> None:
        if self._failure is not None and not self._is_known:
            self._is_known = True
            raise self._failure

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._failure is None:  # else it only empties the queue, on which the flight may wait
                try:
                    self._write(item)
                except Exception as error:
                    self._failure = error
