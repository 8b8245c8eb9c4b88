"""A hash of monoloc's own source, so that results belong to the code that computed them."""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path

import monoloc
import monoloc._core as _core
import monoloc_lab

_DISPLAY_ONLY = ("monoloc.viz.viewer",)
"""Modules that no result depends on; what they import does not count either."""

_ROOTS = {package.__name__: Path(str(package.__file__)).parent for package in (monoloc, monoloc_lab)}


@cache
def source_sha256(module: str) -> str:
    """Hash of a module, of all of monoloc that it imports, also within functions, and of the native module.

    Modules that import this one do not count. Neither does data, which is identified by its content.

    Args:
        module: as ``monoloc.builder.pipeline``.
    """
    files = _imported(module)
    files["monoloc._core"] = Path(_core.__file__)  # which may lie in another folder
    lines = [f"{name} {hashlib.sha256(files[name].read_bytes()).hexdigest()}" for name in sorted(files)]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def _imported(module: str) -> dict[str, Path]:
    """Files, by name, of a module and of all modules of monoloc that it imports, directly or indirectly."""
    found: dict[str, Path] = {}
    left = [module]
    while left:
        name = left.pop()
        file = _file(name)
        if file is None or name in found or name in _DISPLAY_ONLY:
            continue
        found[name] = file
        package, _, _ = name.rpartition(".")
        left += [*_imports(file.read_text(encoding="utf-8")), package]  # importing a module imports its package
    return found


def _file(name: str) -> Path | None:
    """The file of a module of monoloc; None for any other name."""
    root, *parts = name.split(".")
    if root not in _ROOTS:
        return None
    path = _ROOTS[root].joinpath(*parts)
    files = (path / "__init__.py", path.with_suffix(".py") if parts else path)
    return next((file for file in files if file.is_file()), None)


@cache
def _imports(text: str) -> tuple[str, ...]:
    """Names that a source text imports when it runs: modules, and names in modules, which may be modules."""
    tree = ast.parse(text)
    unused = {id(inner) for node in ast.walk(tree) if _is_for_type_checkers(node) for inner in ast.walk(node)}
    names = []
    for node in ast.walk(tree):
        if id(node) in unused:
            continue
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(names)


def _is_for_type_checkers(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
