"""Where a flight starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import MAX_DISTANCE_M, FloatArray, is_rigid, make_pose, so3_exp
from monoloc.localizer_config import LocalizerConfig
from monoloc.particle_filter.particles import Particles, scatter

_MOST_ERROR = 1e3  # metres or radians
START_ERROR_M, START_ERROR_DEG = 0.10, 3.0
"""Default error of a start. Evaluation runs start this far from the truth, in a random direction."""


@dataclass(frozen=True)
class Start:
    """The first pose of a flight and its uncertainty.

    Attributes:
        pose: estimated ``T_world_camera`` of the first frame, (4, 4).
        error_m, error_rad: root mean square of its distance and angle from the true pose.

    Raises:
        ValueError: the pose is not rigid or more than 100 km from the origin, or an error is negative or over 1000.
    """

    pose: FloatArray
    error_m: float = START_ERROR_M
    error_rad: float = np.deg2rad(START_ERROR_DEG)

    def __post_init__(self) -> None:
        shape = np.shape(self.pose)
        is_real = np.asarray(self.pose).dtype.kind in "fiu"
        if shape != (4, 4) or not (is_real and bool(is_rigid(self.pose))):
            got = "one that is not rigid or not finite" if shape == (4, 4) else f"shape {shape}"
            raise ValueError(f"pose must be a rigid (4, 4) T_world_camera, got {got}")
        if np.abs(np.asarray(self.pose)[:3, 3]).max() > MAX_DISTANCE_M:
            raise ValueError(f"pose must be within {MAX_DISTANCE_M:g} m of the origin; give metres")
        if not (0.0 <= self.error_m <= _MOST_ERROR and 0.0 <= self.error_rad <= _MOST_ERROR):
            errors = f"{self.error_m} and {self.error_rad}"
            raise ValueError(f"error_m and error_rad must be from 0 to {_MOST_ERROR:g}, got {errors}")

    @classmethod
    def disturbed(
        cls,
        pose: FloatArray,
        rng: np.random.Generator,
        error_m: float = START_ERROR_M,
        error_rad: float = np.deg2rad(START_ERROR_DEG),
    ) -> Start:
        """A start at exactly these distances from a true pose, in a random direction."""
        offset, turn = rng.standard_normal((2, 3))
        offset *= error_m / np.linalg.norm(offset)
        turn *= error_rad / np.linalg.norm(turn)
        return cls(np.asarray(pose @ make_pose(so3_exp(turn), offset)), error_m, error_rad)

    def particles(self, config: LocalizerConfig, rng: np.random.Generator) -> Particles:
        """Particles with this uncertainty."""
        sd_m, sd_rad = self.error_m / np.sqrt(3.0), self.error_rad / np.sqrt(3.0)  # per axis
        return scatter(self.pose, config.particles, sd_m, sd_rad, config.log_scale_sd, rng)


def checked_start(start: object) -> Start | None:
    """Return the given start or None, after a check of its type.

    Raises:
        TypeError: it is something else, such as a pose.
    """
    if start is None or isinstance(start, Start):
        return start
    given = f"an array of shape {start.shape}" if isinstance(start, np.ndarray) else type(start).__name__
    raise TypeError(f"start must be a monoloc.Start or None, got {given}; write monoloc.Start(T_world_camera)")
