"""Errors without single components of the localizer: landmarks, adaptation, odometry; and with gravity."""

from __future__ import annotations

from dataclasses import dataclass

from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.comparison import Case, comparison
from monoloc_lab.experiments.gather import DARK, network_of, usual_light
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Task


@dataclass(frozen=True)
class _Configuration:
    variant: str = "joint"
    landmarks: bool = False
    motion: str = "visual"
    gravity: bool = False


_CONFIGURATIONS = {
    "adapted, landmarks": _Configuration(landmarks=True),
    "adapted": _Configuration(),
    "unadapted, landmarks": _Configuration("unadapted", landmarks=True),
    "unadapted": _Configuration("unadapted"),
    "adapted, landmarks, random walk": _Configuration(landmarks=True, motion="random-walk"),
    "adapted, random walk": _Configuration(motion="random-walk"),
    "adapted, gravity": _Configuration(gravity=True),
}


def _cases(study: Study) -> list[Case]:
    return [
        Case((split.name, light, size, name), _runs(study, split, light, size, configuration))
        for split in study.splits
        for light in (usual_light(split), DARK)
        for size in study.sizes
        for name, configuration in _CONFIGURATIONS.items()
    ]


def _runs(study: Study, split: Split, light: str, size: str, configuration: _Configuration) -> list[Task]:
    bundles = [
        factories.bundle(
            study, split, network_of(size), configuration.variant, seed=build, landmarks=configuration.landmarks
        )
        for build in range(study.builds)
    ]
    return [
        factories.run(
            bundles[seed % study.builds],
            split.recordings[light],
            seed,
            motion=configuration.motion,
            gravity=configuration.gravity,
        )
        for seed in range(study.seeds)
    ]


FIGURE = comparison(
    "ablation",
    "Components of the localizer",
    ("split", "light", "size", "components"),
    _cases,
    lambda study: "Errors by components of the localizer (median over seeds; smallest to largest)",
    "Adapted means that network and map are tuned. Random walk means without odometry. Gravity means that the "
    "localizer is given a simulated roll and pitch, with errors of 0.5° per axis that are constant in a run and 0.3° "
    "per frame.",
)
