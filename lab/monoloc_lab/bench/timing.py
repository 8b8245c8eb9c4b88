"""Times that a busy machine does not spoil.

Runs of what is compared take turns, and the fastest of each counts. What is counted is the processor's time:
everything here runs on one thread, so it is what a clock would show on a machine with nothing else to do.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec

Work = Callable[[], object]


def fastest_s(work: Mapping[str, Work], rounds: int) -> dict[str, float]:
    """Processor seconds of the fastest of ``rounds`` runs of each, taking turns, after a run that is not timed."""
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
    """Whether scikit-learn, a development dependency, is there to be compared with."""
    return find_spec("sklearn") is not None


@contextmanager
def one_thread() -> Iterator[None]:
    """NumPy's and scikit-learn's matrix products on one thread, as monoloc's kernels are.

    threadpoolctl, which does it, comes with scikit-learn. Without it NumPy uses what it likes, and the ratios are too
    low rather than too high.
    """
    if find_spec("threadpoolctl") is None:
        yield
        return
    with import_module("threadpoolctl").threadpool_limits(1):
        yield
