"""What is left to do of a study, in words: how many tasks of each kind, and the time that they will take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection

from monoloc_lab.experiments.task import Results, Task


def tasks_to_do(tasks: Collection[Task], results: Results) -> str:
    """The number of tasks of each kind, and how long they take as far as it is known."""
    counts = Counter(task.kind for task in tasks)
    kinds = ", ".join(f"{kind} {count}" for kind, count in counts.items())
    time = time_to_do(tasks, results) or "the time is known once some are done"
    return f"to do: {kinds}; {time}"


def time_to_do(tasks: Collection[Task], results: Results) -> str:
    """The time that tasks take on one core, by results of the same kinds; a bound where a kind has none.

    Tasks of one kind differ less than those of different kinds, of which one takes a second and another minutes.
    """
    known: dict[str, list[float]] = {}
    for task, result in results.items():
        known.setdefault(task.kind, []).append(result.seconds)
    timed = [sum(known[task.kind]) / len(known[task.kind]) for task in tasks if task.kind in known]
    if not timed:
        return ""
    how = "about" if len(timed) == len(tasks) else "at least"
    return f"{how} {_duration(sum(timed))} of one core left"


def _duration(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60.0:.1f} hours"
