"""What is left to do of a study: counts by kind, and time only as far as it is known."""

from __future__ import annotations

from pathlib import Path

import pytest

from monoloc_lab.experiments.task import Result, Task
from monoloc_lab.experiments.workload import tasks_to_do, time_to_do

BUNDLE, POSENET = Task.of("bundle", {"seed": 0}), Task.of("posenet", {})
RUNS = [Task.of("run", {"seed": seed}) for seed in range(4)]


def took(seconds: float) -> Result:
    return Result(Path("results"), {}, seconds)


@pytest.mark.parametrize(
    ("tasks", "results", "said"),
    [
        ([BUNDLE, *RUNS], {}, "to do: bundle 1, run 4; the time is known once some are done"),
        (RUNS[2:], {RUNS[0]: took(10.0), RUNS[1]: took(20.0)}, "to do: run 2; about 30 s of one core left"),
        ([POSENET, *RUNS[1:]], {RUNS[0]: took(60.0)}, "to do: posenet 1, run 3; at least 3 min of one core left"),
        (RUNS[1:], {RUNS[0]: took(3600.0)}, "to do: run 3; about 3.0 hours of one core left"),
    ],
)
def test_work_is_counted_and_timed_by_kind(tasks: list[Task], results: dict[Task, Result], said: str) -> None:
    assert tasks_to_do(tasks, results) == said


def test_nothing_is_said_of_time_without_a_result() -> None:
    assert time_to_do([BUNDLE], {RUNS[0]: took(60.0)}) == time_to_do([], {RUNS[0]: took(60.0)}) == ""
