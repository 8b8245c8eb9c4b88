"""Very many steps: growth is found where there is some."""

from __future__ import annotations

from mmap import mmap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_helpers import json_of, outputs, write_workspace
from monoloc.localizer import Localizer
from monoloc.step import Step
from monoloc_lab.soak import many_steps
from monoloc_lab.soak.many_steps import median_slope
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

KEYS = {
    "machine", "steps", "image", "jumps", "states", "resident_mb", "resident_mb_growth", "step_ms", "step_growth",
    "threads", "files", "objects",
}  # fmt: skip


def test_slope_is_that_of_most_points() -> None:
    x = np.arange(30.0)
    y = 2.0 * x + np.where(x % 10 == 0, 1000.0, 1.0)
    assert median_slope(x, y) == pytest.approx(2.0)


@pytest.mark.slow  # lost cameras, which are searched for
def test_memory_that_grows_is_seen(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_workspace(tmp_path, RoomRecording(Room(), make_path(10), SMALL_CAMERA), 40)
    monkeypatch.setattr(many_steps, "_LAPS", 5)
    command = ("bench", "soak", str(tmp_path / "room.monoloc"), str(tmp_path / "flight"), "--steps", "200")
    assert "resident mb growth" in outputs(capfd, *command)[0]
    kept, step = [], Localizer.step

    def leaking(self: Localizer, *arguments: Any) -> Step:
        block = mmap(-1, 1_000_000)  # new pages: memory that another test has freed is resident already
        block.write(bytes(len(block)))
        kept.append(block)
        return step(self, *arguments)

    monkeypatch.setattr(Localizer, "step", leaking)
    figures = json_of(capfd, *command)
    assert set(figures) == KEYS and figures["steps"] == 200 and figures["image"] == [160, 128]
    assert sum(figures["states"].values()) == 200 and figures["jumps"] == 200 // (5 * 18)
    assert figures["resident_mb_growth"] == pytest.approx(100_000.0, rel=0.1)
