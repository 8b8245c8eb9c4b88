"""Objects and memory that start-up leaves behind."""

from __future__ import annotations

import ctypes
import gc
import subprocess
import sys
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


# Every second block stays, so that the C library cannot return what it freed by itself.
_LEAVES_FREED_MEMORY = """
from monoloc.settled_objects import settled
def resident_mb():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6
before_mb = resident_mb()
kept = [bytearray(20_000) for _ in range(6000)]
del kept[::2], kept[-1]
freed_mb = resident_mb()
with settled():
    print(freed_mb - before_mb, resident_mb() - before_mb)
"""


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="glibc alone can return it"
)
def test_memory_that_start_up_freed_is_returned() -> None:
    run = subprocess.run([sys.executable, "-c", _LEAVES_FREED_MEMORY], capture_output=True, text=True, check=True)
    freed_mb, settled_mb = map(float, run.stdout.split())
    assert freed_mb > 100.0
    assert settled_mb < 80.0
