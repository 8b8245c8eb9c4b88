"""Tasks and their keys."""

from __future__ import annotations

from monoloc_lab.experiments.task import Task


def test_key_depends_on_kind_settings_and_needs() -> None:
    needed = Task.of("bundle", {"seed": 0})
    tasks = [
        Task.of("run", {"seed": 0, "light": None}, [needed]),
        Task.of("depth", {"seed": 0, "light": None}, [needed]),
        Task.of("run", {"seed": 1, "light": None}, [needed]),
        Task.of("run", {"seed": 0, "light": "L3"}, [needed]),
        Task.of("run", {"seed": 0, "light": None}),
        Task.of("run", {"seed": 0, "light": None}, [Task.of("bundle", {"seed": 1})]),
    ]
    assert len({task.key for task in tasks}) == len(tasks)
    assert Task.of("run", {"light": None, "seed": 0}, [Task.of("bundle", {"seed": 0})]).key == tasks[0].key
