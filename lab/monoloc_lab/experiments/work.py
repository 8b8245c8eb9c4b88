"""What does each kind of task: from settings, and the results of what it needs, to files and figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from monoloc_lab.experiments import work_located, work_posenets, work_rooms, work_runs
from monoloc_lab.experiments.task import Result
from monoloc_lab.experiments.task_inputs import Settings

# Settings, the results of what the task needs, and a folder to put files in -> figures, ready for JSON.
Work = Callable[[Settings, Sequence[Result], Path], dict[str, Any]]

KINDS: dict[str, Work] = {
    "bundle": work_rooms.bundle,
    "remapped": work_rooms.remapped,
    "run": work_runs.run,
    "depth": work_runs.depth,
    "clouds": work_runs.clouds,
    "posenet-search": work_posenets.posenet_search,
    "posenet": work_posenets.posenet,
    "posenet-run": work_located.posenet_run,
    "filtered-run": work_located.filtered_run,
    "keypoints-run": work_located.keypoints_run,
}
