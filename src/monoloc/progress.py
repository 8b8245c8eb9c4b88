"""Progress of long tasks on stderr, with rate and remaining time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

from rich import progress as rich_progress
from rich.console import Console
from rich.text import Text

from monoloc.printable import printable

_LOG_INTERVAL_S = 30.0  # in a log; a longer silence looks like a hang
_LEAST_STEPS = 10  # of a task whose rate is shown
_TRUST = 0.1  # share of a plan after which what it took counts as much as what it was expected to take


class Step(Protocol):
    """Reports the number of completed steps of a task, with an optional remark.

    A task that has to prepare its steps reports 0 when they begin, so that the rate is theirs. One whose steps take
    minutes reports what it begins: the same number again, with a remark.
    """

    def __call__(self, done: int, remark: str = "", /) -> None: ...


class Progress(Protocol):
    """Shows the progress of tasks. Library code reports to this interface only."""

    def task(self, name: str, total: int | None, alike: bool = True) -> AbstractContextManager[Step]:
        """Context whose value is called with the number of completed steps.

        Args:
            total: number of steps; None if unknown.
            alike: whether steps take about as long as each other; if not, neither rate nor remaining time is shown.
        """
        ...


class NoProgress:
    """Shows nothing; the default for library use."""

    @contextmanager
    def task(self, name: str, total: int | None, alike: bool = True) -> Iterator[Step]:
        yield _say_nothing


def _say_nothing(done: int, remark: str = "", /) -> None:
    pass


class _Rate(rich_progress.ProgressColumn):
    """Of tasks with many steps; a few are parts of different length, of which a rate tells nothing."""

    def render(self, task: rich_progress.Task) -> Text:
        speed = task.finished_speed or task.speed
        if not speed or (task.total is not None and task.total < _LEAST_STEPS):
            return Text("")
        return Text(_rate(speed), style="progress.data.speed")


def _rate(steps_per_s: float) -> str:
    return f"{steps_per_s:.1f}/s" if steps_per_s >= 1.0 else f"{1.0 / steps_per_s:.1f} s each"


class Plan:
    """Remaining time of a job of several tasks, from what each was expected to take.

    Expected times are scaled by what the tasks so far took, the more so the more of the plan is done: the first tasks
    are short, and a start that was slow tells little about the rest.

    Args:
        expected_s: seconds of each task, by name, in their order; other tasks are not expected to take time.
    """

    def __init__(self, expected_s: Mapping[str, float]) -> None:
        self._expected_s = dict(expected_s)
        self._started = time.perf_counter()
        self._done_s, self._current_s = 0.0, 0.0

    def start(self, name: str) -> str:
        """Note that a task starts; returns its name with its place among all."""
        if name not in self._expected_s:
            self._done_s, self._current_s = self._done_s + self._current_s, 0.0
            return name
        names = list(self._expected_s)
        place = names.index(name)
        # A task that comes again takes nothing back.
        self._done_s = max(self._done_s + self._current_s, sum(list(self._expected_s.values())[:place]))
        self._current_s = self._expected_s[name]
        return f"{place + 1}/{len(names)} {name}"

    def remaining_s(self, share: float) -> float | None:
        """Seconds until the end of all tasks, given the share of the current one that is done; None if unknown."""
        done_s = self._done_s + share * self._current_s
        if done_s <= 0.0:
            return None
        all_s = sum(self._expected_s.values())
        factor = (time.perf_counter() - self._started + _TRUST * all_s) / (done_s + _TRUST * all_s)
        return max(0.0, all_s - done_s) * factor


class ConsoleProgress:
    """Shows progress bars on a terminal.

    If stderr is not a terminal, it prints a line for each remark and each finished task, and one every 30 s.

    Args:
        plan: of the job that the tasks belong to; then the job's remaining time is shown as well.
    """

    def __init__(self, console: Console, plan: Plan | None = None) -> None:
        self._console = console
        self._plan = plan

    @contextmanager
    def task(self, name: str, total: int | None, alike: bool = True) -> Iterator[Step]:
        if self._plan is not None:
            name = self._plan.start(name)
        show = self._bar if self._console.is_terminal else self._log
        with show(name, total, alike) as step:
            yield step

    def _of_all(self, done: int, total: int | None, task_s: float = 0.0) -> str:
        """Remaining time of the whole job, if it is known; not less than that of the task, ``task_s``."""
        remaining_s = None if self._plan is None else self._plan.remaining_s(done / total if total else 0.0)
        return "" if remaining_s is None else f"about {max(remaining_s, task_s):.0f} s to the end"

    @contextmanager
    def _log(self, name: str, total: int | None, alike: bool) -> Iterator[Step]:
        # Output goes to a log or another program: no bars, and no final line for a task that fails.
        started = begun = logged = time.perf_counter()
        first: int | None = None

        def log(done: int, remark: str = "", /) -> None:
            nonlocal begun, first, logged
            now = time.perf_counter()
            if done == 0:
                begun = now
            if first is None:
                first = max(0, done - 1)  # a resumed task does not start at 0
            if not remark and (done == 0 or now - logged < _LOG_INTERVAL_S):
                return
            logged = now
            step_s = (now - begun) / (done - first) if alike and done > first else None
            self._say(f"{name}: {self._line(done, total, remark, step_s)}")

        yield log
        self._say(f"{name}: done in {time.perf_counter() - started:.1f} s")

    def _line(self, done: int, total: int | None, remark: str, step_s: float | None) -> str:
        """How far a task is, with the mean duration of its steps if it is known."""
        of = "" if total is None else f" of {total}"
        share = f" ({100.0 * done / total:.0f} %)" if total and not remark else ""
        remaining_s = None if total is None or step_s is None else step_s * (total - done)
        parts = [
            f"{done}{of}{share}",
            remark or ("" if step_s is None else _rate(1.0 / step_s)),
            "" if remaining_s is None else f"{remaining_s:.0f} s remaining",
            self._of_all(done, total, remaining_s or 0.0),
        ]
        return ", ".join(part for part in parts if part)

    def _say(self, line: str) -> None:
        self._console.print(line, soft_wrap=True)  # whole: who reads a log has no width of 80 characters

    @contextmanager
    def _bar(self, name: str, total: int | None, alike: bool) -> Iterator[Step]:
        with rich_progress.Progress(
            rich_progress.TextColumn("{task.description:<16}", markup=False),
            rich_progress.BarColumn(bar_width=30),
            rich_progress.MofNCompleteColumn(),
            *((_Rate(),) if alike else ()),
            rich_progress.TimeElapsedColumn(),
            *((rich_progress.TimeRemainingColumn(),) if alike else ()),
            rich_progress.TextColumn("{task.fields[of_all]}", markup=False),
            rich_progress.TextColumn("{task.fields[remark]}", markup=False),
            console=self._console,
        ) as bars:
            task = bars.add_task(printable(name), total=total, remark="", of_all=self._of_all(0, total))

            def show(done: int, remark: str = "", /) -> None:
                bars.update(task, completed=done, of_all=self._of_all(done, total))
                if remark:
                    bars.update(task, remark=printable(remark))

            yield show
            if total is not None:
                bars.update(task, completed=total)
