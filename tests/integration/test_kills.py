"""Kills at random moments: what was there before or the whole new result is there after each, and nothing else."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import QUICK, write_workspace
from monoloc.bundle import digest_of, read_bundle
from monoloc.cli.main import invoke
from monoloc.errors import DataError
from monoloc.flight.flight_recording import POSES, RecordedFrame, RecordedIdle, read_events, read_header
from monoloc.io.pose_table import read_pose_table
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

pytestmark = pytest.mark.slow
KILLS = 17  # of each command
FRAMES = 12


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    work, temporary = tmp_path / "work", tmp_path / "temporary"
    for folder in (work, temporary):
        folder.mkdir()
    write_workspace(work, RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA), 60)
    monkeypatch.chdir(work)
    monkeypatch.setenv("TMPDIR", str(temporary))
    return work


def begun(arguments: tuple[str, ...]) -> int:
    """A process that runs a command; a fork, which has imported everything already."""
    child = os.fork()
    if child == 0:
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            os._exit(invoke(list(arguments)))
        finally:
            os._exit(99)
    return child


def ended(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def kills(*arguments: str) -> Iterator[int]:
    """Run a command once whole, and then again and again, to a kill at a random moment; after each, its number."""
    rng = np.random.default_rng(0)
    began = time.monotonic()
    assert ended(begun(arguments)) == 0
    whole_s = time.monotonic() - began
    yield 0
    for number in range(1, KILLS + 1):
        child = begun(tuple(argument.replace("-0", f"-{number}") for argument in arguments))
        time.sleep(float(rng.uniform(0.0, 1.1 * whole_s)))
        os.kill(child, signal.SIGKILL)  # it waits for us, if it has ended
        assert ended(child) in (0, -signal.SIGKILL)
        yield number


def test_a_killed_build_leaves_the_old_bundle_or_the_new_one(here: Path, tmp_path: Path) -> None:
    room, before = here / "room.monoloc", {path.name for path in here.iterdir()}
    digests = {digest_of(room)}
    for number in kills("build", "flight", "--out", "room.monoloc", *QUICK, "--frames", "::2"):
        digests |= {digest_of(room)} if number == 0 else set()
        read_bundle(room)
        assert digest_of(room) in digests
    assert ended(begun(("build", "flight", "--out", "room.monoloc", *QUICK, "--frames", "::2"))) == 0
    assert {path.name for path in here.iterdir()} == before
    assert not list((tmp_path / "temporary").iterdir())


def test_a_killed_localize_leaves_the_old_table_or_the_new_one(here: Path) -> None:
    run = ("localize", "room.monoloc", "flight", "--start", "truth", "--out", "poses.csv")
    before = {path.name for path in here.iterdir()}
    for _ in kills(*run):
        times_s, _ = read_pose_table(here / "poses.csv")
        assert len(times_s) == FRAMES
    assert ended(begun(run)) == 0
    assert {path.name for path in here.iterdir()} == before | {"poses.csv"}


def test_a_killed_flight_has_recorded_whole_frames(here: Path) -> None:
    flown = []
    for number in kills("fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--record", "log-0"):
        folder = here / f"log-{number}"
        try:
            header = read_header(folder)
        except DataError:  # it was killed before it began
            continue
        events: list[tuple[np.ndarray, RecordedFrame] | RecordedIdle] = list(read_events(folder, header.camera))
        flown.append(sum(isinstance(event, tuple) for event in events))
        assert (folder / POSES).read_bytes().count(b"\n") >= flown[-1]
    assert flown[0] == FRAMES and len(flown) > KILLS // 4
