"""The ``monoloc`` command: one launcher, which turns known errors into one line and an exit code.

It imports next to nothing by itself, so that Ctrl-C is heard while the rest is imported.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

from monoloc.errors import MonolocError

_INTERRUPTED = 130  # 128 and the number of SIGINT, as shells have it; for all that ask monoloc to end


def run() -> None:
    """Entry point: exit code 0 when done, 2 for bad input with one line on stderr, 130 interrupted, 1 for a fault."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a degree sign is no reason to fail where there is ASCII alone
    _on_signals(_end_at_once)
    import monoloc.cli.app  # noqa: F401

    _on_signals(_interrupt)
    sys.exit(invoke(sys.argv[1:]))


def invoke(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    from monoloc.cli.app import carry_out

    try:
        return carry_out(arguments)
    except MonolocError as error:
        _say(str(error))
        return 2
    except OSError as error:
        if error.filename is None:
            raise
        _say(f"{error.filename}: {error.strerror}; check that it is there and that you may use it")
        return 2
    except KeyboardInterrupt:
        _say_interrupted()
        return _INTERRUPTED


def _say(message: str) -> None:
    print("monoloc: " + " ".join(message.split()), file=sys.stderr, flush=True)


def _say_interrupted() -> None:
    _say("interrupted; nothing half-written is left")


def _on_signals(handler: Callable[[int, FrameType | None], None]) -> None:
    """Who handles Ctrl-C, and being told to end; where they are ignored, as under nohup, they stay so."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _end_at_once(number: int, frame: FrameType | None) -> None:
    """Among imports, of which some would make a failure of their own of an exception; nothing is begun yet."""
    _say_interrupted()
    os._exit(_INTERRUPTED)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
