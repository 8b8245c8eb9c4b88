"""Progress of long tasks on stderr, with rate and remaining time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from rich import progress as rich_progress
from rich.console import Console
from rich.text import Text

from monoloc.printable import printable

_LOG_INTERVAL_S = 30.0  # in a log; a longer silence looks like a hang


class Step(Protocol):
    """Reports the number of completed steps of a task, with an optional remark."""

    def __call__(self, done: int, remark: str = "", /) -> None: ...


class Progress(Protocol):
    """Shows the progress of tasks. Library code reports to this interface only."""

    def task(self, name: str, total: int | None) -> AbstractContextManager[Step]:
        """Context whose value is called with the number of completed steps; ``total`` is None if unknown."""
        ...


class NoProgress:
    """Shows nothing; the default for library use."""

    @contextmanager
    def task(self, name: str, total: int | None) -> Iterator[Step]:
        yield _say_nothing


def _say_nothing(done: int, remark: str = "", /) -> None:
    pass


class _Rate(rich_progress.ProgressColumn):
    def render(self, task: rich_progress.Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(_rate(speed), style="progress.data.speed") if speed else Text("")


def _rate(steps_per_s: float) -> str:
    return f"{steps_per_s:.1f}/s" if steps_per_s >= 1.0 else f"{1.0 / steps_per_s:.1f} s each"


class ConsoleProgress:
    """Shows progress bars on a terminal.

    If stderr is not a terminal, it prints a line for each remark and each finished task, and one every 30 s.
    """

    def __init__(self, console: Console) -> None:
        self._console = console

    @contextmanager
    def task(self, name: str, total: int | None) -> Iterator[Step]:
        if not self._console.is_terminal:
            # Output goes to a log or another program: no bars, and no final line for a task that fails.
            started = logged = time.perf_counter()
            first: int | None = None

            def log(done: int, remark: str = "", /) -> None:
                nonlocal first, logged
                first = done - 1 if first is None else first  # a resumed task does not start at 0
                now = time.perf_counter()
                if not remark and now - logged < _LOG_INTERVAL_S:
                    return
                logged = now
                how = remark or _rate((done - first) / (now - started))
                if total is None:
                    self._console.print(f"{name}: {done}, {how}")
                    return
                share = "" if remark else f" ({100.0 * done / total:.0f} %)"
                remaining_s = (now - started) * (total - done) / (done - first)
                self._console.print(f"{name}: {done} of {total}{share}, {how}, {remaining_s:.0f} s remaining")

            yield log
            self._console.print(f"{name}: done in {time.perf_counter() - started:.1f} s")
            return
        with rich_progress.Progress(
            rich_progress.TextColumn("{task.description:<16}", markup=False),
            rich_progress.BarColumn(bar_width=30),
            rich_progress.MofNCompleteColumn(),
            _Rate(),
            rich_progress.TimeElapsedColumn(),
            rich_progress.TimeRemainingColumn(),
            rich_progress.TextColumn("{task.fields[remark]}", markup=False),
            console=self._console,
        ) as bars:
            task = bars.add_task(printable(name), total=total, remark="")

            def show(done: int, remark: str = "", /) -> None:
                bars.update(task, completed=done)
                if remark:
                    bars.update(task, remark=printable(remark))

            yield show
            if total is not None:
                bars.update(task, completed=total)
