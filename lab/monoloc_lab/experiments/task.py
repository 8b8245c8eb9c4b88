"""A piece of work whose result is kept, so that it is done once: what it is, what it needs, where its result lies."""

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
    """A piece of work.

    Attributes:
        kind: what is done: a name of :data:`monoloc_lab.experiments.work.KINDS`.
        description: all that its result depends on, beside what it needs: JSON, keys sorted.
        needs: whose results it reads, in order.
    """

    kind: str
    description: str
    needs: tuple[Task, ...] = ()

    @classmethod
    def of(cls, kind: str, settings: Mapping[str, Any], needs: Iterable[Task] = ()) -> Task:
        """A task of settings that JSON can hold."""
        return cls(kind, json.dumps(settings, sort_keys=True), tuple(needs))

    @property
    def settings(self) -> dict[str, Any]:
        return dict(json.loads(self.description))

    @cached_property
    def key(self) -> str:
        """A name that two tasks share only if they would give the same result."""
        content = "\n".join([self.kind, self.description, *(task.key for task in self.needs)])
        return f"{self.kind}-{hashlib.sha256(content.encode()).hexdigest()[:16]}"


@dataclass(frozen=True)
class Result:
    """What a task gave.

    Attributes:
        folder: where what it wrote lies: :data:`TASK`, :data:`RESULT`, last, and what else its kind says.
        figures: the content of :data:`RESULT`.
        seconds: what it took, on one core.
    """

    folder: Path
    figures: dict[str, Any]
    seconds: float = 0.0


def read_result(out: Path, task: Task) -> Result | None:
    """A result that an earlier run has left; None where it was not finished, or cannot be read."""
    folder = out / "results" / task.key
    try:
        figures, done = (json.loads((folder / name).read_text(encoding="utf-8")) for name in (RESULT, TASK))
    except (OSError, ValueError):
        return None
    return Result(folder, figures, done["seconds"])


Results = Mapping[Task, Result]
