import signal
import subprocess
import sys

import pytest

AGAIN_AT_EVERY_LINE = """
import signal, sys
from monoloc.cli.stop_signals import stopped_by_signals

def again(frame, event, argument):
    signal.raise_signal(signal.SIGHUP)
    return again

signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it, and a child inherits that
with stopped_by_signals() as asked:
    sys.settrace(again)
    signal.raise_signal(signal.SIGHUP)
    sys.settrace(None)
    print(asked())
"""


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no SIGHUP")
def test_a_second_signal_may_come_at_any_line_of_the_handler_of_the_first() -> None:
    done = subprocess.run([sys.executable, "-c", AGAIN_AT_EVERY_LINE], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr


TWICE = """
import signal, time
from monoloc.cli import stop_signals

signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it, and a child inherits that
with stop_signals.stopped_by_signals() as asked:
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)
    print(asked())
    stop_signals._TOGETHER_S = -1.0
    signal.raise_signal(signal.SIGINT)
"""


def test_a_signal_that_is_sent_twice_interrupts_nothing_and_a_later_one_does() -> None:
    done = subprocess.run([sys.executable, "-c", TWICE], capture_output=True, text=True, timeout=60)
    assert done.stdout == "True\n" and "KeyboardInterrupt" in done.stderr
