"""The work of each kind of task: from settings, and the results that the task needs, to files and figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from monoloc_lab.experiments import work_localize, work_posenets, work_rooms, work_runs
from monoloc_lab.experiments.task import Result
from monoloc_lab.experiments.task_inputs import Settings

# Settings, the results that the task needs, and an output folder -> figures, ready for JSON.
Work = Callable[[Settings, Sequence[Result], Path], dict[str, Any]]

KINDS: dict[str, Work] = {
    "bundle": work_rooms.bundle,
    "remapped": work_rooms.remapped,
    "run": work_runs.run,
    "depth": work_runs.depth,
    "clouds": work_runs.clouds,
    "posenet-search": work_posenets.posenet_search,
    "posenet": work_posenets.posenet,
    "posenet-run": work_localize.posenet_run,
    "filtered-run": work_localize.filtered_run,
    "keypoints-run": work_localize.keypoints_run,
}
