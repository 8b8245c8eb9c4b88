"""A recording located frame by frame by any method, and what that is worth."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from monoloc.evaluation.trajectory import TrajectoryMetrics, summarise
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording, Relight
from monoloc.progress import Progress

Image = NDArray[np.uint8]
# An image (H, W, 3) uint8 RGB and the seconds since the one before -> its T_world_camera (4, 4), None if it has none.
Locate = Callable[[Image, float], FloatArray | None]
_WITHIN = ("within_5cm_5deg", "within_10cm_10deg")


@dataclass(frozen=True)
class PoseRun:
    """What a method made of N frames.

    Attributes:
        poses: ``T_world_camera``, (N, 4, 4); NaN where the method gave none.
        step_ms: (N,) time of each frame, without reading it.
    """

    poses: FloatArray
    step_ms: FloatArray

    @property
    def failed(self) -> NDArray[np.bool_]:
        """(N,) frames without a pose."""
        return np.asarray(np.isnan(self.poses).any(axis=(1, 2)))

    def metrics(self, truth: FloatArray, chosen: NDArray[np.bool_]) -> dict[str, object]:
        """Figures of the chosen frames, ready for JSON, named as those of ``monoloc localize``.

        Errors are of the frames with a pose, and None if there is none; ``within_...`` are shares of all frames, a
        failed one being outside.

        Args:
            truth: ``T_world_camera``, (N, 4, 4).
            chosen: (N,), at least one frame.
        """
        located = chosen & ~self.failed
        share = float(located.sum() / chosen.sum())
        figures: dict[str, object] = {
            "frames": int(chosen.sum()),
            "failed_frames": int((chosen & self.failed).sum()),
            "step_ms_median": float(np.median(self.step_ms[chosen])),
        }
        if not located.any():
            return figures | {field.name: None for field in fields(TrajectoryMetrics)} | dict.fromkeys(_WITHIN, 0.0)
        errors = asdict(summarise(self.poses[located], truth[located]))
        return figures | errors | {name: share * errors[name] for name in _WITHIN}


def locate_all(recording: Recording, locate: Locate, progress: Progress, relight: Relight | None = None) -> PoseRun:
    """Give every frame of a recording, in order of time, to a method.

    Args:
        relight: brings the images to another light before, None leaves them; it does not count as the method's time.

    Raises:
        DataError: a frame cannot be read.
    """
    poses, step_ms = [], []
    elapsed_s = np.diff(recording.timestamps_s, prepend=recording.timestamps_s[:1])
    with progress.task("locate", len(recording)) as show:
        for index in range(len(recording)):
            color = recording.color(index)
            if relight is not None:
                color = relight(color)
            began = time.perf_counter()
            pose = locate(color, float(elapsed_s[index]))
            step_ms.append(1e3 * (time.perf_counter() - began))
            poses.append(np.full((4, 4), np.nan) if pose is None else pose)
            show(index + 1)
    return PoseRun(np.stack(poses), np.array(step_ms))
