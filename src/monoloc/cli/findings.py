"""Findings as lines, and as an exit code."""

from __future__ import annotations

from collections.abc import Sequence

from monoloc.cli.common import PlainConsole
from monoloc.recording_check.inspection import Finding, Level

_COLOURS: dict[Level, str] = {"good": "green", "warning": "yellow", "bad": "red"}
EXIT_CODES: dict[Level, int] = {"good": 0, "warning": 1, "bad": 2}
"""0 if all is well, 1 with warnings, 2 if it is not usable."""


def print_findings(title: str, findings: Sequence[Finding], level: Level, json: bool) -> None:
    """Print what was found, the worst level in the title: of each its level, and on a line of its own what to do.

    Args:
        json: whether the result is printed as JSON too, on stdout; the lines are then on stderr.
    """
    console = PlainConsole(stderr=json)
    console.print(f"{title}: {level}", style=f"bold {_COLOURS[level]}", soft_wrap=True)
    width = max(len(finding.name) for finding in findings)
    for finding in findings:
        start = f"  {finding.level:<7}  {finding.name:<{width}}  "
        lines = [start + finding.value, *([" " * len(start) + finding.remark] if finding.remark else [])]
        console.print("\n".join(lines), style=_COLOURS[finding.level], soft_wrap=True, markup=False)
