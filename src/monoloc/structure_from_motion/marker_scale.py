"""Scale by an ArUco marker or AprilTag of known size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.relocalization.marker import DEFAULT_DICTIONARY, Dictionary, MarkerDetector
from monoloc.structure_from_motion.metric_scale import MetricScale, from_length
from monoloc.structure_from_motion.sparse_model import SparseModel
from monoloc.structure_from_motion.triangulation import distance_sd, triangulate

_LOOKED_AT, _MARKER_FRAMES = 600, 20  # frames of a recording; of these, keyframes for their view of the marker
_CORNER_SD_PX = 0.5
_SIZE_SD = 0.005  # relative, of a size measured with a ruler
_SQUARE = 0.15  # relative difference of sides, above which it is no square


@dataclass(frozen=True)
class MarkerScale:
    """A marker.

    Attributes:
        number: in the dictionary.
        size_m: side of the black square.
        dictionary: that it is printed from.
    """

    number: int
    size_m: float
    dictionary: Dictionary = DEFAULT_DICTIONARY

    def frames(self, recording: Recording) -> list[int]:
        """Some of the frames that show the marker.

        Raises:
            DataError: fewer than two do.
        """
        detect = MarkerDetector(self.dictionary)
        looked_at = evenly_spaced(len(recording), _LOOKED_AT).tolist()
        seen = [index for index in looked_at if self._corners(detect, recording, index) is not None]
        if len(seen) < 2:
            problem = f"shows marker {self.number} of {self.dictionary} in {len(seen)} of {len(looked_at)} frames"
            raise DataError(recording.name, problem, "film it in at least two, or correct --scale")
        return [seen[position] for position in evenly_spaced(len(seen), _MARKER_FRAMES)]

    def measure(self, recording: Recording, model: SparseModel, depths: Sequence[NDArray[np.float32]]) -> MetricScale:
        """See :meth:`monoloc.structure_from_motion.metric_scale.ScaleSource.measure`."""
        poses, corners = self._seen(recording, model)
        found = [triangulate(model.camera, poses, corners[:, corner]) for corner in range(4) if len(poses) > 1]
        placed = [each for each in found if each is not None]
        if len(placed) < 4:
            problem = f"shows marker {self.number} from one side only, in {len(poses)} of the frames that were placed"
            raise DataError(recording.name, problem, "film it from more sides")
        sides = np.array([distance_sd(placed[corner], placed[(corner + 1) % 4]) for corner in range(4)])
        length = float(sides[:, 0].mean())
        if np.ptp(sides[:, 0]) > _SQUARE * length:
            problem = f"shows marker {self.number} with sides that differ by {np.ptp(sides[:, 0]) / length:.0%}"
            raise DataError(recording.name, problem, "film it from nearer and from more sides, flat and at rest")
        side_sd = float(np.sqrt(np.mean(sides[:, 1] ** 2)))  # of one side, by independent errors of a pixel
        shift_px, corner_px = _residuals_px(model, poses, np.array([point for point, _ in placed]), corners)
        # Errors of their own average over four sides. What shifts all corners of a frame moves them nearer or farther
        # together.
        own = max(max(_CORNER_SD_PX, corner_px) * side_sd, float(np.std(sides[:, 0]))) / 2.0
        length_sd = float(np.hypot(own, np.sqrt(2.0) * shift_px * side_sd))
        how = f"marker {self.number} in {len(poses)} frames"
        return from_length(length, length_sd, self.size_m, _SIZE_SD * self.size_m, how, recording.name)

    def _seen(self, recording: Recording, model: SparseModel) -> tuple[FloatArray, FloatArray]:
        """Poses of the frames that show the marker, (M, 4, 4), and its corners there, (M, 4, 2)."""
        detect = MarkerDetector(self.dictionary)
        seen = []
        for frame, index in enumerate(model.frames.tolist()):
            corners = self._corners(detect, recording, index)
            if corners is not None:
                seen.append((frame, corners))
        poses = model.poses[[frame for frame, _ in seen]]
        return poses, np.array([corners for _, corners in seen]).reshape(-1, 4, 2)

    def _corners(self, detect: MarkerDetector, recording: Recording, index: int) -> FloatArray | None:
        """The marker's corners in a frame, (4, 2) px; None where it is not seen, or more than once."""
        found = [corners for number, corners in detect(recording.color(index)) if number == self.number]
        return found[0] if len(found) == 1 else None


def _residuals_px(
    model: SparseModel, poses: FloatArray, points: FloatArray, corners: FloatArray
) -> tuple[float, float]:
    """Standard deviations of what shifts a frame's four corners together, and of each corner beyond that.

    Args:
        model: that has the camera.
        poses: of the frames, (M, 4, 4).
        points: where the corners are, (4, 3).
        corners: where they are seen, (M, 4, 2).
    """
    residuals = model.camera.project(transform(invert(poses), points)) - corners
    shifts = residuals.mean(axis=1, keepdims=True)
    frames = len(poses)  # the points take 3 of the shifts' 2 M degrees of freedom, and 9 of the other 6 M
    common = np.sum(shifts**2) / (2 * frames - 3)
    return float(np.sqrt(common)), float(np.sqrt(np.sum((residuals - shifts) ** 2) / (6 * frames - 9)))
