"""Scale by a known distance between two points that a person has marked in some frames.

::

    metres = 2.40
    sd_m = 0.005                                        # optional: of the distance
    a = [["000012", 310, 77], ["000090", 402, 80]]      # frame, x and y in pixels; at least two frames
    b = [["000012", 120, 210], ["000061", 98, 233]]

Frames are named as in the recording whose scale is wanted; files of a reconstruction are numbered otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from monoloc.config import describe, read_toml
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.file_access import require_file
from monoloc.io.recording import Recording
from monoloc.structure_from_motion.metric_scale import MetricScale, from_length
from monoloc.structure_from_motion.sparse_model import SparseModel
from monoloc.structure_from_motion.triangulation import distance_sd, triangulate

_CLICK_SD_PX = 1.5
_MOST_OFF = 0.02  # of a mark from the point of all marks, in focal lengths: a click, and the errors of poses and lens
_MOST_AWAY_M = 50.0  # of a marked point from the nearest camera, in a room
_FIX = "write metres, a and b, each of the two as [[frame, x, y], [frame, x, y]]"

_Pixel = tuple[str, float, float]


class _Distance(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    metres: float = Field(gt=0.0, le=1000.0)
    sd_m: float = Field(0.005, ge=0.0)
    a: list[_Pixel] = Field(min_length=2)
    b: list[_Pixel] = Field(min_length=2)


@dataclass(frozen=True)
class DistanceScale:
    """A distance between two points.

    Attributes:
        path: TOML file that says where they are.
    """

    path: Path

    def frames(self, recording: Recording) -> list[int]:
        """See :meth:`monoloc.structure_from_motion.metric_scale.ScaleSource.frames`."""
        distance = self._distance()
        return sorted({self._index(recording, name) for name, _, _ in (*distance.a, *distance.b)})

    def measure(self, recording: Recording, model: SparseModel, depths: Sequence[NDArray[np.float32]]) -> MetricScale:
        """See :meth:`monoloc.structure_from_motion.metric_scale.ScaleSource.measure`."""
        distance = self._distance()
        a, b = (self._placed(recording, model, *end) for end in (("a", distance.a), ("b", distance.b)))
        length, length_sd = distance_sd(a, b)
        how = f"a distance of {distance.metres:g} m"
        found = from_length(length, _CLICK_SD_PX * length_sd, distance.metres, distance.sd_m, how, str(self.path))
        away_m = found.metres * float(np.linalg.norm(model.poses[:, :3, 3] - a[0], axis=1).min())
        if away_m > _MOST_AWAY_M:
            problem = f"metres: is {distance.metres:g}, which puts a {away_m:.0f} m from the nearest camera"
            raise DataError(self.path, problem, "give it in metres, not in centimetres or millimetres")
        return found

    def _placed(
        self, recording: Recording, model: SparseModel, end: str, pixels: Sequence[_Pixel]
    ) -> tuple[FloatArray, FloatArray]:
        indices = np.array([self._index(recording, name) for name, _, _ in pixels])
        marks = np.array([pixel[1:] for pixel in pixels])
        placed = np.isin(indices, model.frames)
        count = len(np.unique(indices[placed]))
        if count < 2:
            problem = f"{end} is marked in {count} of the frames that could be placed, and two are needed"
            raise DataError(self.path, problem, "mark it in more frames")
        poses = model.poses[np.searchsorted(model.frames, indices[placed])]
        found = triangulate(model.camera, poses, marks[placed])
        if found is None:
            problem = f"{end} is seen from one side only, or one of its marks is wrong"
            raise DataError(self.path, problem, "mark it in frames further apart, or correct the mark")
        off = model.camera.project(transform(invert(poses), found[0][None])[:, 0]) - marks[placed]
        off_px = np.linalg.norm(off, axis=1)
        if off_px.max() > _MOST_OFF * model.camera.focal_px:
            name = recording.frame_names[indices[placed][off_px.argmax()]]
            problem = f"the marks of {end} do not show one point: that in {name} is {off_px.max():.0f} px off"
            raise DataError(self.path, problem, "correct it, or another mark of the same point")
        return found

    def _index(self, recording: Recording, name: str) -> int:
        if name not in recording.frame_names:
            first, last = recording.frame_names[0], recording.frame_names[-1]
            raise DataError(self.path, f"{name!r} is no frame of {recording.name}", f"they are {first} to {last}")
        return recording.frame_names.index(name)

    def _distance(self) -> _Distance:
        require_file(self.path, _FIX)
        try:
            return _Distance.model_validate(read_toml(self.path))
        except ValidationError as error:
            raise DataError(self.path, describe(error), _FIX) from error
