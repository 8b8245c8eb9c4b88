"""Bad input is refused in one line: what is wrong with which file or setting, and the fix."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from monoloc.errors import DataError, MonolocError, SettingError
from monoloc.io.registry import open_recording


def refuses_data(action: Callable[[], object], path: Path, problem: str, fix: str) -> None:
    """The action raises DataError, in one line: the path, then the problem, then the fix (regular expressions)."""
    with pytest.raises(DataError) as raised:
        action()
    message = str(raised.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    assert re.search(f"{problem}.*; .*{fix}", message.removeprefix(str(path))), message


def refuses_to_open(source: Path, path: Path, problem: str, fix: str) -> None:
    """As :func:`refuses_data`, of opening a recording."""
    refuses_data(lambda: open_recording(str(source)), path, problem, fix)


def refuses_setting(action: Callable[[], object], field: str, problem: str, fix: str) -> None:
    """The action raises SettingError, in one line: the field, then the problem, then the fix."""
    with pytest.raises(SettingError) as raised:
        action()
    assert "\n" not in str(raised.value)
    assert re.fullmatch(f"{field}: .*{problem}.*; .*{fix}.*", str(raised.value)), str(raised.value)


def refuses(action: Callable[[], object], kind: type[MonolocError], pattern: str) -> None:
    """The action raises this kind of error, in one line with a fix, that the pattern matches."""
    with pytest.raises(kind, match=pattern) as raised:
        action()
    assert "\n" not in str(raised.value) and "; " in str(raised.value)
