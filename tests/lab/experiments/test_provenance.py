"""Machine and versions of a report."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from monoloc_lab.experiments.provenance import provenance


def test_provenance_names_machine_and_versions() -> None:
    made = provenance()
    assert made["numpy"] == np.__version__ and int(made["cores"]) >= 1
    assert made["processor"] and re.match(r"^(unknown|[0-9a-f]{12})", made["commit"])


def test_provenance_counts_changes_of_tracked_files_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder of a report may be in the tree."""

    def git(*arguments: str) -> None:
        who = ("-c", "user.name=a", "-c", "user.email=a@b")
        subprocess.run(["git", *who, *arguments], cwd=tmp_path, capture_output=True, check=True)

    source = tmp_path / "lab" / "monoloc_lab" / "experiments" / "provenance.py"
    source.parent.mkdir(parents=True)
    source.write_text("before")
    git("init")
    git("add", "lab")
    git("commit", "-m", "first")
    monkeypatch.setattr("monoloc_lab.experiments.provenance.__file__", str(source))
    (tmp_path / "reproduction").mkdir()
    (tmp_path / "reproduction" / "report.json").write_text("{}")
    assert re.fullmatch("[0-9a-f]{12}", provenance()["commit"])
    source.write_text("after")
    assert re.fullmatch("[0-9a-f]{12}, with changes", provenance()["commit"])
