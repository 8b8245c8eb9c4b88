"""Kills at random moments: what was there before or the whole new result is there after each, and nothing else."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Iterator
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_helpers import QUICK, exit_by, write_workspace
from monoloc.bundle import digest_of, read_bundle
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


@pytest.fixture(scope="module")
def processes() -> BaseContext:
    """Processes that have imported everything when they begin."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["cli_helpers", *(f"monoloc.cli.{name}" for name in ("build", "localize", "fly"))])
    return context


def begun(processes: BaseContext, *arguments: str) -> Any:
    process = processes.Process(target=exit_by, args=arguments)  # type: ignore[attr-defined]
    process.start()
    return process


def runs_whole(processes: BaseContext, *arguments: str) -> None:
    process = begun(processes, *arguments)
    process.join()
    assert process.exitcode == 0


def kills(processes: BaseContext, *arguments: str) -> Iterator[int]:
    """Run a command once whole, and then again and again, to a kill at a random moment; after each, its number."""
    rng = np.random.default_rng(0)
    began = time.monotonic()
    runs_whole(processes, *(argument.replace("{}", "0") for argument in arguments))
    whole_s = time.monotonic() - began
    yield 0
    for number in range(1, KILLS + 1):
        process = begun(processes, *(argument.replace("{}", str(number)) for argument in arguments))
        process.join(float(rng.uniform(0.0, whole_s)))
        process.kill()
        process.join()
        assert process.exitcode in (0, -signal.SIGKILL)
        yield number


def test_a_killed_build_leaves_the_old_bundle_or_the_new_one(
    here: Path, tmp_path: Path, processes: BaseContext
) -> None:
    room, before = here / "room.monoloc", {path.name for path in here.iterdir()}
    digests = {digest_of(room)}
    build = ("build", "flight", "--out", "room.monoloc", *QUICK, "--frames", "::2")
    for number in kills(processes, *build):
        digests |= {digest_of(room)} if number == 0 else set()
        read_bundle(room)
        assert digest_of(room) in digests
    runs_whole(processes, *build)
    assert {path.name for path in here.iterdir()} == before
    assert not list((tmp_path / "temporary").iterdir())


def test_a_killed_localize_leaves_the_old_table_or_the_new_one(here: Path, processes: BaseContext) -> None:
    run = ("localize", "room.monoloc", "flight", "--start", "truth", "--out", "poses.csv")
    before = {path.name for path in here.iterdir()}
    for _ in kills(processes, *run):
        times_s, _ = read_pose_table(here / "poses.csv")
        assert len(times_s) == FRAMES
    runs_whole(processes, *run)
    assert {path.name for path in here.iterdir()} == before | {"poses.csv"}


def test_a_killed_flight_has_recorded_whole_frames(here: Path, processes: BaseContext) -> None:
    flown = []
    fly = ("fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--record", "log-{}")
    for number in kills(processes, *fly):
        folder = here / f"log-{number}"
        try:
            header = read_header(folder)
        except DataError:  # it was killed before it began
            continue
        events: list[tuple[np.ndarray, RecordedFrame] | RecordedIdle] = list(read_events(folder, header.camera))
        flown.append(sum(isinstance(event, tuple) for event in events))
        assert (folder / POSES).read_bytes().count(b"\n") >= flown[-1]
    assert flown[0] == FRAMES and len(flown) > KILLS // 4
