"""A unit of work whose result is stored and reused: its settings, the results it needs, and its place on disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

TASK, RESULT = "task.json", "result.json"


@dataclass(frozen=True)
class Task:
    """A unit of work.

    Attributes:
        kind: key of :data:`monoloc_lab.experiments.work.KINDS`.
        description: every setting that the result depends on, as JSON with sorted keys.
        needs: tasks whose results this one reads, in order.
    """

    kind: str
    description: str
    needs: tuple[Task, ...] = ()

    @classmethod
    def of(cls, kind: str, settings: Mapping[str, Any], needs: Iterable[Task] = ()) -> Task:
        """A task with settings that JSON can represent."""
        return cls(kind, json.dumps(settings, sort_keys=True), tuple(needs))

    @property
    def settings(self) -> dict[str, Any]:
        return dict(json.loads(self.description))

    @cached_property
    def key(self) -> str:
        """A name that two tasks share only if they have the same result."""
        content = "\n".join([self.kind, self.description, *(task.key for task in self.needs)])
        return f"{self.kind}-{hashlib.sha256(content.encode()).hexdigest()[:16]}"


@dataclass(frozen=True)
class Result:
    """The result of a task.

    Attributes:
        folder: contains :data:`TASK`, :data:`RESULT` and the files of the task's kind.
        figures: the content of :data:`RESULT`.
        seconds: duration on one core.
        commit: of the source tree that computed it.
    """

    folder: Path
    figures: dict[str, Any]
    seconds: float = 0.0
    commit: str = "unknown"


def read_result(out: Path, task: Task) -> Result | None:
    """The stored result of a task; None if it is missing or unreadable."""
    folder = out / "results" / task.key
    try:
        figures, done = (json.loads((folder / name).read_text(encoding="utf-8")) for name in (RESULT, TASK))
    except (OSError, ValueError):
        return None
    return Result(folder, figures, done["seconds"], done.get("commit", "unknown"))


Results = Mapping[Task, Result]
