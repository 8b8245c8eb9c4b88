"""Machine and versions that a report was made with."""

from __future__ import annotations

import subprocess
from datetime import UTC, datetime
from pathlib import Path

from monoloc.machine import library_versions, machine_facts

_LIBRARIES = ("monoloc", "numpy", "torch", "onnxruntime", "opencv-python-headless", "matplotlib")


def provenance() -> dict[str, str]:
    """Date, commit, processor, cores and versions, as text."""
    found = {"date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", "commit": source_commit()}
    return {**found, **machine_facts(), **library_versions(_LIBRARIES)}


def source_commit() -> str:
    """Commit of the source tree that runs, if it is one."""
    folder = Path(__file__).parent
    try:
        commit = _git(folder, "rev-parse", "--short=12", "HEAD")
        # An installed copy may lie in another repository.
        root = Path(_git(folder, "rev-parse", "--show-toplevel"))
        if not folder.is_relative_to(root / "lab" / "monoloc_lab"):
            return "unknown (installed)"
        # Untracked files do not count: the folder of the report may be in the tree.
        changes = _git(folder, "status", "--porcelain", "--untracked-files=no", "--", str(root))
        return f"{commit}, with changes" if changes else commit
    except (OSError, subprocess.CalledProcessError):
        return "unknown (not a repository)"


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()
