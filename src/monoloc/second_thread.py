"""A second thread, for parts of a step that do not need one another."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

_Result = TypeVar("_Result")


class SecondThread:
    """Does work beside the thread that begins it.

    Args:
        exists: whether there is such a thread, which does work in the order in which it is begun. If not, work is
            done by the thread that asks for its result, when it does, and never if none does.
    """

    def __init__(self, exists: bool) -> None:
        self._exists = exists
        self._pool, self._process = ThreadPoolExecutor(1, "monoloc step"), os.getpid()

    def begin(self, work: Callable[[], _Result], is_needed: bool = True) -> Callable[[], _Result]:
        """Have work done, once; the function that is returned gives its result.

        With a second thread, the work is begun, and the function waits for it. Without one, the function does it.

        Args:
            is_needed: whether the result will be asked for. If not, the work is done only when it is.
        """
        if not self._exists or not is_needed:
            return cache(work)
        if self._process != os.getpid():  # after a fork, which leaves the thread behind
            self._pool, self._process = ThreadPoolExecutor(1, "monoloc step"), os.getpid()
        return cache(self._pool.submit(work).result)
