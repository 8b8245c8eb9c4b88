"""Small studies and the execution of their tasks in this process."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from monoloc_lab.experiments.study import Study, recorded
from monoloc_lab.experiments.task import Result, Task
from monoloc_lab.experiments.work import KINDS
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, write_recording

NETWORK = "tiny-0.35"
FRAMES = 48  # so that every third of the first three quarters are enough frames for a build


def write_room(folder: Path, frames: int = FRAMES) -> RoomRecording:
    """Write a recording of the synthetic room."""
    recording = RoomRecording(Room(), make_path(frames, rate_hz=6.0), SMALL_CAMERA)
    write_recording(folder, recording)
    return recording


def small_study(folder: Path) -> Study:
    """A study of :func:`write_room` with few steps; its split is the extrapolation split."""
    whole = recorded(f"folder:{folder}", "room", FRAMES, quick=True)
    return replace(whole, adapt={"steps": 4, "synthesised_views": 4})


def execute(task: Task, out: Path, done: dict[str, Result]) -> Result:
    """The result of a task and of all that it needs, unless it is in ``done``; figures as they come from JSON."""
    if task.key not in done:
        needs = [execute(need, out, done) for need in task.needs]
        folder = out / task.key
        folder.mkdir(parents=True)
        figures = KINDS[task.kind](task.settings, needs, folder)
        done[task.key] = Result(folder, json.loads(json.dumps(figures)))
    return done[task.key]
