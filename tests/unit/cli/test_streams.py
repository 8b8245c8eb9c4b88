"""Standard streams that are full, closed, or no longer read end a command in one line, or not at all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cli_helpers import run_as_command

RESULT = "print('result') or 0"
REMARK = "print('remark', file=__import__('sys').stderr) or 0"

needs_full_device = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")


def shell(action: str, redirections: str) -> subprocess.CompletedProcess[str]:
    """Run an action as a command, with a shell's redirections."""
    command = f'"$0" -c "$1" {redirections}'
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", command, sys.executable, run_as_command(action)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@needs_full_device
@pytest.mark.parametrize("action", [RESULT, "__import__('typer').echo('help') or 0"])
def test_full_disk_is_reported_in_one_line(action: str) -> None:
    ended = shell(action, ">/dev/full")
    problem = "cannot be written (No space left on device); make room, or write it elsewhere"
    assert (ended.returncode, ended.stderr) == (2, f"monoloc: stdout: {problem}\n")


def test_result_that_nobody_reads_is_reported_in_one_line() -> None:
    ended = shell(f"__import__('time').sleep(0.5) or {RESULT}", "| true")
    problem = "is no longer read; read all of it, or write it to a file"
    assert (ended.returncode, ended.stderr) == (141, f"monoloc: stdout: {problem}\n")


@needs_full_device
def test_remark_that_cannot_be_written_ends_no_work() -> None:
    ended = shell(f"{REMARK} or {RESULT}", "2>/dev/full")
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "result\n", "")


def test_file_does_not_take_the_place_of_a_closed_stream(tmp_path: Path) -> None:
    """The next file that is opened gets the lowest free number, and with it what libraries print."""
    file = tmp_path / "file"
    action = f"[open('{file}', 'w'), print('result'), {REMARK}, __import__('os').write(2, b'library')] and 0"
    ended = shell(action, "<&- >&- 2>&-")
    assert ended.returncode == 0 and file.read_bytes() == b""


def test_remarks_of_a_closed_stderr_do_not_come_on_stdout() -> None:
    ended = shell(f"{REMARK} or {RESULT}", "2>&-")
    assert (ended.returncode, ended.stdout) == (0, "result\n")
