"""monoloc's own source as a number, so that results are known to be of it."""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path

import monoloc
import monoloc_lab
from monoloc import _core

_SHOWS_ONLY = ("monoloc.viz.viewer",)
"""What no result depends on, nor on what it imports."""


_ROOTS = {package.__name__: Path(str(package.__file__)).parent for package in (monoloc, monoloc_lab)}


@cache
def source_sha256(module: str) -> str:
    """Of a module, of all of monoloc that it imports, be it late, and of the native one.

    What only uses the module may change, and so may data, which is known by its content.

    Args:
        module: as ``monoloc.builder.pipeline``.
    """
    files = _imported(module)
    files["monoloc._core"] = Path(_core.__file__)  # which may lie in another folder
    lines = [f"{name} {hashlib.sha256(files[name].read_bytes()).hexdigest()}" for name in sorted(files)]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _imported(module: str) -> dict[str, Path]:
    """Files, by name, of a module and of all modules of monoloc that it imports, directly or not."""
    found: dict[str, Path] = {}
    left = [module]
    while left:
        name = left.pop()
        file = _file(name)
        if file is None or name in found or name in _SHOWS_ONLY:
            continue
        found[name] = file
        package, _, _ = name.rpartition(".")
        left += [*_imports(file.read_text(encoding="utf-8")), package]  # a package is imported before what lies in it
    return found


def _file(name: str) -> Path | None:
    """Of a module of monoloc; None for a name that is none."""
    root, *parts = name.split(".")
    if root not in _ROOTS:
        return None
    path = _ROOTS[root].joinpath(*parts)
    files = (path / "__init__.py", path.with_suffix(".py") if parts else path)
    return next((file for file in files if file.is_file()), None)


@cache
def _imports(text: str) -> tuple[str, ...]:
    """Names that a module's text imports: modules, and things in modules, which may be modules."""
    names = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(names)
