"""Numbers that several figures need: spreads over seeds, depth errors, distances to the build frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.models import shipped_models
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.recording import Selection
from monoloc.io.registry import open_recording, select_frames
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.study import AS_RECORDED, WIDTH, EvalRecording, Split, Study
from monoloc_lab.experiments.task import Result, Results, Task
from monoloc_lab.experiments.task_inputs import BUNDLE, TRAJECTORY_FILE

BRIGHT, DARK = "L1", "L3"
RMSE, MEDIAN, ROTATION = "unseen_ate_rmse_m", "unseen_ate_median_m", "unseen_rot_median_deg"
DEAD_RECKONING = "unseen_odometry_ate_rmse_m"
FROM_SAME_START = "unseen_odometry_from_start_ate_rmse_m"
_USUAL = (AS_RECORDED, "L2")  # the light of the build frames
_SHOWN = (0.3, 0.7)  # positions of the plotted frames in a recording
_LEAST_VALID_DEPTH = 0.1  # share of the pixels of a plotted frame


@dataclass(frozen=True)
class Spread:
    """A number over seeds; NaN if no run has it."""

    values: tuple[float, ...]

    @property
    def median(self) -> float:
        return float(np.median(self.values)) if self.values else float("nan")

    @property
    def range(self) -> tuple[float, float]:
        return (min(self.values), max(self.values)) if self.values else (float("nan"), float("nan"))

    def numbers(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"median": self.median, "smallest": self.range[0], "largest": self.range[1], "runs": list(self.values)}

    def centimetres(self) -> str:
        """Text of a spread in metres."""
        low, high = (f"{100.0 * value:.1f}" for value in self.range)
        if not self.values:
            return "none"
        middle = f"{100.0 * self.median:.1f}"
        return f"{middle} cm" if low == high else f"{middle} cm ({low} to {high})"

    def __truediv__(self, other: Spread) -> Spread:
        """Ratios, seed by seed."""
        if len(self.values) != len(other.values):
            return Spread(())  # without the number of some seed, the pairs are unknown
        pairs = zip(self.values, other.values, strict=True)
        return Spread(tuple(mine / theirs for mine, theirs in pairs))


def spread_of(results: Results, of: Iterable[Task], name: str) -> Spread:
    """A figure over tasks that differ in their seed. Runs without the figure, which found no pose, are left out."""
    found = (results[task].figures.get(name) for task in of)
    return Spread(tuple(float(value) for value in found if value is not None))


def usual_light(split: Split) -> str:
    """The light of the build frames."""
    return next(light for light in _USUAL if light in split.recordings)


def usual_recording(split: Split) -> EvalRecording:
    """The evaluation recording in the light of the build frames."""
    return split.recordings[usual_light(split)]


def compared_lights(split: Split) -> tuple[str, ...]:
    """The light of the build frames, bright light and near darkness."""
    return tuple(dict.fromkeys([usual_light(split), BRIGHT, DARK]))


def network_of(size: str) -> str:
    """The depth network of a size."""
    return f"{size}-{WIDTH}"


def parameters_of(size: str) -> int:
    return next(model.parameters for model in shipped_models() if model.name == network_of(size))


def size_labels(study: Study) -> list[str]:
    """Axis labels of the sizes, with their parameters."""
    return [f"{size}\n{parameters_of(size) / 1e6:.2f} M parameters" for size in study.sizes]


def picture_path(study: Study, folder: Path, name: str, split: Split) -> Path:
    """``NAME.png``, or ``NAME-SPLIT.png`` if there are several splits."""
    return folder / (f"{name}.png" if len(study.splits) == 1 else f"{name}-{split.name.replace(' ', '-')}.png")


def in_split(study: Study, split: Split) -> str:
    """The name of the split for a title; empty if there is only one."""
    return "" if len(study.splits) == 1 else f", {split.name}"


def frames_of(source: str, frames: str) -> Selection:
    return select_frames(open_recording(source), frames)


def depth_task(source: Task | str, recording: EvalRecording) -> Task:
    """Depth of a recording, with the frames that all figures plot."""
    return tasks.depth(source, recording, tasks.DEPTH_STRIDE, shown_frames(recording))


def depth_of_variant(variant: str, bundle: Task, recording: EvalRecording) -> Task:
    """Depth of a recording by the network of a bundle, or by the unadapted network if the variant tunes none."""
    return depth_task(bundle.settings["network"] if variant in ("unadapted", "map") else bundle, recording)


@cache
def shown_frames(recording: EvalRecording) -> tuple[int, ...]:
    """Positions of the plotted frames: they have sensor depth, and their depth error is computed.

    Raises:
        DataError: no such frame has depth.
    """
    frames = frames_of(recording.source, recording.frames)
    compared = range(0, len(frames), tasks.DEPTH_STRIDE)

    def nearest(wanted: int) -> int:
        for place in sorted(compared, key=lambda place: abs(place - wanted)):
            if np.mean(frames.depth(place) > 0.0) >= _LEAST_VALID_DEPTH:
                return place
        raise DataError(frames.name, "has no depth in the frames to be shown", "give one whose frames have depth")

    whole = len(frames) // tasks.DEPTH_STRIDE
    return tuple(nearest(tasks.DEPTH_STRIDE * int(share * whole)) for share in _SHOWN)


def mean_depth(result: Result, split: Split, recording: EvalRecording, name: str) -> float:
    """Mean of ``absrel``, ``delta1`` or ``ssim`` over compared frames that are not build frames; NaN for none."""
    per_frame = result.figures["per_frame"]
    unseen = unseen_frames(split, recording)
    values = [value for index, value in zip(per_frame["index"], per_frame[name], strict=True) if unseen[index]]
    defined = [value for value in values if value is not None]
    return float(np.mean(defined)) if defined else float("nan")


def frame_depth(result: Result, index: int) -> dict[str, float | None]:
    """``absrel``, ``delta1`` and ``ssim`` of one compared frame."""
    per_frame = result.figures["per_frame"]
    place = per_frame["index"].index(index)
    return {name: per_frame[name][place] for name in ("absrel", "delta1", "ssim")}


def unseen_frames(split: Split, recording: EvalRecording) -> NDArray[np.bool_]:
    """(N,) frames of a recording that are not build frames."""
    return _unseen(split.source, split.frames, recording)


@cache
def _unseen(source: str, build: str, recording: EvalRecording) -> NDArray[np.bool_]:
    evaluated = frames_of(recording.source, recording.frames)
    if recording.source != source:
        return np.ones(len(evaluated), dtype=np.bool_)
    return ~np.isin(evaluated.positions, frames_of(source, build).positions)


def trajectory(result: Result) -> dict[str, Any]:
    """The arrays of :data:`monoloc_lab.experiments.tasks.TRAJECTORY_ARRAYS`."""
    with np.load(result.folder / TRAJECTORY_FILE) as arrays:
        return dict(arrays)


def depth_arrays(result: Result) -> dict[str, Any]:
    """The arrays of :func:`monoloc_lab.experiments.tasks.depth`."""
    with np.load(result.folder / "depth.npz") as arrays:
        return dict(arrays)


def room_map(result: Result) -> tuple[FloatArray, FloatArray]:
    """Means and covariances of the original map of a bundle."""
    from monoloc.bundle import read_bundle

    original = read_bundle(result.folder / BUNDLE).original
    return original.means, original.covariances


def nearest_build_m(split: Split, recording: EvalRecording) -> float:
    """Median distance of the unseen cameras of a recording to the nearest build camera, metres."""
    build, evaluated = (frames_of(of.source, of.frames).poses for of in (split, recording))
    assert build is not None and evaluated is not None  # a study's recordings have poses
    from_m = evaluated[unseen_frames(split, recording), :3, 3]
    distances = np.linalg.norm(from_m[:, None] - build[None, :, :3, 3], axis=-1)
    return float(np.median(distances.min(axis=1)))


def and_list(names: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
