"""Errors by the settings of adaptation, one changed at a time."""

from __future__ import annotations

from typing import Any

from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.comparison import Case, comparison
from monoloc_lab.experiments.gather import network_of, usual_recording
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Task

# By name: the variant, and the changed settings.
_SETTINGS: dict[str, tuple[str, dict[str, Any]]] = {
    "default": ("joint", {}),
    "decoder tuned": ("decoder", {}),
    "without synthesised views": ("joint", {"synthesised_views": 0}),
    "without pose steps": ("joint", {"pose_weight": 0.0}),
    **{f"{count} components": ("joint", {"components": count}) for count in (50, 100, 400, 800)},
    **{f"rate {rate:g}": ("joint", {"network_rate": rate}) for rate in (3e-4, 3e-3)},
    **{f"inflation {value:g} m": ("joint", {"inflation_m": value}) for value in (0.0, 0.1, 1.0)},
    "last layer and map": ("last+map", {}),
    **{
        f"last layer and map, inflation {value:g} m": ("last+map", {"inflation_m": value})
        for value in (0.0, 0.1, 1.0)
    },
}


def _cases(study: Study) -> list[Case]:
    return [
        Case((split.name, name), _runs(study, split, variant, changed))
        for split in study.splits
        for name, (variant, changed) in _SETTINGS.items()
    ]


def _runs(study: Study, split: Split, variant: str, changed: dict[str, Any]) -> list[Task]:
    bundle = factories.bundle(study, split, network_of(study.sizes[0]), variant, **changed)
    return factories.run_seeds(study, bundle, usual_recording(split))


FIGURE = comparison(
    "adapt-settings",
    "Settings of adaptation",
    ("split", "setting"),
    _cases,
    lambda study: f"Errors by settings of adaptation, {study.sizes[0]} (median over seeds; smallest to largest)",
    "Each row changes one setting from its default; one build each. The figure lambda varies the weight of the "
    "divergence.",
)
