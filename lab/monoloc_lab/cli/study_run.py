"""The work of a study, with its progress on stderr."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from monoloc.cli.common import stderr
from monoloc.progress import ConsoleProgress
from monoloc_lab.experiments.engine import carry_out
from monoloc_lab.experiments.task import Results, Task


def carry_out_shown(tasks: Sequence[Task], out: Path, workers: int, scheduler: str | None) -> Results:
    """As :func:`monoloc_lab.experiments.engine.carry_out`; an interruption says how the work continues.

    Raises:
        KeyboardInterrupt: it was interrupted.
    """
    try:
        return carry_out(tasks, out, ConsoleProgress(stderr), workers, scheduler)
    except KeyboardInterrupt:
        kept = f"tasks that are done are kept in {out / 'results'}"
        stderr.print(f"{kept}; the same command continues with the others", soft_wrap=True)
        raise
