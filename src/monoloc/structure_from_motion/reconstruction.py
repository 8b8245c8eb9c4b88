"""A recording with poses and depth, from images without poses.

keyframes -> sparse model -> dense depth -> scale -> upright world
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.extras import require_structure_from_motion
from monoloc.geometry import FloatArray
from monoloc.io.image_resampling import resize_nearest
from monoloc.io.recording import Recording
from monoloc.progress import NoProgress, Progress
from monoloc.structure_from_motion.dense_depth import dense_depth, small_camera
from monoloc.structure_from_motion.keyframe_choice import choose_keyframes
from monoloc.structure_from_motion.levelling import levelled
from monoloc.structure_from_motion.mapping import LEAST_FRAMES, LEAST_TRACK, map_keyframes
from monoloc.structure_from_motion.metric_scale import MetricScale, ScaleSource
from monoloc.structure_from_motion.sparse_model import SparseModel

_DOWN = np.array([0.0, 0.0, -1.0])  # of a levelled model
_MOST_BENT = 0.4  # share of the keyframes


class ReconstructedRecording:
    """The placed frames of a recording, with the poses and the depth that were found.

    Attributes:
        scale_sd: relative standard deviation of the scale of poses and depth.
        down_world: see :func:`monoloc.io.recording.recorded_down`; None where it is from the camera's axes alone.
    """

    def __init__(
        self,
        source: Recording,
        model: SparseModel,
        depths: Sequence[NDArray[np.float32]],
        scale_sd: float,
        is_upright: bool,
        notes: list[str],
    ) -> None:
        frames = model.frames
        self._source, self._frames, self._depths = source, frames, depths
        self.name, self.camera, self.has_depth = source.name, model.camera, True
        self.poses: FloatArray | None = model.poses
        self.frame_names = [source.frame_names[index] for index in frames]
        self.timestamps_s = source.timestamps_s[frames]
        self.scale_sd, self.notes = scale_sd, notes
        self.down_world: FloatArray | None = _DOWN if is_upright else None

    def __len__(self) -> int:
        return len(self._frames)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        return self._source.color(int(self._frames[index]))

    def depth(self, index: int) -> NDArray[np.float32]:
        """See :meth:`monoloc.io.recording.Recording.depth`."""
        return resize_nearest(self._depths[index], self.camera.width, self.camera.height)


@dataclass(frozen=True)
class Reconstruction:
    """What was found.

    Attributes:
        recording: to build from.
        model: poses and sparse points, metres, z up.
        depths: of its frames, (h, w) metres of ``depth_camera``, 0 where unknown.
        scale: of the model.
        is_upright: whether surfaces determined the vertical, and not only how the camera was held.
    """

    recording: ReconstructedRecording
    model: SparseModel
    depths: list[NDArray[np.float32]]
    scale: MetricScale
    is_upright: bool

    @property
    def depth_camera(self) -> Camera:
        """Intrinsics of ``depths``."""
        return small_camera(self.model.camera)


def reconstruct(
    recording: Recording, scale: ScaleSource, refine_camera: bool, seed: int = 0, progress: Progress = NoProgress()
) -> Reconstruction:
    """Place the frames of a recording by its colour images, and find their depth.

    Poses and depth that the recording may have are not used, but for what measures the scale.

    Args:
        scale: what the scale is measured by.
        refine_camera: whether the recording's camera is a guess, whose focal length and radial distortion are found.
        seed: the same seed gives the same result on the same machine.

    Raises:
        MissingExtraError: pycolmap is not installed.
        SettingError: the scale cannot be measured by what was chosen.
        DataError: as :func:`monoloc.structure_from_motion.mapping.map_keyframes`, or no scale was found.
    """
    require_structure_from_motion()
    required = scale.frames(recording)  # refuses what cannot be measured before the work is done
    keyframes = choose_keyframes(recording, required, progress)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        unscaled = map_keyframes(recording, keyframes, refine_camera, seed, progress)
        depths = dense_depth(recording, unscaled, progress)
        metric = scale.measure(recording, unscaled, depths)
        if metric.is_bent is not None and metric.is_bent.any():
            _check_bent(recording.name, metric.is_bent)
            unscaled = unscaled.without(metric.is_bent, LEAST_TRACK)
            depths = dense_depth(recording, unscaled, progress)  # neighbours were bent
    finally:
        cv2.setNumThreads(threads)
    depths = [depth * np.float32(metric.metres) for depth in depths]
    model, is_upright = levelled(unscaled.scaled(metric.metres), depths, np.random.default_rng(seed))
    notes = _notes(recording, model, metric, is_upright)
    found = ReconstructedRecording(recording, model, depths, metric.sd, is_upright, notes)
    return Reconstruction(found, model, depths, metric, is_upright)


def _check_bent(name: str, is_bent: NDArray[np.bool_]) -> None:
    """Refuse a model of which a large part is bent: the rest may be, too."""
    if is_bent.mean() > _MOST_BENT or np.count_nonzero(~is_bent) < LEAST_FRAMES:
        problem = f"is bent: depth contradicts {np.count_nonzero(is_bent)} of {len(is_bent)} keyframes"
        raise DataError(name, problem, "film it again: flat surfaces and screens that change mislead it")


def _notes(recording: Recording, model: SparseModel, scale: MetricScale, is_upright: bool) -> list[str]:
    notes = [
        f"poses and depth come from structure from motion, {len(model.frames)} keyframes of {len(recording)} frames",
        f"the scale comes from {scale.how}, ± {100.0 * scale.sd:.2g} %",
        "the direction of gravity comes from floor and walls, and z is up"
        if is_upright
        else "the direction of gravity is not known, since floor and walls do not show it; z is up if the camera was "
        "held without roll",
    ]
    if model.camera_sd:
        notes.append(
            f"the focal length is {model.camera.fx:.0f} ± {model.camera_sd['f']:.0f} px, found with the poses"
        )
    bent = 0 if scale.is_bent is None else int(np.count_nonzero(scale.is_bent))
    if bent:
        notes.append(f"{bent} of {model.tried} keyframes are left out: depth contradicts their poses")
    lost = model.tried - len(model.frames) - bent
    if lost:
        notes.append(f"{lost} of {model.tried} keyframes are left out: they could not be placed")
    return notes
