"""What of a room a recording's motion shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray, invert, rotation_angle

_HOVERING_M = 0.3  # extent of positions that show no parallax
_MOST_EXTENT_M = 100.0  # of a walk indoors; two metres in centimetres are more
_TURNING_RAD = np.deg2rad(60.0)


@dataclass(frozen=True)
class MotionCoverage:
    """Motion of a camera.

    Attributes:
        path_m: length of the path.
        extent_m: largest side of the box around the positions.
        turned_rad: largest angle between any view and the first.
    """

    path_m: float
    extent_m: float
    turned_rad: float

    @property
    def problem(self) -> str | None:
        """Why the motion shows too little, or cannot be right, and what to do; None if nothing is wrong."""
        if self.extent_m > _MOST_EXTENT_M:
            problem = f"positions extend over {self.extent_m:.0f} m"
            return f"{problem}; if their unit is another one, give --fix-poses millimetres or centimetres"
        if self.extent_m >= _HOVERING_M:
            return None
        on_the_spot = self.turned_rad > _TURNING_RAD
        problem = "the camera only turns on the spot" if on_the_spot else "the camera hovers in one place"
        return f"{problem}; walk through the room"


def cover(poses: FloatArray) -> MotionCoverage:
    """Coverage of ``T_world_camera``, (N, 4, 4)."""
    positions = poses[:, :3, 3]
    angles = rotation_angle((invert(poses[:1]) @ poses)[:, :3, :3])
    return MotionCoverage(
        path_m=float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()),
        extent_m=float(np.ptp(positions, axis=0).max()),
        turned_rad=float(angles.max()),
    )
