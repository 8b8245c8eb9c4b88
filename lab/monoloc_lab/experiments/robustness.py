"""Errors under harder conditions: noise in the build poses, and a narrower lens than the network was trained with."""

from __future__ import annotations

from dataclasses import replace

from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.altered import POSE_NOISE_DEG, POSE_NOISE_M
from monoloc_lab.experiments.comparison import Case, comparison
from monoloc_lab.experiments.gather import network_of, usual_recording
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Task

# By name: alterations of the build and of the evaluation recording, and whether the build refines poses.
_CONDITIONS: dict[str, tuple[str | None, str | None, bool]] = {
    "unaltered": (None, None, False),
    "pose noise": ("pose noise", None, False),
    "pose noise, refined poses": ("pose noise", None, True),
    "narrow lens": ("narrow lens", "narrow lens", False),
}
# By name: the variant, and whether the sensor's depth is used.
_METHODS = {
    "sensor depth": ("unadapted", True),
    "unadapted": ("unadapted", False),
    "last layer and map": ("last+map", False),
    "network and map": ("joint", False),
}


def _cases(study: Study) -> list[Case]:
    return [
        Case((split.name, condition, method), _runs(study, split, condition, method))
        for split in study.splits
        for condition in _CONDITIONS
        for method in _METHODS
    ]


def _runs(study: Study, split: Split, condition: str, method: str) -> list[Task]:
    build, evaluation, refine = _CONDITIONS[condition]
    variant, sensor = _METHODS[method]
    altered = replace(split, alteration=build)
    bundle = factories.bundle(study, altered, network_of(study.sizes[0]), variant, refine_poses=refine)
    recording = replace(usual_recording(split), alteration=evaluation)
    return factories.run_seeds(study, bundle, recording, sensor)


FIGURE = comparison(
    "robustness",
    "Harder conditions",
    ("split", "condition", "method"),
    _cases,
    lambda study: f"Errors under harder conditions, {study.sizes[0]} (median over seeds; smallest to largest)",
    f"Pose noise has a standard deviation of {100.0 * POSE_NOISE_M:g} cm and {POSE_NOISE_DEG:g}° per axis. The "
    "narrow lens shows the central 60 % of width and height, in build and evaluation. One build each.",
)
