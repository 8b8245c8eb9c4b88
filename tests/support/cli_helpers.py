"""What tests of the command line share: commands that must succeed or be refused, and Python of its own process."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from monoloc.cli.main import invoke


def listing(folder: Path) -> dict[str, bytes | None]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


def succeeds(capfd, *arguments: str) -> str:
    """Run a command that must succeed; returns its stdout."""
    capfd.readouterr()
    code = invoke(list(arguments))
    out, err = capfd.readouterr()
    assert code == 0, err
    return out


def json_of(capfd, *arguments: str) -> dict[str, Any]:
    """The one JSON object on stdout of a command that must succeed."""
    result = json.loads(succeeds(capfd, *arguments, "--json"))
    assert isinstance(result, dict)
    return result


def python(code: str, *arguments: str | Path, here: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Code in a process of its own."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=here, timeout=600, check=False)


def refused(capfd, folder: Path, arguments: tuple[str, ...], names: str, problem: str, fix: str = "") -> None:
    """The command ends with exit code 2 and one line (what it names, the problem, the fix), and leaves no trace."""
    before = listing(folder)
    capfd.readouterr()
    code = invoke(list(arguments))
    out, err = capfd.readouterr()
    lines = [line for line in err.splitlines() if not re.fullmatch(r"[a-z: ]+: done in [\d.]+ s", line)]
    assert code == 2, err
    assert out == ""
    assert len(lines) == 1, err
    assert re.fullmatch(f"monoloc: {re.escape(names)}.*{problem}.*; .*{fix}.*", lines[0]), lines[0]
    assert listing(folder) == before
