"""monoloc's own source as a number, so that results are known to be of it."""

from __future__ import annotations

import hashlib
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import monoloc
from monoloc import _core

_SHOWS_ONLY = (
    "cli/*",
    "viewer.py",
    "rerun_viewer.py",
    "rooms/*",
    "models/*",
    "evaluation/*drawing*",
    "evaluation/plots.py",
    "evaluation/picture.py",
    *(
        f"experiments/{name}.py"
        for name in ("fig*", "report*", "claims", "drawing", "sweep", "gather", "methods", "provenance")
    ),
    *(f"experiments/{name}.py" for name in ("variants", "map_size", "lambda_", "frames", "table1")),
)
"""What draws, parses, or chooses tasks by settings that are theirs; data is known by its content."""


@cache
def source_sha256() -> str:
    """Of all modules that a result may depend on, the native one too; which may lie in another folder."""
    folder = Path(monoloc.__file__).parent
    files = {file.relative_to(folder).as_posix(): file for file in folder.rglob("*.py")}
    files = {name: file for name, file in files.items() if not any(fnmatch(name, shows) for shows in _SHOWS_ONLY)}
    files["_core"] = Path(_core.__file__)
    lines = [f"{name} {hashlib.sha256(files[name].read_bytes()).hexdigest()}" for name in sorted(files)]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
