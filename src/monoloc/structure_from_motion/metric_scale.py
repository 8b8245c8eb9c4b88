"""The scale of a model: how many metres its unit is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.io.recording import Recording
from monoloc.robust_statistics import robust_sd
from monoloc.structure_from_motion.sparse_model import SparseModel

_MOST_SD = 0.5  # of a scale; above it, nothing was measured


@dataclass(frozen=True)
class MetricScale:
    """Scale of a model.

    Attributes:
        metres: of one unit.
        sd: relative standard deviation.
        how: what it was measured by, for people.
        is_bent: (F,) frames of the model whose own scale is another, so that their poses are wrong; None where what
            measured the scale does not tell.
    """

    metres: float
    sd: float
    how: str
    is_bent: NDArray[np.bool_] | None = None


class ScaleSource(Protocol):
    """What the scale is measured by."""

    def frames(self, recording: Recording) -> list[int]:
        """Frames that must be among the keyframes.

        Raises:
            DataError, SettingError: the recording lacks what the scale is to be measured by.
        """
        ...

    def measure(self, recording: Recording, model: SparseModel, depths: Sequence[NDArray[np.float32]]) -> MetricScale:
        """The scale of a model of the recording.

        Args:
            recording: that the model is of.
            model: in its own unit.
            depths: of its frames, (h, w) of :func:`monoloc.structure_from_motion.dense_depth.small_camera`, in the
                same unit, 0 where unknown.

        Raises:
            DataError: the scale cannot be measured.
        """
        ...


def from_log_ratios(log_metres: Sequence[float], common_sd: float, how: str, name: str) -> MetricScale:
    """The scale from what single frames say.

    Args:
        log_metres: logarithm of the metres of a unit, of each frame.
        common_sd: standard deviation of an error that all frames share.
        how: what measured them.
        name: of the recording, for the error message.

    Raises:
        DataError: no frame says anything.
    """
    if not log_metres:
        problem = f"gives no scale: {how} covers nothing that was reconstructed"
        raise DataError(name, problem, "give another --scale, such as marker:ID:SIZE_M")
    values = np.array(log_metres)
    sd = float(np.hypot(common_sd, robust_sd(values) / np.sqrt(len(values))))
    return MetricScale(float(np.exp(np.median(values))), sd, how)


def from_length(length: float, length_sd: float, metres: float, metres_sd: float, how: str, name: str) -> MetricScale:
    """The scale from a length in the model's unit that is known in metres.

    Raises:
        DataError: the length is not determined.
    """
    sd = float(np.hypot(length_sd / length, metres_sd / metres))
    if not sd < _MOST_SD:
        problem = f"does not determine {how} (± {sd:.0%})"
        raise DataError(name, problem, "film it from more sides, and from nearer")
    return MetricScale(metres / length, sd, how)
