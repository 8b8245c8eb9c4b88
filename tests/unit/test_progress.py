"""Progress of long work, as it is shown where there is no terminal and where there is one."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from monoloc import progress as progress_module
from monoloc.progress import ConsoleProgress, NoProgress, Plan


class Clock:
    """Time that a test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        monkeypatch.setattr(progress_module.time, "perf_counter", lambda: self.now_s)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def test_log_has_a_line_for_every_remark_with_the_remaining_time(clock: Clock) -> None:
    log = io.StringIO()
    with ConsoleProgress(Console(file=log, width=200)).task("train", 5) as step:
        for done in range(1, 6):
            clock.now_s += 10.0
            step(done, f"AbsRel 0.{done}")
    assert log.getvalue().splitlines() == [
        "train: 1 of 5, AbsRel 0.1, 40 s remaining",
        "train: 2 of 5, AbsRel 0.2, 30 s remaining",
        "train: 3 of 5, AbsRel 0.3, 20 s remaining",
        "train: 4 of 5, AbsRel 0.4, 10 s remaining",
        "train: 5 of 5, AbsRel 0.5, 0 s remaining",
        "train: done in 50.0 s",
    ]


def test_line_of_a_log_is_not_broken_at_the_width_of_a_terminal(clock: Clock) -> None:
    log = io.StringIO()
    with ConsoleProgress(Console(file=log, width=40)).task("tasks", 2) as step:
        clock.now_s += 10.0
        step(1, "depth of full-0.35, evaluation L2 ::, seed 0")
    line = "tasks: 1 of 2, depth of full-0.35, evaluation L2 ::, seed 0, 10 s remaining"
    assert log.getvalue().splitlines()[0] == line


def test_resumed_task_does_not_count_earlier_steps(clock: Clock) -> None:
    log = io.StringIO()
    with ConsoleProgress(Console(file=log, width=200)).task("train", 100) as step:
        for done in (91, 92):
            clock.now_s += 10.0
            step(done, "going on")
    assert log.getvalue().splitlines()[:2] == [
        "train: 91 of 100, going on, 90 s remaining",
        "train: 92 of 100, going on, 80 s remaining",
    ]


def test_time_before_the_first_step_is_no_part_of_the_rate(clock: Clock) -> None:
    log = io.StringIO()
    with ConsoleProgress(Console(file=log, width=200)).task("tune", 300) as step:
        clock.now_s += 33.0
        step(0)
        clock.now_s += 0.5
        step(1)
    assert log.getvalue().splitlines() == [
        "tune: 1 of 300 (0 %), 2.0/s, 150 s remaining",
        "tune: done in 33.5 s",
    ]


def test_steps_of_different_length_are_announced_and_give_no_remaining_time(clock: Clock) -> None:
    log = io.StringIO()
    with ConsoleProgress(Console(file=log, width=200)).task("tasks", 2, alike=False) as step:
        for done, remark in ((0, "to do: bundle 1, run 1"), (0, "begins bundle"), (1, "took 400 s: bundle")):
            step(done, remark)
            clock.now_s += 400.0
    assert log.getvalue().splitlines() == [
        "tasks: 0 of 2, to do: bundle 1, run 1",
        "tasks: 0 of 2, begins bundle",
        "tasks: 1 of 2, took 400 s: bundle",
        "tasks: done in 1200.0 s",
    ]


def test_steps_without_a_remark_are_counted_but_not_logged(clock: Clock) -> None:
    log = io.StringIO()
    with ConsoleProgress(Console(file=log, width=200)).task("adapt", 40) as step:
        for done in range(1, 21):
            clock.now_s += 1.0
            step(done, "half" if done == 20 else "")
    assert log.getvalue().splitlines() == ["adapt: 20 of 40, half, 20 s remaining", "adapt: done in 20.0 s"]


def test_log_is_never_silent_for_longer_than_half_a_minute(clock: Clock) -> None:
    log = io.StringIO()
    with ConsoleProgress(Console(file=log, width=200)).task("localize", 400) as step:
        for done in range(1, 101):
            clock.now_s += 0.7
            step(done, "half-way" if done == 60 else "")
    with ConsoleProgress(Console(file=log, width=200)).task("quantise", None) as step:
        for done in range(1, 3):
            clock.now_s += 40.0
            step(done)
    assert log.getvalue().splitlines() == [
        "localize: 43 of 400 (11 %), 1.4/s, 250 s remaining",
        "localize: 60 of 400, half-way, 238 s remaining",
        "localize: done in 70.0 s",
        "quantise: 1, 40.0 s each",
        "quantise: 2, 40.0 s each",
        "quantise: done in 80.0 s",
    ]


def test_remaining_time_of_a_job_follows_what_its_tasks_take(clock: Clock) -> None:
    """The first of three tasks takes twice as long as expected, of which the others are believed more and more."""
    log = io.StringIO()
    progress = ConsoleProgress(Console(file=log, width=200), Plan({"map": 10.0, "tune": 30.0, "land": 20.0}))
    for name in ("map", "unplanned"):
        with progress.task(name, 2) as step:
            clock.now_s += 10.0
            step(1, "half")
            clock.now_s += 10.0
    with progress.task("tune", None) as step:
        step(1, "some")
    assert [line for line in log.getvalue().splitlines() if "done" not in line] == [
        "1/3 map: 1 of 2, half, 10 s remaining, about 80 s to the end",
        "unplanned: 1 of 2, half, 10 s remaining, about 112 s to the end",
        "2/3 tune: 1, some, about 144 s to the end",
    ]


def test_task_of_unknown_length_has_no_remaining_time(clock: Clock) -> None:
    log = io.StringIO()
    with ConsoleProgress(Console(file=log, width=200)).task("quantise", None) as step:
        step(1, "calibrated")
    assert log.getvalue().splitlines()[-1] == "quantise: done in 0.0 s"
    assert "remaining" not in log.getvalue()


def test_failed_task_is_not_logged_as_done() -> None:
    log = io.StringIO()
    with (
        pytest.raises(RuntimeError),
        ConsoleProgress(Console(file=log, width=200)).task("train", 3) as step,
    ):
        step(1, "so far so good")
        raise RuntimeError
    assert re.fullmatch(r"train: 1 of 3, so far so good, \d+ s remaining\n", log.getvalue())


def test_terminal_shows_the_last_remark_beside_the_bar() -> None:
    screen = io.StringIO()
    progress = ConsoleProgress(Console(file=screen, force_terminal=True, width=140))
    with progress.task("train", 3) as step:
        step(1, "AbsRel 0.9")
        step(2, "AbsRel 0.8")
        step(3)
    last = screen.getvalue()[screen.getvalue().rindex("train") :]
    assert "3/3" in last and "AbsRel 0.8" in last


@pytest.mark.parametrize(("total", "has_rate"), [(5, False), (10, True)])
def test_terminal_shows_no_rate_of_a_few_unequal_parts(total: int, has_rate: bool) -> None:
    now_s = 0.0
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=140, get_time=lambda: now_s)
    with ConsoleProgress(console).task("check", total) as step:
        for done in range(1, total + 1):
            now_s += 0.5
            step(done)
    assert ("2.0/s" in screen.getvalue()) == has_rate


@pytest.mark.parametrize(("step_s", "remaining"), [(2.0, "0:00:10"), (90.0, "0:07:30")])
def test_terminal_shows_the_remaining_time_for_long_steps(step_s: float, remaining: str) -> None:
    now_s = 0.0
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=140, get_time=lambda: now_s)
    # What stops half-way leaves the bar as it was.
    with pytest.raises(KeyboardInterrupt), ConsoleProgress(console).task("train", 10) as step:
        for done in range(1, 6):
            now_s += step_s
            step(done)
        raise KeyboardInterrupt
    last = screen.getvalue()[screen.getvalue().rindex("train") :]
    assert "5/10" in last and remaining in last


def test_no_progress_accepts_steps() -> None:
    with NoProgress().task("train", 3) as step:
        step(1)
        step(2, "AbsRel 0.8")
