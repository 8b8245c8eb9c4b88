"""Signals that end a flight: it stops between two frames, and everything is written."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

TERMINATION = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that ask for the end; Windows has no SIGHUP."""

_TOGETHER_S = 1.0  # in which a signal counts once: timeout(1), for one, sends it to the process and to its group


@contextmanager
def stopped_by_signals() -> Iterator[Callable[[], bool]]:
    """Whether a signal asked for the end. One that comes a second later interrupts at once, where a driver hangs.

    A terminal that hangs up sends its signal twice, by the shell and by the kernel: that one never interrupts.
    """
    asked_s = math.inf  # not an Event: setting it takes a lock, for which a second signal would wait forever
    before = {number: signal.getsignal(number) for number in TERMINATION}

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked_s
        now_s = time.monotonic()
        asked_s = min(asked_s, now_s)
        if now_s - asked_s > _TOGETHER_S and number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, before[signal.Signals(number)])
            signal.raise_signal(number)

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, ask)
    try:
        yield lambda: asked_s < math.inf
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
