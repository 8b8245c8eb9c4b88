"""The methods of localisation that the figures compare."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from monoloc.viz.picture import BLUE, GREEN, INK, ORANGE, PURPLE, SKY, VERMILION
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.gather import RMSE, Spread, network_of, spread_of
from monoloc_lab.experiments.study import EvalRecording, Split, Study
from monoloc_lab.experiments.task import Results, Task

# Study, split, network size, recording, seed -> the task that localises the recording.
RunFactory = Callable[[Study, Split, str, EvalRecording, int], Task]


@dataclass(frozen=True)
class Method:
    """A method of localisation.

    Attributes:
        name: in legends and tables.
        colour: in every plot.
        task: localises a recording.
        seeded: whether the result depends on the seed.
    """

    name: str
    colour: str
    task: RunFactory
    seeded: bool = True

    def runs(self, study: Study, split: Split, size: str, recording: EvalRecording) -> list[Task]:
        """One per seed."""
        seeds = range(study.seeds) if self.seeded else range(1)
        return [self.task(study, split, size, recording, seed) for seed in seeds]

    def rmse(self, study: Study, results: Results, split: Split, size: str, recording: EvalRecording) -> Spread:
        """Position RMSE on unseen frames over seeds, metres."""
        return spread_of(results, self.runs(study, split, size, recording), RMSE)


def bundle_of(study: Study, split: Split, size: str, variant: str, seed: int = 0) -> Task:
    """The bundle that a run with a seed uses."""
    return tasks.bundle(study, split, network_of(size), variant, seed=seed % study.builds)


def _run_of(variant: str) -> RunFactory:
    def task(study: Study, split: Split, size: str, recording: EvalRecording, seed: int) -> Task:
        return tasks.run(bundle_of(study, split, size, variant, seed), recording, seed)

    return task


def _posenet_of(views: bool) -> RunFactory:
    def task(study: Study, split: Split, size: str, recording: EvalRecording, seed: int) -> Task:
        return tasks.posenet_run(tasks.posenet(study, split, size, seed, views), recording)

    return task


def _filtered(study: Study, split: Split, size: str, recording: EvalRecording, seed: int) -> Task:
    bundle = bundle_of(study, split, size, "joint", seed)
    return tasks.filtered_run(tasks.posenet(study, split, size, seed), bundle, recording, seed)


def _sensor(study: Study, split: Split, size: str, recording: EvalRecording, seed: int) -> Task:
    # With the original map: the adapted one is fitted to the depth of a network.
    return tasks.run(bundle_of(study, split, study.sizes[0], "unadapted", seed), recording, seed, sensor=True)


def _keypoints_of(kind: Literal["orb", "sift"]) -> RunFactory:
    def task(study: Study, split: Split, size: str, recording: EvalRecording, seed: int) -> Task:
        return tasks.keypoints_run(study, split, recording, kind)

    return task


POSENET = Method("PoseNet", VERMILION, _posenet_of(views=False))
POSENET_WITH_VIEWS = Method("PoseNet, with views", "#8C3A00", _posenet_of(views=True))
FILTERED = Method("filtered PoseNet", PURPLE, _filtered)
UNADAPTED = Method("unadapted", ORANGE, _run_of("unadapted"))
LAST_AND_MAP = Method("last layer and map", GREEN, _run_of("last+map"))
JOINT = Method("network and map", BLUE, _run_of("joint"))
SENSOR = Method("sensor depth in our filter", INK, _sensor)
ORB = Method("ORB keypoints", SKY, _keypoints_of("orb"), seeded=False)
SIFT = Method("SIFT keypoints", "#2A7F9E", _keypoints_of("sift"), seeded=False)

BY_SIZE = (POSENET, FILTERED, UNADAPTED, LAST_AND_MAP, JOINT)
"""Methods with a network of every size. The paper tunes the last layer and the map."""


def keypoint_methods(study: Study) -> tuple[Method, ...]:
    """Keypoint methods; a quick study leaves out SIFT, which takes a minute per recording."""
    return (ORB,) if study.quick else (ORB, SIFT)
