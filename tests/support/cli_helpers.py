"""What tests of the command line share: commands that must succeed or be refused, and a folder to run them in."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from monoloc.bundle import write_bundle
from monoloc.cli.main import invoke
from synthetic_room import Room, RoomRecording, make_bundle, room_mixture, write_recording

UNTUNED = ("--tune", "none", "--no-map-transform")
# The quickest build: a small map and a small network, of which nothing is tuned.
QUICK = (*UNTUNED, "-k", "40", "--network", "tiny-0.35")


def write_workspace(folder: Path, recording: RoomRecording, components: int = 250) -> None:
    """Write the recording ``flight`` and the bundle ``room.monoloc``, as if built from every second frame."""
    write_recording(folder / "flight", recording)
    mixture = room_mixture(Room(), components)
    write_bundle(folder / "room.monoloc", make_bundle(mixture, recording, range(0, len(recording), 2)))


def remove_depth(recording: Path) -> None:
    """Make a described folder one without depth images."""
    description = recording / "dataset.toml"
    description.write_text(re.sub(r"depth = .*\n", "", description.read_text()))


def listing(folder: Path) -> dict[str, bytes | None]:
    """Every path under a folder, with its content if it is a file."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


def succeeds(capfd: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must succeed; returns its stdout."""
    return outputs(capfd, *arguments)[0]


def outputs(capfd: pytest.CaptureFixture[str], *arguments: str) -> tuple[str, str]:
    """Run a command that must succeed; returns its stdout and stderr."""
    capfd.readouterr()
    code = invoke(list(arguments))
    out, err = capfd.readouterr()
    assert code == 0, err
    return out, err


def json_of(capfd: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    """The one JSON object on stdout of a command that must succeed."""
    result = json.loads(succeeds(capfd, *arguments, "--json"))
    assert isinstance(result, dict)
    return result


def python(code: str, *arguments: str | Path, here: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=here, timeout=600, check=False)


def run_as_command(action: str) -> str:
    """Code that runs an action, an expression, as the launcher runs a command; no command is imported."""
    return (
        "import sys, types\n"
        "app = sys.modules['monoloc.cli.app'] = types.ModuleType('app')\n"
        f"app.command_line, app.carry_out = list, lambda _: {action}\n"
        "from monoloc.cli.main import run\n"
        "run()"
    )


def exit_by(*arguments: str) -> None:
    """Run a command as the whole of a process."""
    sys.exit(invoke(list(arguments)))


def refused(
    capfd: pytest.CaptureFixture[str],
    folder: Path,
    arguments: tuple[str, ...],
    names: str,
    problem: str,
    fix: str = "",
) -> None:
    """The command ends with exit code 2 and one line (what it names, the problem, the fix), and leaves no trace."""
    before = listing(folder)
    capfd.readouterr()
    code = invoke(list(arguments))
    out, err = capfd.readouterr()
    lines = [line for line in err.splitlines() if not re.fullmatch(r"(\d/\d )?[a-z: ]+: done in [\d.]+ s", line)]
    assert code == 2, err
    assert out == ""
    assert len(lines) == 1, err
    assert re.fullmatch(f"monoloc: {re.escape(names)}.*{problem}.*; .*{fix}.*", lines[0]), lines[0]
    assert listing(folder) == before
