"""Kinds of tasks for tests of the engine; in a module of its own, so that worker processes can import it."""

from __future__ import annotations

import errno
import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.errors import DataError
from monoloc_lab.experiments.task import Result, Task

Settings = dict[str, Any]
WAIT_S = 20.0


def add(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """The sum of a number and of the needs; every execution leaves a file in ``log``."""
    log = Path(settings["log"])
    (log / f"{settings['number']}-{len(list(log.iterdir()))}").touch()
    (folder / "beside.txt").write_text("written")
    return {"sum": settings["number"] + sum(need.figures["sum"] for need in needs), "process": os.getpid()}


def meet(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """Ends only while the other of two tasks runs."""
    place = Path(settings["log"])
    (place / settings["name"]).touch()
    until = time.monotonic() + WAIT_S
    while not (place / settings["other"]).exists():
        if time.monotonic() > until:
            raise TimeoutError("the other task did not start")
        time.sleep(0.01)
    return {"process": os.getpid()}


def linger(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """Does not end."""
    (folder / "half").touch()
    (Path(settings["log"]) / "lingering").touch()
    time.sleep(600.0)
    return {}


def nap(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    (Path(settings["log"]) / settings["name"]).touch()
    time.sleep(1.0)
    return {}


def refuse(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    raise DataError("kitchen", "has no depth", "give another")


def crash(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    raise ZeroDivisionError("a fault")


def fill(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """Fails as on a full disk."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def killed(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    """Ends as a process does for which there is no memory."""
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def threads(settings: Settings, needs: Sequence[Result], folder: Path) -> Settings:
    import cv2
    import torch

    return {"cv2": cv2.getNumThreads(), "torch": torch.get_num_threads(), "omp": os.environ["OMP_NUM_THREADS"]}


KINDS = {
    "add": add,
    "meet": meet,
    "linger": linger,
    "nap": nap,
    "refuse": refuse,
    "crash": crash,
    "fill": fill,
    "killed": killed,
    "threads": threads,
}


def number(log: Path, value: int, *needs: Task) -> Task:
    return Task.of("add", {"number": value, "log": str(log)}, needs)


def pair(log: Path) -> list[Task]:
    """Two tasks that must run at the same time."""
    names = ("one", "two")
    return [
        Task.of("meet", {"log": str(log), "name": name, "other": other}) for name, other in (names, reversed(names))
    ]
