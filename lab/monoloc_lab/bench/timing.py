"""Timing that is robust against other load on the machine.

Compared functions take turns, and the fastest run of each counts. Times are processor times. Everything runs on one
thread, so they are the wall times on an idle machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec

Work = Callable[[], object]


def fastest_s(work: Mapping[str, Work], rounds: int) -> dict[str, float]:
    """Processor seconds of the fastest of ``rounds`` runs of each function, in turns, after one untimed run."""
    for run in work.values():
        run()
    times = {name: float("inf") for name in work}
    for _ in range(rounds):
        for name, run in work.items():
            started = time.process_time()
            run()
            times[name] = min(times[name], time.process_time() - started)
    return times


def has_sklearn() -> bool:
    """Whether scikit-learn, a development dependency, is installed."""
    return find_spec("sklearn") is not None


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit the matrix products of NumPy and scikit-learn to one thread, as for monoloc's kernels.

    This needs threadpoolctl, which scikit-learn installs. Without it NumPy may use more threads, and the ratios are
    too low.
    """
    if find_spec("threadpoolctl") is None:
        yield
        return
    with import_module("threadpoolctl").threadpool_limits(1):
        yield
