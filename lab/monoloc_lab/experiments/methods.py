"""The ways to find a pose that are held against one another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from monoloc.viz.picture import BLUE, GREEN, INK, ORANGE, PURPLE, SKY, VERMILION
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.gather import RMSE, Spread, network_of, seeds_of, spread_of
from monoloc_lab.experiments.study import Split, Study, Walk
from monoloc_lab.experiments.task import Results, Task

# Study, split, network size, walk, seed -> the task that locates the walk.
Locating = Callable[[Study, Split, str, Walk, int], Task]


@dataclass(frozen=True)
class Method:
    """A way to find a pose.

    Attributes:
        name: in legends and tables.
        colour: in every picture.
        task: how a walk is located by it.
        seeded: whether seeds make a difference.
    """

    name: str
    colour: str
    task: Locating
    seeded: bool = True

    def runs(self, study: Study, split: Split, size: str, walk: Walk) -> list[Task]:
        """One a seed."""
        seeds = seeds_of(study) if self.seeded else range(1)
        return [self.task(study, split, size, walk, seed) for seed in seeds]

    def rmse(self, study: Study, results: Results, split: Split, size: str, walk: Walk) -> Spread:
        """Position RMSE on unseen frames over seeds, metres."""
        return spread_of(results, self.runs(study, split, size, walk), RMSE)


def bundle_of(study: Study, split: Split, size: str, variant: str, seed: int = 0) -> Task:
    """The bundle that a run with a seed uses: rooms are built anew as often as the study says."""
    return tasks.bundle(study, split, network_of(size), variant, seed=seed % study.builds)


def _followed(variant: str) -> Locating:
    def task(study: Study, split: Split, size: str, walk: Walk, seed: int) -> Task:
        return tasks.run(bundle_of(study, split, size, variant, seed), walk, seed)

    return task


def _posenet(study: Study, split: Split, size: str, walk: Walk, seed: int) -> Task:
    return tasks.posenet_run(tasks.posenet(study, split, size, seed), walk)


def _posenet_with_views(study: Study, split: Split, size: str, walk: Walk, seed: int) -> Task:
    return tasks.posenet_run(tasks.posenet(study, split, size, seed, views=True), walk)


def _filtered(study: Study, split: Split, size: str, walk: Walk, seed: int) -> Task:
    built = bundle_of(study, split, size, "joint", seed)
    return tasks.filtered_run(tasks.posenet(study, split, size, seed), built, walk, seed)


def _sensor(study: Study, split: Split, size: str, walk: Walk, seed: int) -> Task:
    # In the map as it was fitted: the adapted one is bent towards a network's depth.
    return tasks.run(bundle_of(study, split, study.sizes[0], "unadapted", seed), walk, seed, sensor=True)


def _orb(study: Study, split: Split, size: str, walk: Walk, seed: int) -> Task:
    return tasks.keypoints_run(study, split, walk, "orb")


def _sift(study: Study, split: Split, size: str, walk: Walk, seed: int) -> Task:
    return tasks.keypoints_run(study, split, walk, "sift")


POSENET = Method("PoseNet", VERMILION, _posenet)
POSENET_WITH_VIEWS = Method("PoseNet, with views", "#8C3A00", _posenet_with_views)
FILTERED = Method("filtered PoseNet", PURPLE, _filtered)
UNADAPTED = Method("unadapted", ORANGE, _followed("unadapted"))
PAPERS = Method("last layer + map (paper's)", GREEN, _followed("last+map"))
JOINT = Method("network + map (monoloc)", BLUE, _followed("joint"))
SENSOR = Method("sensor depth in our filter", INK, _sensor)
ORB = Method("ORB keypoints", SKY, _orb, seeded=False)
SIFT = Method("SIFT keypoints", "#2A7F9E", _sift, seeded=False)

BY_SIZE = (POSENET, FILTERED, UNADAPTED, PAPERS, JOINT)
"""What has a network of every size."""


def keypoint_methods(study: Study) -> tuple[Method, ...]:
    """A quick study leaves SIFT out, which takes a minute a walk."""
    return (ORB,) if study.quick else (ORB, SIFT)
