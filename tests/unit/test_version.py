"""What ``--version`` says."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from monoloc import version
from repository import REPOSITORY

GIT = ("git", "-c", "user.name=x", "-c", "user.email=x@x", "-c", "commit.gpgsign=false")


def test_facts_name_what_runs() -> None:
    facts = version.version_facts()
    assert list(facts) == ["monoloc", "commit", "core", "ONNX Runtime"]
    assert facts["monoloc"] == version.__version__
    assert facts["core"] in ("AVX-512", "AVX2", "NEON", "plain")
    assert re.match(r"\d+\.\d+", facts["ONNX Runtime"])


def test_all_files_state_one_version_and_the_changelog_must_be_dated_for_a_release() -> None:
    check = (sys.executable, str(REPOSITORY / ".github" / "check_release.py"))
    found = subprocess.run([*check, f"v{version.__version__}"], capture_output=True, text=True, check=False).stderr
    assert [line for line in found.splitlines() if not line.startswith("CHANGELOG.md has no heading")] == []
    wrong = subprocess.run([*check, "v99.0.0"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 1 and wrong.stderr.count(", the tag v99.0.0") == 4


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_commit_is_that_of_the_build_else_of_the_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built_from = tmp_path / "build_commit.txt"
    monkeypatch.setattr(version, "_BUILT_FROM", built_from)
    monkeypatch.setattr(version, "_CHECKOUT", tmp_path)
    assert version.commit() is None

    def git(*arguments: str) -> str:
        return subprocess.run([*GIT, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True).stdout

    git("init")
    (tmp_path / "file").write_text("1")
    git("add", "file")
    git("commit", "-m", "first")
    commit = git("rev-parse", "--short=12", "HEAD").strip()
    assert version.commit() == commit
    (tmp_path / "file").write_text("2")
    assert version.commit() == f"{commit}-dirty"

    built_from.write_text("0123456789ab\n")
    assert version.commit() == "0123456789ab"
    built_from.write_text("\n")  # built from a source archive
    assert version.commit() is None
