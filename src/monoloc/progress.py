"""Progress of long work, on stderr, with rate and remaining time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from rich import progress as rich_progress
from rich.console import Console
from rich.text import Text

Step = Callable[[int], None]


class Progress(Protocol):
    """Shows how far a task is; library code calls it and does not know who looks."""

    def task(self, name: str, total: int | None) -> AbstractContextManager[Step]:
        """A context whose value is called with the number of steps done; ``total`` None: unknown."""
        ...


class NoProgress:
    """For library use: nothing is shown."""

    @contextmanager
    def task(self, name: str, total: int | None) -> Iterator[Step]:
        yield lambda done: None


class _Rate(rich_progress.ProgressColumn):
    def render(self, task: rich_progress.Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s", style="progress.data.speed")


class ConsoleProgress:
    """Bars on a console; where stderr is no terminal, one line a finished task."""

    def __init__(self, console: Console) -> None:
        self._console = console

    @contextmanager
    def task(self, name: str, total: int | None) -> Iterator[Step]:
        if not self._console.is_terminal:
            # A log, or another program: no bars, and nothing of a task that fails.
            started = time.perf_counter()
            yield lambda done: None
            self._console.print(f"{name}: done in {time.perf_counter() - started:.1f} s")
            return
        with rich_progress.Progress(
            rich_progress.TextColumn("{task.description:<16}"),
            rich_progress.BarColumn(bar_width=30),
            rich_progress.MofNCompleteColumn(),
            _Rate(),
            rich_progress.TimeElapsedColumn(),
            rich_progress.TimeRemainingColumn(),
            console=self._console,
        ) as bars:
            task = bars.add_task(name, total=total)
            yield lambda done: bars.update(task, completed=done)
            if total is not None:
                bars.update(task, completed=total)
