"""Freed memory retained by the process: asked of glibc alone."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from monoloc.depth.training.memory import keep_freed_memory


@pytest.mark.parametrize(
    ("platform", "options"), [("linux", {(-1, 2**31 - 1), (-3, 2**30)}), ("darwin", set()), ("win32", set())]
)
def test_only_glibc_is_asked_to_retain_freed_memory(
    monkeypatch: pytest.MonkeyPatch, platform: str, options: set[tuple[int, int]]
) -> None:
    """M_TRIM_THRESHOLD is -1 and M_MMAP_THRESHOLD -3 in glibc's malloc.h, and values are C's int."""
    asked: set[tuple[int, int]] = set()
    itself = SimpleNamespace(mallopt=lambda *option: asked.add(option))
    monkeypatch.setattr("ctypes.CDLL", {None: itself}.__getitem__)
    monkeypatch.setattr("sys.platform", platform)
    keep_freed_memory()
    assert asked == options


def test_linux_without_glibc_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ctypes.CDLL", lambda name: SimpleNamespace())
    monkeypatch.setattr("sys.platform", "linux")
    keep_freed_memory()
