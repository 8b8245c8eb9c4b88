"""Entry point of the ``monoloc`` command. It reports known errors as one line and an exit code.

This module imports very little, so that Ctrl-C works during the other imports.
"""

from __future__ import annotations

import atexit
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from types import FrameType

from monoloc.cli.stop_signals import TERMINATION
from monoloc.cli.streams import ReaderGoneError, secure_streams
from monoloc.errors import MonolocError
from monoloc.printable import printable

# 128 plus the number of a signal, as in shells: SIGINT, which stands for all termination signals, and SIGPIPE.
_INTERRUPTED = 130
_READER_GONE = 141
_CLEANING_UP_S = 1.0  # in which no second signal interrupts; later ones do, as some libraries swallow the first


def run() -> None:
    """Run the command line and exit.

    0 done; 1 internal fault; 2 bad input, or a result that cannot be written (one line on stderr); 130 interrupted;
    141 nobody reads the result any more.
    """
    secure_streams()
    # NumPy's sums, and so poses, depend on it. It looks when it is imported; PyTorch has threads of its own.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    # PyTorch's threads would wait busily for one another, for a quarter of a build's processor time.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    _on_signals(_end_at_once)
    from monoloc.cli.app import command_line

    command_line(sys.argv[1:])
    _on_signals(_interrupting())
    code = invoke(sys.argv[1:])
    # Python's own end takes some tenths of a second, in which a signal would print a traceback. First it waits for
    # threads, which may hang; then it takes handlers away, and a signal would change the exit code.
    _on_signals(lambda number, frame: os._exit(code))
    atexit.register(_on_signals, signal.SIG_IGN)
    sys.exit(code)


def invoke(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    from monoloc.cli.app import carry_out

    try:
        code = carry_out(arguments)
        sys.stdout.flush()
        return code
    except MonolocError as error:
        _print_message(_with_page(error))
        return _READER_GONE if isinstance(error, ReaderGoneError) else 2
    except OSError as error:
        if error.filename is None:
            raise
        _print_message(f"{error.filename}: {error.strerror}; check that it is there and that you may use it")
        return 2
    except KeyboardInterrupt:
        _print_interrupted()
        return _INTERRUPTED


def _with_page(error: MonolocError) -> str:
    """The error's message, with the address of its page."""
    from monoloc.documentation import page_address

    return str(error) if error.page is None else f"{error} (see: {page_address(error.page)})"


def _print_message(message: str) -> None:
    print("monoloc: " + printable(" ".join(message.split())), file=sys.stderr, flush=True)


def _print_interrupted() -> None:
    _print_message("interrupted; nothing half-written is left")


def _on_signals(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    """Install the handler of Ctrl-C and of termination signals, except those that are ignored, as under nohup."""
    for number in TERMINATION:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _end_at_once(number: int, frame: FrameType | None) -> None:
    """Exit immediately. Some imports would turn an exception into another error, and there is nothing to clean up."""
    _print_interrupted()
    os._exit(_INTERRUPTED)


def _interrupting() -> Callable[[int, FrameType | None], None]:
    """Handler that raises KeyboardInterrupt; not again soon, so that a second Ctrl-C does not end the cleaning up."""
    raised_s = -math.inf

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal raised_s
        if time.monotonic() - raised_s > _CLEANING_UP_S:
            raised_s = time.monotonic()
            raise KeyboardInterrupt

    return interrupt
