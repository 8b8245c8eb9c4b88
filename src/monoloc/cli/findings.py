"""Findings as a table, and as an exit code."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from monoloc.cli.common import stderr
from monoloc.recording_check.inspection import Finding, Level

_COLOURS: dict[Level, str] = {"good": "green", "warning": "yellow", "bad": "red"}
EXIT_CODES: dict[Level, int] = {"good": 0, "warning": 1, "bad": 2}
"""0 if all is well, 1 with warnings, 2 if it is not usable."""


def print_findings(title: str, findings: Sequence[Finding], level: Level) -> None:
    """Print what was found, the worst level in the title, each line with its level and in its colour."""
    table = Table(header_style="")
    for column in ("", "level", "found", "remark"):
        table.add_column(column, overflow="fold")
    for finding in findings:
        table.add_row(finding.name, finding.level, finding.value, finding.remark, style=_COLOURS[finding.level])
    stderr.print(f"{title}: {level}", style=f"bold {_COLOURS[level]}", soft_wrap=True)
    stderr.print(table)
