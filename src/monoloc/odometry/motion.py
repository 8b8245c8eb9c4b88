"""How the camera moved between two frames, whatever measured it.

A motion comes from images (:mod:`monoloc.odometry.visual`), from a gyroscope (:mod:`monoloc.odometry.gyroscope`), or
from the attitude or the poses of another system (:mod:`monoloc.odometry.attitude`, :mod:`monoloc.odometry.external`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, is_rigid, made_rigid, make_pose

Translation = Literal["scaled", "metric", "unknown"]


@dataclass(frozen=True)
class Motion:
    """Motion of the camera between two frames, and the corners that were tracked, if any.

    Attributes:
        T_previous_current: (4, 4).
        inliers: number of tracks that agree with the motion; 0 where it is not known.
        points: (N, 3) corners in the current camera's frame, with depth refined by parallax, in the unit of the depth
            source. Without corners, scale and tilt of the depth are not corrected.
        log_depth_sd: (N,) standard deviation of the logarithm of the corners' depth.
        translation: ``scaled``, in the unit of the depth source: every particle multiplies it by its own depth scale;
            ``metric``; or ``unknown``, and zero: only the rotation is measured.
        translation_sd_m, rotation_sd_rad: standard deviation per axis; None as the settings state it for visual
            odometry, or for an unknown velocity where the translation is unknown.
        view_covariance: which the motion adds to that of the pose, by how the view determines it: of a twist in the
            current camera's frame, (6, 6); None where that is not known.
        is_contradicted: whether two sensors measured motions that their errors exclude of one camera
            (:mod:`monoloc.motion_choice`).
    """

    T_previous_current: FloatArray
    inliers: int = 0
    points: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    log_depth_sd: FloatArray = field(default_factory=lambda: np.zeros(0))
    translation: Translation = "scaled"
    translation_sd_m: float | None = None
    rotation_sd_rad: float | None = None
    view_covariance: FloatArray | None = None
    is_contradicted: bool = False

    @classmethod
    def metric(cls, T_previous_current: ArrayLike, translation_sd_m: float, rotation_sd_rad: float) -> Motion:
        """A motion in metres, (4, 4), with its standard deviations per axis.

        Raises:
            ValueError: it is not rigid, or a standard deviation is not positive and finite.
        """
        T = np.asarray(T_previous_current, dtype=np.float64)
        if T.shape != (4, 4) or not bool(is_rigid(T)):
            raise ValueError("the motion must be a rigid pose, (4, 4)")
        if not (0.0 < translation_sd_m < np.inf and 0.0 < rotation_sd_rad < np.inf):
            raise ValueError(
                f"standard deviations must be positive and finite, got {translation_sd_m}, {rotation_sd_rad}"
            )
        T = made_rigid(T)
        return cls(T, translation="metric", translation_sd_m=translation_sd_m, rotation_sd_rad=rotation_sd_rad)

    @classmethod
    def rotation(cls, R_previous_current: ArrayLike, rotation_sd_rad: float) -> Motion:
        """A motion of which only the rotation (3, 3) is known, with its standard deviation per axis.

        Raises:
            ValueError: as :meth:`metric`.
        """
        R = np.asarray(R_previous_current, dtype=np.float64)
        if R.shape != (3, 3) or not bool(is_rigid(T := make_pose(R, np.zeros(3)))):
            raise ValueError("the rotation must be a rotation matrix, (3, 3)")
        if not 0.0 < rotation_sd_rad < np.inf:
            raise ValueError(f"rotation_sd_rad must be positive and finite, got {rotation_sd_rad}")
        return cls(made_rigid(T), translation="unknown", rotation_sd_rad=rotation_sd_rad)

    def in_metres(self, log_scale: float) -> FloatArray:
        """``T_previous_current`` (4, 4) in metres; of a motion whose translation is unknown, the rotation alone.

        Args:
            log_scale: logarithm of the true over the predicted depth, for a translation in the unit of the latter.
        """
        T = self.T_previous_current.copy()
        if self.translation == "scaled":
            T[:3, 3] *= np.exp(log_scale)
        return T


def tracks_translation(motion: Motion | None) -> bool:
    """Whether there is a motion, and its translation is known."""
    return motion is not None and motion.translation != "unknown"


def chained(motions: Sequence[Motion | None]) -> Motion | None:
    """One motion after another, of a sensor with stated noise, as one; None if one of them or all are missing."""
    known = [motion for motion in motions if motion is not None]
    if not known or len(known) < len(motions):
        return None
    whole = known[0]
    for motion in known[1:]:
        T = whole.T_previous_current @ motion.T_previous_current
        rotation_sd_rad = float(np.hypot(whole.rotation_sd_rad or 0.0, motion.rotation_sd_rad or 0.0))
        if tracks_translation(whole) and tracks_translation(motion):
            translation_sd_m = float(np.hypot(whole.translation_sd_m or 0.0, motion.translation_sd_m or 0.0))
            whole = Motion.metric(T, translation_sd_m, rotation_sd_rad)
        else:
            whole = Motion.rotation(T[:3, :3], rotation_sd_rad)
    return whole


class Odometry(Protocol):
    """Interface of odometry by images, such as :class:`monoloc.odometry.visual.VisualOdometry`."""

    def step(
        self,
        color: NDArray[np.uint8],
        depth_m: NDArray[np.float32],
        depth_camera: Camera,
        R_previous_current: FloatArray | None = None,
    ) -> Motion | None:
        """Motion since the previous frame; None at the first frame, and where it is unknown.

        Called once for every frame, in order.

        Args:
            color: (H, W, 3) uint8 RGB.
            depth_m: (h, w) metres, 0 where unknown.
            depth_camera: its intrinsics.
            R_previous_current: the camera's rotation since the previous frame as another sensor measured it, (3, 3),
                to know where to look for corners; None if none did.

        Returns:
            The motion, its translation in the unit of ``depth_m`` unless it says otherwise.
        """
        ...


@runtime_checkable
class FollowingOdometry(Protocol):
    """An :class:`Odometry` that can begin a frame while its depth is still being predicted."""

    def follow(
        self,
        color: NDArray[np.uint8],
        R_previous_current: FloatArray | None = None,
        elapsed_s: float | None = None,
    ) -> None:
        """As much of :meth:`Odometry.step` as needs no depth; called before it, or not.

        Args:
            color, R_previous_current: as :meth:`Odometry.step`.
            elapsed_s: since the image of the previous step; None where that is not known.
        """
        ...


class MotionSource(Protocol):
    """A sensor beside the camera that measures how the camera moves."""

    def between(self, start_s: float, end_s: float) -> Motion | None:
        """The camera's motion from one time of capture to another; None where the sensor does not tell it."""
        ...


def motions_between(times_s: FloatArray, sources: Sequence[MotionSource]) -> list[Motion | None]:
    """Motions since the previous of N frames, each of the first source that tells it: N, the first None.

    Args:
        times_s: of capture, (N,).
    """
    motions: list[Motion | None] = [None] * min(1, len(times_s))
    for start_s, end_s in pairwise(times_s.tolist()):
        measured = (source.between(start_s, end_s) for source in sources)
        motions.append(next((motion for motion in measured if motion is not None), None))
    return motions
