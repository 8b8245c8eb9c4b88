"""What a release installs: everything is pinned, and every file has a hash that pip checks."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from monoloc_lab.make.release_requirements import pinned, specifiers
from repository import REPOSITORY

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]


def test_every_dependency_of_the_project_is_pinned() -> None:
    lines = (REPOSITORY / "constraints.txt").read_text().splitlines()[1:]
    pins = {canonicalize_name(line.split("==")[0]) for line in lines}
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines)
    wanted = [Requirement(each) for each in specifiers(PROJECT, PROJECT["optional-dependencies"])]
    assert {canonicalize_name(each.name) for each in wanted} - pins == {"monoloc"}


def test_extras_add_what_they_need() -> None:
    assert specifiers(PROJECT, []) == PROJECT["dependencies"]
    assert specifiers(PROJECT, ["mavlink"])[-1].startswith("pymavlink")
    with pytest.raises(KeyError):
        specifiers(PROJECT, ["wings"])


def test_pip_takes_the_lines_and_refuses_another_file(tmp_path: Path) -> None:
    wheel = tmp_path / "thing-1.0-py3-none-any.whl"
    wheel.write_bytes(b"not what was released")
    entry = {"metadata": {"name": "thing", "version": "1.0"}}
    report = {"install": [entry | {"download_info": {"archive_info": {"hashes": {"sha256": "ab" * 32}}}}]}
    (tmp_path / "requirements.txt").write_text("\n".join(pinned(report)))
    command = [sys.executable, "-m", "pip", "install", "--isolated", "--no-index", "--find-links", str(tmp_path)]
    command += ["--dry-run", "--require-hashes", "-r", str(tmp_path / "requirements.txt")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "DO NOT MATCH THE HASHES" in done.stderr
    with pytest.raises(ValueError, match=r"thing 1\.0 has no SHA-256"):
        list(pinned({"install": [entry | {"download_info": {}}]}))
