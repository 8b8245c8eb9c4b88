"""Signals that end a flight: it stops between two frames, and everything is written."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

TERMINATION = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that ask for the end; Windows has no SIGHUP."""


@contextmanager
def stopped_by_signals() -> Iterator[Callable[[], bool]]:
    """Whether a signal asked for the end. The next one interrupts at once, where a driver hangs.

    A terminal that hangs up sends its signal twice, by the shell and by the kernel: that one never interrupts.
    """
    asked = False  # not an Event: setting it takes a lock, for which a second signal would wait forever
    before = {number: signal.getsignal(number) for number in TERMINATION}

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked = True
        for each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, before[each])

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, ask)
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
