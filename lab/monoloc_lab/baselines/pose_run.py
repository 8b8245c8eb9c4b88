"""A recording localised frame by frame by any method, and its errors."""

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
# An image (H, W, 3) uint8 RGB and the seconds since the previous one -> T_world_camera (4, 4), None without a pose.
LocalizeFrame = Callable[[Image, float], FloatArray | None]
_WITHIN = ("within_5cm_5deg", "within_10cm_10deg")


@dataclass(frozen=True)
class PoseRun:
    """Poses of N frames by a method.

    Attributes:
        poses: ``T_world_camera``, (N, 4, 4); NaN for frames without a pose.
        step_ms: (N,) time of each frame, without reading it.
    """

    poses: FloatArray
    step_ms: FloatArray

    @property
    def failed(self) -> NDArray[np.bool_]:
        """(N,) frames without a pose."""
        return np.asarray(np.isnan(self.poses).any(axis=(1, 2)))

    def metrics(self, truth: FloatArray, chosen: NDArray[np.bool_]) -> dict[str, object]:
        """Figures of the chosen frames, ready for JSON, with the names of ``monoloc localize``.

        Errors are over the frames with a pose, and None if there is none. ``within_...`` are shares of all frames;
        failed frames count as outside.

        Args:
            truth: ``T_world_camera``, (N, 4, 4).
            chosen: (N,), at least one frame.
        """
        localized = chosen & ~self.failed
        share = float(localized.sum() / chosen.sum())
        figures: dict[str, object] = {
            "frames": int(chosen.sum()),
            "failed_frames": int((chosen & self.failed).sum()),
            "step_ms_median": float(np.median(self.step_ms[chosen])),
        }
        if not localized.any():
            return figures | {field.name: None for field in fields(TrajectoryMetrics)} | dict.fromkeys(_WITHIN, 0.0)
        errors = asdict(summarise(self.poses[localized], truth[localized]))
        return figures | errors | {name: share * errors[name] for name in _WITHIN}


def localize_all(
    recording: Recording, method: LocalizeFrame, progress: Progress, relight: Relight | None = None
) -> PoseRun:
    """Localise every frame of a recording, in order of time.

    Args:
        relight: simulates another light on the images, None leaves them; its time does not count.

    Raises:
        DataError: a frame cannot be read.
    """
    poses, step_ms = [], []
    elapsed_s = np.diff(recording.timestamps_s, prepend=recording.timestamps_s[:1])
    with progress.task("localize", len(recording)) as show:
        for index in range(len(recording)):
            color = recording.color(index)
            if relight is not None:
                color = relight(color)
            began = time.perf_counter()
            pose = method(color, float(elapsed_s[index]))
            step_ms.append(1e3 * (time.perf_counter() - began))
            poses.append(np.full((4, 4), np.nan) if pose is None else pose)
            show(index + 1)
    return PoseRun(np.stack(poses), np.array(step_ms))
