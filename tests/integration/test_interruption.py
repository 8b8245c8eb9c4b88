"""What is interrupted leaves nothing half-written, and older files as they were."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cli_helpers import UNTUNED, listing, python, write_workspace
from edit_helpers import mapped_room
from monoloc.bundle import read_bundle, write_bundle
from monoloc.cli.main import invoke
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, write_recording


@pytest.mark.parametrize("again_s", [None, 0.005, 0.1])
def test_interrupted_build_leaves_nothing_half_written(tmp_path: Path, again_s: float | None) -> None:
    """Nor does a second Ctrl-C, while it cleans up or while Python ends."""
    write_workspace(tmp_path, RoomRecording(Room(), make_path(6), SMALL_CAMERA), components=60)
    before = listing(tmp_path)
    code = "from monoloc.cli.main import run; run()"
    # Thousands of components: the map alone takes many times longer than this test waits.
    build = ["build", "flight", "--out", "room.monoloc", *UNTUNED, "-k", "3000"]
    process = subprocess.Popen(
        [sys.executable, "-c", code, *build],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        # Background jobs and nohup ignore signals, and a child inherits that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stderr is not None
    assert [process.stderr.readline().split()[1] for _ in range(2)] == ["check:", "cloud:"]
    time.sleep(0.3)
    assert process.poll() is None, "the build ended before it could be interrupted"
    process.send_signal(signal.SIGINT)
    if again_s is not None:
        time.sleep(again_s)
        process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == "" and err == "monoloc: interrupted; nothing half-written is left\n"
    assert listing(tmp_path) == before


def test_terminated_reconstruction_leaves_nothing(tmp_path: Path) -> None:
    write_recording(tmp_path / "flight", RoomRecording(Room(), make_path(40, rate_hz=3.0), SMALL_CAMERA))
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", "from monoloc.cli.main import run; run()", "reconstruct", "flight", "--out", "walk"],
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"TMPDIR": str(temporary)},
    )
    assert process.stderr is not None
    assert process.stderr.readline().startswith("keyframes: done")
    time.sleep(1.0)
    assert process.poll() is None, "the reconstruction ended before it could be terminated"
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "monoloc: interrupted; nothing half-written is left"
    assert {path.name for path in tmp_path.iterdir()} == {"flight", "temporary"}
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize(
    "file", ["manifest.json", *(pytest.param(name, marks=pytest.mark.slow) for name in ("map.npz", "edits.npz"))]
)
def test_killed_edit_leaves_the_old_bundle_and_the_next_one_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    write_bundle(tmp_path / "room.monoloc", mapped_room())
    before = listing(tmp_path)
    code = f"""
import os, signal
from pathlib import Path
from monoloc.cli.main import run
write_bytes = Path.write_bytes
def killed(self, content):
    write_bytes(self, content[: len(content) // 2])
    if self.name == {file!r}:
        os.kill(os.getpid(), signal.SIGKILL)
    return write_bytes(self, content)
Path.write_bytes = killed
run()
"""
    edit = ["map", "edit", "room.monoloc", "remove", "--box=-0.3,0.4,1.7,0.3,1,2.3"]
    process = python(code, *edit, here=tmp_path)
    assert process.returncode == -signal.SIGKILL
    left = {name: content for name, content in listing(tmp_path).items() if not name.startswith(".room.monoloc")}
    assert left == before
    monkeypatch.chdir(tmp_path)
    assert invoke(edit) == 0
    assert len(read_bundle(tmp_path / "room.monoloc").edits) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["room.monoloc"]
