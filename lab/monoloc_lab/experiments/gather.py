"""What several figures ask for: the usual light, depth against the sensor's, spreads over seeds, distances."""

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
from monoloc_lab.experiments.study import WIDTH, Split, Study, Walk
from monoloc_lab.experiments.task import Result, Results, Task
from monoloc_lab.experiments.task_inputs import BUNDLE, WAY_FILE

DARK = "L3"
RMSE, MEDIAN, ROTATION = "unseen_ate_rmse_m", "unseen_ate_median_m", "unseen_rot_median_deg"
_USUAL = ("as taken", "L2")  # the light of the build frames
_SHOWN = (0.3, 0.7)  # of a walk: frames that are shown
_WITH_DEPTH = 0.1  # of their pixels, at least


@dataclass(frozen=True)
class Spread:
    """A number over seeds; NaN where no run has it."""

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
        """As people read it: of metres."""
        low, high = (f"{100.0 * value:.1f}" for value in self.range)
        if not self.values:
            return "none"
        middle = f"{100.0 * self.median:.1f}"
        return f"{middle} cm" if low == high else f"{middle} cm ({low} to {high})"

    def __truediv__(self, other: Spread) -> Spread:
        """Ratios, seed by seed."""
        if len(self.values) != len(other.values):
            return Spread(())  # a seed without a figure: which belong together is not known
        pairs = zip(self.values, other.values, strict=True)
        return Spread(tuple(mine / theirs for mine, theirs in pairs))


def spread_of(results: Results, of: Iterable[Task], name: str) -> Spread:
    """A figure over tasks that differ in their seed; runs without it, which located nothing, are passed over."""
    found = (results[task].figures.get(name) for task in of)
    return Spread(tuple(float(value) for value in found if value is not None))


def usual_light(split: Split) -> str:
    """The light in which the build frames were taken."""
    return next(light for light in _USUAL if light in split.walks)


def network_of(size: str) -> str:
    """The depth network of a size."""
    return f"{size}-{WIDTH}"


def parameters_of(size: str) -> int:
    return next(model.parameters for model in shipped_models() if model.name == network_of(size))


def size_labels(study: Study) -> list[str]:
    """The sizes below a picture, each with what it has."""
    return [f"{size}\n{parameters_of(size) / 1e6:.2f} M parameters" for size in study.sizes]


def picture_path(study: Study, folder: Path, name: str, split: Split) -> Path:
    """``NAME.png``, or ``NAME-SPLIT.png`` where there are several."""
    return folder / (f"{name}.png" if len(study.splits) == 1 else f"{name}-{split.name.replace(' ', '-')}.png")


def in_split(study: Study, split: Split) -> str:
    """The split's name for a title, empty where there is one only."""
    return "" if len(study.splits) == 1 else f", {split.name}"


def frames_of(source: str, frames: str) -> Selection:
    return select_frames(open_recording(source), frames)


def depth_task(source: Task | str, walk: Walk) -> Task:
    """Depth of a walk, with the frames that all figures show."""
    return tasks.depth(source, walk, tasks.DEPTH_STRIDE, shown_frames(walk))


def depth_of_variant(variant: str, bundle: Task, walk: Walk) -> Task:
    """Depth of a walk by a bundle's network, which is as it comes where nothing of it was tuned."""
    return depth_task(bundle.settings["network"] if variant in ("unadapted", "map") else bundle, walk)


@cache
def shown_frames(walk: Walk) -> tuple[int, ...]:
    """Positions in the walk; of frames that are judged too, with sensor depth.

    Raises:
        DataError: no frame that is judged has depth.
    """
    recording = frames_of(walk.source, walk.frames)
    judged = range(0, len(recording), tasks.DEPTH_STRIDE)

    def nearest(wanted: int) -> int:
        for place in sorted(judged, key=lambda place: abs(place - wanted)):
            if np.mean(recording.depth(place) > 0.0) >= _WITH_DEPTH:
                return place
        raise DataError(recording.name, "has no depth in the frames to be shown", "give one whose frames have depth")

    whole = len(recording) // tasks.DEPTH_STRIDE
    return tuple(nearest(tasks.DEPTH_STRIDE * int(share * whole)) for share in _SHOWN)


def mean_depth(result: Result, split: Split, walk: Walk, name: str) -> float:
    """Mean of ``absrel``, ``delta1`` or ``ssim`` over judged frames that built nothing; NaN where there are none."""
    per_frame = result.figures["per_frame"]
    unseen = unseen_frames(split, walk)
    values = [value for index, value in zip(per_frame["index"], per_frame[name], strict=True) if unseen[index]]
    defined = [value for value in values if value is not None]
    return float(np.mean(defined)) if defined else float("nan")


def frame_depth(result: Result, index: int) -> dict[str, float | None]:
    """``absrel``, ``delta1`` and ``ssim`` of one judged frame."""
    per_frame = result.figures["per_frame"]
    place = per_frame["index"].index(index)
    return {name: per_frame[name][place] for name in ("absrel", "delta1", "ssim")}


def unseen_frames(split: Split, walk: Walk) -> NDArray[np.bool_]:
    """(N,) which frames of a walk built nothing."""
    return _unseen(split.source, split.frames, walk)


@cache
def _unseen(source: str, built: str, walk: Walk) -> NDArray[np.bool_]:
    walked = frames_of(walk.source, walk.frames)
    if walk.source != source:
        return np.ones(len(walked), dtype=np.bool_)
    return ~np.isin(walked.positions, frames_of(source, built).positions)


def way(result: Result) -> dict[str, Any]:
    """The arrays of :data:`monoloc_lab.experiments.tasks.WAY`."""
    with np.load(result.folder / WAY_FILE) as arrays:
        return dict(arrays)


def depth_arrays(result: Result) -> dict[str, Any]:
    """The arrays of :func:`monoloc_lab.experiments.tasks.depth`."""
    with np.load(result.folder / "depth.npz") as arrays:
        return dict(arrays)


def room_map(result: Result) -> tuple[FloatArray, FloatArray]:
    """Means and covariances of a bundle's map as it was fitted."""
    from monoloc.bundle import read_bundle

    original = read_bundle(result.folder / BUNDLE).original
    return original.means, original.covariances


def nearest_build_m(split: Split, walk: Walk) -> float:
    """Median distance of a walk's unseen cameras to the nearest build frame's, metres."""
    built, walked = frames_of(split.source, split.frames).poses, frames_of(walk.source, walk.frames).poses
    assert built is not None and walked is not None  # a study's recordings have poses
    from_m = walked[unseen_frames(split, walk), :3, 3]
    distances = np.linalg.norm(from_m[:, None] - built[None, :, :3, 3], axis=-1)
    return float(np.median(distances.min(axis=1)))


def seeds_of(study: Study) -> range:
    return range(study.seeds)


def joined(names: Sequence[str]) -> str:
    """``a, b and c``."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
