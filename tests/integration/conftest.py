"""Fixtures of several files."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest


@pytest.fixture
def here(workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the workspace, as working folder; each file has a fixture ``workspace`` of its own."""
    shutil.copytree(workspace, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path
