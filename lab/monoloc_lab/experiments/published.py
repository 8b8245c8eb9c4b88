"""Published splits: which sequences of a data set build a scene, which are localised, and the row of figures.

Each test sequence is flown in order, without a start. Figures are over all frames of all test sequences of a scene,
those while the camera is *lost* included, as methods that take one image count every image.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.builder.build_config import BuildConfig
from monoloc.errors import DataError
from monoloc.evaluation.trajectory import TrajectoryMetrics, summarise
from monoloc.io.file_access import read_text, require_file
from monoloc.io.registry import open_recording
from monoloc.io.twelve_scenes import read_sequences
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.gather import trajectory
from monoloc_lab.experiments.study import EvalRecording, Split
from monoloc_lab.experiments.task import Results, Task

_SEVEN_SCENES_LINE = re.compile(r"(?:sequence|seq-?)(\d{1,4})", re.IGNORECASE)
_FIGURES = ("position_median_cm", "rotation_median_deg", "within_5cm_5deg")


@dataclass(frozen=True)
class Benchmark:
    """A data set with a published split.

    Attributes:
        title: and its source.
        scenes: folders of its scenes, below that of the data set.
        split: names of the training and of the test sequences of a scene's folder, as frame names begin.
    """

    title: str
    scenes: tuple[str, ...]
    split: Callable[[Path], tuple[list[str], list[str]]]


@dataclass(frozen=True)
class PublishedScene:
    """A scene and its split.

    Attributes:
        name: folder below that of the data set.
        split: the training frames, and the test frames by sequence.
        training: names of the training sequences.
        notes: of the reader: frames that are left out, and why.
    """

    name: str
    split: Split
    training: list[str]
    notes: list[str]


def read_scene(benchmark: str, folder: Path, name: str) -> PublishedScene:
    """A scene of a data set in its published layout.

    Args:
        benchmark: key of :data:`BENCHMARKS`, and the format of its scenes.
        folder: of the data set.
        name: of the scene.

    Raises:
        DataError: a file is missing or malformed, the split names a sequence that is not there or one twice, or
            there are no poses.
    """
    scene = folder.resolve() / name
    if not scene.is_dir():
        raise DataError(scene, "is missing", "unpack it there, or name those that are there with --scene")
    training, test = BENCHMARKS[benchmark].split(scene)
    source = f"{benchmark}:{scene}"
    recording = open_recording(source)
    if recording.poses is None:
        raise DataError(scene, "has no poses", "unpack the frame-NNNNNN.pose.txt files too")
    sequences = [frame.partition("/")[0] for frame in recording.frame_names]
    for sequence in [*training, *test]:
        if sequence not in sequences:
            raise DataError(scene, f"has no usable frame of {sequence}", "unpack the scene's archives again")
    recordings = {each: EvalRecording(source, _ranges(sequences, [each]), None) for each in test}
    split = Split(f"published, {name}", source, _ranges(sequences, training), recordings)
    return PublishedScene(name, split, training, recording.notes)


def _ranges(sequences: Sequence[str], chosen: Sequence[str]) -> str:
    """Frames of some sequences, as ``--frames`` takes them: START:STOP, with commas."""
    inside = np.concatenate([[False], np.isin(sequences, chosen), [False]])
    starts, stops = np.flatnonzero(np.diff(inside.astype(np.int8))).reshape(-1, 2).T
    return ",".join(f"{start}:{stop}" for start, stop in zip(starts, stops, strict=True))


def _seven_scenes_split(scene: Path) -> tuple[list[str], list[str]]:
    training, test = (_named_sequences(scene / file) for file in ("TrainSplit.txt", "TestSplit.txt"))
    both = next((sequence for sequence in test if sequence in training), None)
    if both is not None:
        problem = f"names {both}, which TrainSplit.txt names too"
        raise DataError(scene / "TestSplit.txt", problem, "restore the published files")
    return training, test


def _named_sequences(file: Path) -> list[str]:
    """Folders of the sequences that a split file names, in order: ``sequence3`` is ``seq-03``."""
    require_file(file, "restore it: it comes in the scene's archive")
    found: set[str] = set()
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        if not line.strip():
            continue
        match = _SEVEN_SCENES_LINE.fullmatch(line.strip())
        if match is None:
            raise DataError(file, f"line {number} is not a sequence", "each line holds: sequenceN")
        folder = f"seq-{int(match[1]):02d}"
        if not (file.parent / folder).is_dir():
            problem = f"names {line.strip()}, and there is no folder {folder}"
            raise DataError(file, problem, f"unpack {folder}.zip beside it")
        found.add(folder)
    if not found:
        raise DataError(file, "names no sequence", "each line holds: sequenceN")
    return sorted(found)


def _twelve_scenes_split(scene: Path) -> tuple[list[str], list[str]]:
    """The first sequence is the test sequence, and the others train, as Valentin et al. and those after them do."""
    first, *others = (sequence.name for sequence in read_sequences(scene / "split.txt"))
    if not others:
        raise DataError(scene / "split.txt", "names one sequence", "give a scene with training sequences")
    return others, [first]


BENCHMARKS: dict[str, Benchmark] = {
    "7scenes": Benchmark(
        "7-Scenes (Shotton et al., CVPR 2013)",
        ("chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs"),
        _seven_scenes_split,
    ),
    "12scenes": Benchmark(
        "12-Scenes (Valentin et al., 3DV 2016)",
        (
            *("apt1/kitchen", "apt1/living", "apt2/bed", "apt2/kitchen", "apt2/living", "apt2/luke"),
            *("office1/gates362", "office1/gates381", "office1/lounge", "office1/manolis"),
            *("office2/5a", "office2/5b"),
        ),
        _twelve_scenes_split,
    ),
}
"""Data sets whose split others' figures are stated on, by their format."""


def scene_runs(scene: PublishedScene, network: str, config: BuildConfig) -> dict[str, Task]:
    """Every test sequence of a scene, flown without a start with one bundle of the training sequences."""
    bundle = tasks.built(scene.split, network, config, seed=0)
    recordings = scene.split.recordings
    return {name: tasks.run(bundle, each, seed=0, start_is_known=False) for name, each in recordings.items()}


def scene_row(scene: PublishedScene, runs: dict[str, Task], results: Results) -> dict[str, Any]:
    """A scene's row: figures over all its test frames, and under ``sequences`` over those of each."""
    flown = {name: results[run] for name, run in runs.items()}
    built = results[next(iter(runs.values())).needs[0]].figures
    trajectories = [trajectory(result) for result in flown.values()]
    poses, truths = ([each[name] for each in trajectories] for name in ("poses", "truth"))
    parts = {
        name: {
            "frames": len(truth),
            "lost_frames": result.figures["lost_frames"],
            **_figures(summarise(estimated, truth)),
        }
        for (name, result), estimated, truth in zip(flown.items(), poses, truths, strict=True)
    }
    return {
        "scene": scene.name,
        "test_frames": sum(map(len, truths)),
        "lost_frames": sum(part["lost_frames"] for part in parts.values()),
        **_figures(summarise(np.concatenate(poses), np.concatenate(truths))),
        "training_sequences": scene.training,
        "training_frames": built["recorded_frames"],
        "build_frames": built["frames"],
        "build_s": built["seconds"],
        "notes": scene.notes,
        "sequences": parts,
    }


def over_scenes(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Mean and median over scenes of the figures that are published."""
    return {
        name: {figure: float(of([row[figure] for row in rows])) for figure in _FIGURES}
        for name, of in (("mean", np.mean), ("median", np.median))
    }


def _figures(metrics: TrajectoryMetrics) -> dict[str, float]:
    values = (100.0 * metrics.ate_median_m, metrics.rot_median_deg, metrics.within_5cm_5deg)
    return dict(zip(_FIGURES, values, strict=True))
