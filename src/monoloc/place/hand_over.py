"""When a camera goes through a door: which room its belief goes on in."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.particle_filter.estimate import Estimate
from monoloc.place.place_manifest import Door
from monoloc.start import Start

# A neighbour takes over where it explains this many frames in a row by so many times the landmarks of the current
# room. The same holds for the way back, so that the rooms do not alternate.
_FRAMES, _TIMES, _LEAST_FOUND = 3, 1.3, 20


def carried(belief: Estimate, door: Door, room: str) -> Estimate:
    """A belief in a room, in the world of the room beyond a door.

    The covariance is of the camera's twist, which is the same in both worlds; it grows by the door's error where the
    camera is.
    """
    lever_m = float(np.linalg.norm(belief.pose[:3, 3] - door.centre_in(room)))
    position_variance = door.position_sd_m**2 + (door.rotation_sd_rad * lever_m) ** 2
    growth = np.diag(np.repeat([position_variance, door.rotation_sd_rad**2], 3))
    return Estimate(door.T_beyond_here(room) @ belief.pose, belief.covariance + growth, belief.log_scale)


def start_from(belief: Estimate) -> Start:
    """A start with a belief's pose, as wide in every direction as the belief is in its widest."""
    return Start(belief.pose, _rms(belief.covariance[:3, :3]), _rms(belief.covariance[3:, 3:]))


def _rms(covariance: FloatArray) -> float:
    """Root mean square of a vector whose every axis is as wide as the widest of a covariance (3, 3)."""
    return float(np.sqrt(3.0 * np.linalg.eigvalsh(covariance)[-1]))


def near_doors(doors: list[Door], room: str, belief: Estimate, most: int) -> list[Door]:
    """The nearest of a room's doors that the camera may be on its way through, at most so many."""
    distances_m = [float(np.linalg.norm(belief.pose[:3, 3] - door.centre_in(room))) for door in doors]
    near = sorted(zip(distances_m, range(len(doors)), strict=True))
    sd_m = belief.position_sd_m
    return [doors[index] for distance_m, index in near if distance_m <= doors[index].radius_m + sd_m][:most]


class HandOver:
    """Counts for how many frames a neighbour has explained the view better than the current room."""

    def __init__(self) -> None:
        self._frames: dict[str, int] = {}

    def update(self, here: int, beyond: Mapping[str, int]) -> str | None:
        """The neighbour that takes over at this frame; None where the camera stays.

        Args:
            here: landmarks of the current room that agree on one pose near the belief.
            beyond: the same of each neighbour behind a door that is near, by name.
        """
        better = {name: found for name, found in beyond.items() if found >= max(_LEAST_FOUND, _TIMES * here)}
        self._frames = {name: self._frames.get(name, 0) + 1 for name in better}
        ready = [name for name, frames in self._frames.items() if frames >= _FRAMES]
        return max(ready, key=lambda name: better[name], default=None)
