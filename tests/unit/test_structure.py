"""The layout's rules: imports point downward, between files and between folders, and no file name occurs twice."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from repository import REPOSITORY

PACKAGES = {"monoloc": REPOSITORY / "src" / "monoloc", "monoloc_lab": REPOSITORY / "lab" / "monoloc_lab"}


def modules_of(package: str) -> dict[str, Path]:
    """Files of a package by the name that they are imported by."""
    root = PACKAGES[package]
    files = {".".join([package, *path.relative_to(root).with_suffix("").parts]): path for path in root.rglob("*.py")}
    return {name.removesuffix(".__init__"): path for name, path in files.items()}


@cache
def imports_of(path: Path) -> list[str]:
    """Names that a file imports at module level or within functions, but for those that only a type checker sees."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing_only = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"
        for node in ast.walk(block)
    }
    names = []
    for node in ast.walk(tree):
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def imported_modules(path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of the package that a file imports; a name in a module counts for the module."""
    return {name if name in known else name.rpartition(".")[0] for name in imports_of(path)} & known.keys()


def whole(module: str) -> str:
    return module


def folder_or_top_level_file(module: str) -> str:
    return ".".join(module.split(".")[:2])


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize("room", [whole, folder_or_top_level_file])
def test_imports_form_no_circle(package: str, room: Callable[[str], str]) -> None:
    known = modules_of(package)
    graph: dict[str, set[str]] = {}
    for module, path in known.items():
        below = {room(imported) for imported in imported_modules(path, known)} - {room(module), package}
        graph.setdefault(room(module), set()).update(below)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"imports form a circle: {' -> '.join(error.args[1])}")


def test_what_a_drone_carries_does_not_import_the_lab() -> None:
    importers = [
        module
        for module, path in modules_of("monoloc").items()
        if any(name.split(".")[0] == "monoloc_lab" for name in imports_of(path))
    ]
    assert importers == []


def test_no_file_name_occurs_twice() -> None:
    names = Counter(path.name for package in PACKAGES for path in modules_of(package).values())
    del names["__init__.py"]
    assert [name for name, count in names.items() if count > 1] == []
