"""Text from elsewhere cannot command a terminal."""

from __future__ import annotations

import io
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from cli_helpers import python
from monoloc.cli.common import PlainConsole, print_table
from monoloc.cli.main import invoke
from monoloc.printable import printable
from monoloc.progress import ConsoleProgress

TITLE = "\x1b]0;owned\x07[red]"
SHOWN = "\\x1b]0;owned\\x07[red]"


@given(st.text())
def test_only_what_can_be_printed_is_left(text: str) -> None:
    made = printable(text)
    assert all(character.isprintable() or character in "\t\n" or ord(character) > 159 for character in made)
    assert "\u202e" not in made and "\x9b" not in made
    made.encode()
    assert printable("12 °C, ä, 部屋\n") == "12 °C, ä, 部屋\n"


def test_tables_notes_and_errors_show_control_characters(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    print_table(TITLE, [TITLE], [[TITLE]])
    PlainConsole(stderr=True).print(TITLE)
    assert invoke(["inspect", f"{TITLE}.monoloc"]) == 2
    out, err = capfd.readouterr()
    assert "\x1b" not in out + err and "\x07" not in out + err
    assert out.count(SHOWN) == 3 and err.count(SHOWN) == 2


def test_progress_shows_control_characters() -> None:
    screen = io.StringIO()
    with ConsoleProgress(Console(file=screen, force_terminal=True, width=200)).task(TITLE, 3) as step:
        step(1, TITLE)
    assert "\x1b]0" not in screen.getvalue() and "\x07" not in screen.getvalue()
    assert screen.getvalue().count(SHOWN) >= 2


def test_name_that_is_no_unicode_is_refused_in_one_line(tmp_path: Path) -> None:
    name = os.fsdecode(b"room\xff.monoloc")
    result = python(f"from monoloc.cli import main; import sys; sys.argv = ['', 'inspect', {name!r}]; main.run()")
    assert result.returncode == 2 and result.stderr.count("\n") == 1
    assert "room\\udcff.monoloc" in result.stderr
