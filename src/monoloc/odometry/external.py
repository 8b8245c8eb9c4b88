"""The camera's motion by the poses of another system: wheels, optical flow, a tracking camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import is_rigid, rotation_angle
from monoloc.odometry.motion import Motion
from monoloc.odometry.pose_history import PoseHistory

_MOST_SPEED_M_S, _MOST_RATE_RAD_S = 8.0, 6.0  # no vehicle in a room is faster; one that begins anew jumps


@dataclass(frozen=True)
class ExternalNoise:
    """Standard deviations per axis of a motion between two frames: constant, and share of the distance or turn.

    Raises:
        ValueError: a constant is not positive and finite, or a share is negative or not finite.
    """

    translation_sd_m: float = 0.002
    translation_sd_ratio: float = 0.05
    rotation_sd_rad: float = 0.0015
    rotation_sd_ratio: float = 0.03

    def __post_init__(self) -> None:
        constants, shares = (
            (self.translation_sd_m, self.rotation_sd_rad),
            (self.translation_sd_ratio, self.rotation_sd_ratio),
        )
        if not all(0.0 < value < np.inf for value in constants) or not all(0.0 <= value < np.inf for value in shares):
            raise ValueError(f"constants must be positive, shares not negative, and all finite, got {self}")


class ExternalOdometry:
    """Interpolates poses between samples; only their differences count, so their world may be any that stays.

    Args:
        T_body_camera: pose of the camera on the body whose poses are given, (4, 4).
        delay_s: of the stamps: stamp minus time of the measurement.
        noise: of the motions.
        max_gap_s: between samples; a longer one is a dropout.
        memory_s: for which samples are kept at least.

    Raises:
        ValueError: the mounting is not rigid, or the delay is not finite.
    """

    def __init__(
        self,
        T_body_camera: ArrayLike = np.eye(4),
        delay_s: float = 0.0,
        noise: ExternalNoise = ExternalNoise(),
        max_gap_s: float = 0.25,
        memory_s: float = 60.0,
    ) -> None:
        self._T_body_camera = np.asarray(T_body_camera, dtype=np.float64)
        if self._T_body_camera.shape != (4, 4) or not is_rigid(self._T_body_camera):
            raise ValueError("T_body_camera must be a rigid pose, (4, 4)")
        if not np.isfinite(delay_s):
            raise ValueError(f"delay_s must be finite, got {delay_s}")
        self._delay_s, self._noise = delay_s, noise
        self._history = PoseHistory(max_gap_s, memory_s, _MOST_SPEED_M_S, _MOST_RATE_RAD_S)

    def add(self, stamp_s: float, T_reference_body: ArrayLike) -> None:
        """Take a sample, stamped later than all before.

        Args:
            stamp_s: by the clock of the frames, ``delay_s`` after the measurement.
            T_reference_body: pose of the body, (4, 4), metres.

        Raises:
            ValueError: the stamp is not after the last one, or the pose is not rigid; nothing has changed then.
        """
        self._history.add(stamp_s - self._delay_s, np.asarray(T_reference_body) @ self._T_body_camera)

    def between(self, start_s: float, end_s: float) -> Motion | None:
        """The camera's motion from one time of capture to another; None across dropouts."""
        T = self._history.between(start_s, end_s)
        if T is None:
            return None
        noise, distance_m, angle_rad = self._noise, np.linalg.norm(T[:3, 3]), rotation_angle(T[:3, :3])
        return Motion.metric(
            T,
            float(np.hypot(noise.translation_sd_m, noise.translation_sd_ratio * distance_m)),
            float(np.hypot(noise.rotation_sd_rad, noise.rotation_sd_ratio * angle_rad)),
        )
