"""Real recordings, and commands run on them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cli_helpers import python


def monoloc(*arguments: str | Path) -> dict[str, Any]:
    """The JSON of a command that must succeed, in a process of its own."""
    result = python("from monoloc.cli.main import run; run()", *arguments, "--json")
    assert result.returncode == 0, result.stderr
    parsed = json.loads(result.stdout)
    assert isinstance(parsed, dict)
    return parsed


def source(data_root: Path, reader: str, folder: str) -> str:
    """A recording as commands take it; the test is skipped where it is absent."""
    path = data_root / folder
    if not path.is_dir():
        pytest.skip(f"no recording at {path}")
    return f"{reader}:{path}"
