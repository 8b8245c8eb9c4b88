"""A build that is interrupted leaves nothing half-written, and an older bundle as it was."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

from cli_helpers import UNTUNED, listing, write_workspace
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


def test_interrupted_build_leaves_nothing_half_written(tmp_path: Path) -> None:
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
    assert [process.stderr.readline().split()[0] for _ in range(2)] == ["check:", "cloud:"]
    time.sleep(0.3)
    assert process.poll() is None, "the build ended before it could be interrupted"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == "" and err == "monoloc: interrupted; nothing half-written is left\n"
    assert listing(tmp_path) == before
