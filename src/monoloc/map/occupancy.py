"""The map as voxels: where there is a surface, where the cameras that built it saw free space, what nobody saw."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray
from monoloc.io.recording import evenly_spaced
from monoloc.map.mixture import GaussianMixture
from monoloc.map.surface import mass_per_area, patches

UNKNOWN: Final = 0
FREE: Final = 1
OCCUPIED: Final = 2
"""States of a voxel."""

_SEEN_M = 4.0  # how far a build's cameras are taken to see; builds use depth up to 4.5 m
_COVERED = 0.25  # share of a covered surface's mass from which a voxel is occupied
_MOST_VOXELS, _COARSER, _MOST_VOXEL_M = 1 << 25, 1.1, 2.0
_MOST_VIEWS, _VIEW_PX = 200, (32, 24)  # of the cameras that built the map
_STEP = 0.5  # of a voxel, in which patches are covered and rays followed


@dataclass(frozen=True)
class VoxelGrid:
    """Voxels of one size, aligned with the frame's origin.

    Attributes:
        first: index of the first voxel along each axis, (3,): its corner is at ``first * voxel_m``.
        voxel_m: edge of a voxel.
        states: (X, Y, Z) uint8, :data:`UNKNOWN`, :data:`FREE` or :data:`OCCUPIED`.
    """

    first: NDArray[np.int64]
    voxel_m: float
    states: NDArray[np.uint8]

    @property
    def lower(self) -> FloatArray:
        """Lower corner of the grid, (3,) m."""
        return np.asarray(self.first * self.voxel_m, dtype=np.float64)

    def indices(self, state: int) -> NDArray[np.int64]:
        """Indices of the voxels in a state, from the frame's origin, (N, 3)."""
        return np.argwhere(self.states == state) + self.first

    def centres(self, state: int) -> FloatArray:
        """Centres of the voxels in a state, (N, 3) m."""
        return np.asarray((self.indices(state) + 0.5) * self.voxel_m)

    def volume_m3(self, state: int) -> float:
        """Volume of the voxels in a state."""
        return float(np.count_nonzero(self.states == state) * self.voxel_m**3)

    def at(self, points: FloatArray) -> NDArray[np.uint8]:
        """State at points (..., 3) m: (...,); unknown outside the grid."""
        cells = np.floor(points / self.voxel_m).astype(np.int64) - self.first
        inside = np.all((cells >= 0) & (cells < self.states.shape), axis=-1)
        x, y, z = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        return np.where(inside, self.states[x, y, z], np.uint8(UNKNOWN))

    def distances_m(self, origin: FloatArray, directions: FloatArray, most_m: float) -> FloatArray:
        """Distance from a point (3,) to the first occupied voxel along unit vectors (N, 3): (N,) m, inf for none."""
        ways_m = self._ways_m(most_m)
        is_hit = self.at(origin + ways_m[:, None, None] * directions) == OCCUPIED
        return np.where(is_hit.any(axis=0), ways_m[is_hit.argmax(axis=0)], np.inf)

    def with_free_space(self, poses: FloatArray, camera: Camera, then: VoxelGrid | None = None) -> VoxelGrid:
        """The grid with the space free that cameras saw through: up to a voxel before the first occupied one.

        What is before no surface within 4 m stays unknown, since nothing says how far a ray went there.

        Args:
            poses: ``T_grid_camera``, (V, 4, 4); some of many are used.
            camera: of all of them.
            then: the surfaces when they looked, which hid what is behind them, too; None if they are the same.
        """
        if len(poses) == 0:
            return self
        states, ways_m = self.states.copy(), self._ways_m(_SEEN_M)
        rays = camera.resized(*_VIEW_PX).pixel_rays().reshape(-1, 3)
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        for pose in poses[evenly_spaced(len(poses), _MOST_VIEWS)]:
            directions = rays @ pose[:3, :3].T
            reach_m = self.distances_m(pose[:3, 3], directions, _SEEN_M)
            if then is not None:
                reach_m = np.minimum(reach_m, then.distances_m(pose[:3, 3], directions, _SEEN_M))
            is_seen = np.isfinite(reach_m) & (ways_m[:, None] < reach_m - self.voxel_m)
            points = (pose[:3, 3] + ways_m[:, None, None] * directions)[is_seen]
            cells = np.floor(points / self.voxel_m).astype(np.int64) - self.first
            x, y, z = cells[np.all((cells >= 0) & (cells < states.shape), axis=1)].T
            states[x, y, z] = np.maximum(states[x, y, z], FREE)
        return VoxelGrid(self.first, self.voxel_m, states)

    def _ways_m(self, most_m: float) -> FloatArray:
        step_m = _STEP * self.voxel_m
        return np.arange(step_m, most_m, step_m)


def fitting_voxel_m(mixture: GaussianMixture, voxel_m: float, also: FloatArray | None = None) -> float:
    """The edge of a voxel, or in a map that is too large for it, one whose grid :func:`surface_voxels` takes.

    In a map that is too large for any, the largest one.
    """
    low, high = _extent(mixture, also)
    while np.prod(_shape(low, high, voxel_m)) > _MOST_VOXELS and voxel_m < _MOST_VOXEL_M:
        voxel_m = min(_COARSER * voxel_m, _MOST_VOXEL_M)
    return voxel_m


def _shape(low: FloatArray, high: FloatArray, voxel_m: float) -> FloatArray:
    """Voxels along each axis, (3,), from one corner (3,) to the other."""
    return np.asarray(np.floor(high / voxel_m) - np.floor(low / voxel_m) + 1.0)


def _rounded_up(value: float) -> float:
    """To two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit


def surface_voxels(mixture: GaussianMixture, voxel_m: float, also: FloatArray | None = None) -> VoxelGrid:
    """Voxels that hold surface; the others are unknown.

    The mass of every component is spread evenly over its patch. A voxel is occupied if it has a quarter or more of
    what a surface through its middle has, so that components which stand for scattered points fill no space.

    Args:
        mixture: in the frame of the grid.
        voxel_m: edge of a voxel.
        also: points (N, 3) that the grid must reach, such as the cameras'; they occupy nothing.

    Raises:
        SettingError: the size is not positive, larger than 2 m, or so small that the grid would not fit into memory,
            or the map is too large for any size.
    """
    if not 0.0 < voxel_m <= _MOST_VOXEL_M:
        raise SettingError("voxel_m", f"is {voxel_m}", f"give a size in metres, up to {_MOST_VOXEL_M:g}")
    axes, half_m = patches(mixture)
    low, high = _extent(mixture, also)
    shape = _shape(low, high, voxel_m)
    if np.prod(shape) > _MOST_VOXELS:
        least_m = _rounded_up(voxel_m * float(np.prod(shape) / _MOST_VOXELS) ** (1.0 / 3.0))
        while np.prod(_shape(low, high, least_m)) > _MOST_VOXELS:
            least_m = _rounded_up(_COARSER * least_m)
        size = " x ".join(f"{edge:.4g}" for edge in shape * voxel_m)
        fix = f"give {least_m:g} or more"
        if least_m > _MOST_VOXEL_M:
            fix = "no size fits: is the map in metres? take back an edit far from the room, or build it again"
        raise SettingError("voxel_m", f"is {voxel_m:g} for a map of {size} m", fix)
    first = np.floor(low / voxel_m).astype(np.int64)
    mass = np.zeros(shape.astype(np.int64))
    for weight, mean, basis, half in zip(mixture.weights, mixture.means, axes, half_m, strict=True):
        counts = np.maximum(1, np.ceil(2.0 * half / (_STEP * voxel_m))).astype(np.int64)
        steps = ((2.0 * np.arange(count) + 1.0) / count - 1.0 for count in counts)
        offsets = half * np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
        x, y, z = (np.floor((mean + offsets @ basis.T) / voxel_m).astype(np.int64) - first).T
        np.add.at(mass, (x, y, z), weight / len(offsets))
    is_occupied = mass >= _COVERED * mass_per_area(mixture) * voxel_m**2
    return VoxelGrid(first, voxel_m, np.where(is_occupied, OCCUPIED, UNKNOWN).astype(np.uint8))


def _extent(mixture: GaussianMixture, also: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner (3,) of the patches, and of further points (N, 3)."""
    axes, half_m = patches(mixture)
    reach_m = (np.abs(axes) @ half_m[:, :, None])[:, :, 0]
    corners = [mixture.means - reach_m, mixture.means + reach_m, *([] if also is None else [also])]
    every = np.concatenate(corners)
    return every.min(axis=0), every.max(axis=0)
