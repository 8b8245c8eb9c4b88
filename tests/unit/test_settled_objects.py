"""Objects that Python's search for reference cycles leaves out during a flight."""

from __future__ import annotations

import gc
import weakref

import pytest

from monoloc.settled_objects import settled


class _Cycle:
    def __init__(self) -> None:
        self.itself = self


def cycle() -> weakref.ref[_Cycle]:
    return weakref.ref(_Cycle())


def test_what_exists_before_is_left_out_until_the_end() -> None:
    """Cycles that a flight makes are still found, and older ones after it."""
    gc.collect()
    gc.disable()  # so that only this test's searches find them
    try:
        before = cycle()
        with pytest.raises(RuntimeError), settled():
            during = cycle()
            gc.collect()
            assert during() is None and before() is not None and gc.get_freeze_count() > 0
            raise RuntimeError
        assert gc.get_freeze_count() == 0
        gc.collect()
        assert before() is None
    finally:
        gc.enable()
