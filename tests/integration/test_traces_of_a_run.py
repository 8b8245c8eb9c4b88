"""A run leaves what it was asked for and nothing else: no files elsewhere, no word on stdout beside its result."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from cli_helpers import listing, write_workspace
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

RUN = "from monoloc.cli.main import run; run()"
# onnxruntime is silent under tests of its own and of others.
SILENCING = ("ORT_DISABLE_TELEMETRY", "ORT_RUNNING_UNIT_TESTS", "CI", "GITHUB_ACTIONS", "TF_BUILD")


def test_localizing_leaves_no_files_and_prints_one_object(tmp_path: Path) -> None:
    write_workspace(tmp_path, RoomRecording(Room(), make_path(3), SMALL_CAMERA), components=40)
    homes = {name: tmp_path / name for name in ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME")}
    for home in homes.values():
        home.mkdir()
    before = listing(tmp_path)
    environment = {name: value for name, value in os.environ.items() if name not in SILENCING}
    process = subprocess.run(
        [sys.executable, "-c", RUN, "localize", "room.monoloc", "flight", "--start", "truth", "--json"],
        cwd=tmp_path,
        env=environment | {name: str(home) for name, home in homes.items()},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(process.stdout)["frames"] == 3
    assert listing(tmp_path) == before
