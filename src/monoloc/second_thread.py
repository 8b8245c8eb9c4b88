"""A second thread, for parts of a step that do not need one another."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

_Result = TypeVar("_Result")


class SecondThread:
    """Does work in the order in which it is begun.

    Args:
        exists: whether there is such a thread; if not, work is done by the thread that asks for its result.
    """

    def __init__(self, exists: bool) -> None:
        self._pool = ThreadPoolExecutor(1, "monoloc step") if exists else None

    def begin(self, work: Callable[[], _Result], is_needed: bool = True) -> Callable[[], _Result]:
        """Begin work; the function that is returned waits for its result.

        Args:
            is_needed: whether the result will be asked for. If not, the work is done only when it is.
        """
        future = self._pool.submit(work) if self._pool is not None and is_needed else None
        return cache(work if future is None else future.result)
