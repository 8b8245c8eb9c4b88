"""Clouds: from RGB-D frames with poses, thinned and cleaned."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.depth.depth_image import at_discontinuity
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray, transform
from monoloc.io.recording import Recording
from monoloc.map.arguments import float64

IntArray = NDArray[np.int64]

# A neighbouring pixel this much nearer or farther, relative to depth, marks an edge between surfaces, where
# sensors report depths of neither ("flying pixels"). A surface reaches it only when seen at under 2 degrees.
DISCONTINUITY = 0.05
_CELL_VOXELS, _LEAST_CELL_M = 5.0 / 3.0, 0.05  # of the cells in which neighbours are counted
_KEY_BITS = 21  # voxel coordinates along one axis: +-2^20 voxels
_MERGE_AT = 2_000_000  # voxels held back before they are merged


def cloud_from_recording(
    recording: Recording,
    voxel_m: float = 0.03,
    max_depth_m: float = 4.0,
    stride: int = 4,
    progress: Callable[[int, int], None] | None = None,
) -> FloatArray:
    """Thinned cloud of a recording: (N, 3) float64, world frame, metres.

    Every ``stride``-th pixel in both directions is back-projected, except at depth discontinuities and
    beyond ``max_depth_m``, and averaged in voxels. Weights are ``z ** -4``: the noise of structured-light
    and stereo depth grows with the square of depth (Khoshelham and Elberink 2012). Memory is bounded by
    the voxels seen, not by the number of frames.

    Args:
        recording: frames with depth and poses.
        voxel_m: edge of the voxels; one point stays in each.
        max_depth_m: farther measurements are left out.
        stride: pixels skipped, 1 for none.
        progress: called with (frames done, frames in all).

    Raises:
        DataError: the recording has no poses or no depth, or no pixel of it can be used.
        SettingError: stride under 1, or a size that is not positive.
    """
    if stride < 1:
        raise SettingError("stride", f"is {stride}", "give 1 or more pixels")
    if not max_depth_m > 0.0:
        raise SettingError("max_depth_m", f"is {max_depth_m}", "give a positive depth in metres")
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "give a recording with poses, or a cloud file")
    if not recording.has_depth:
        raise DataError(recording.name, "has no depth", "give a recording with depth, or a cloud file")
    rays = recording.camera.pixel_rays()[::stride, ::stride]
    thinner = VoxelThinner(voxel_m)
    for index, T_world_camera in enumerate(recording.poses):
        depth = recording.depth(index).astype(np.float64)
        usable = ((depth > 0.0) & (depth <= max_depth_m) & ~at_discontinuity(depth, DISCONTINUITY))[
            ::stride, ::stride
        ]
        z = depth[::stride, ::stride][usable]
        thinner.add(transform(T_world_camera, z[:, None] * rays[usable]), z**-4)
        if progress is not None:
            progress(index + 1, len(recording))
    cloud = thinner.points()
    if len(cloud) == 0:
        raise DataError(
            recording.name,
            f"has no depth between 0 and {max_depth_m} m away from edges",
            "check the depth scale, or raise max_depth_m",
        )
    return cloud


def voxel_thin(points: ArrayLike, voxel_m: float) -> FloatArray:
    """One point, the centroid, in each occupied voxel of a grid at the origin: (N, 3) m -> (M, 3) m.

    Raises:
        ValueError: wrong shape, or values that are not finite.
        DataError: points too far from the origin for the voxel size.
        SettingError: a voxel size that is not positive.
    """
    thinner = VoxelThinner(voxel_m)
    thinner.add(points)
    return thinner.points()


def remove_outliers(points: ArrayLike, voxel_m: float = 0.03, neighbours: int = 5) -> FloatArray:
    """Points with at least ``neighbours`` others in the 27 cells around: (N, 3) m -> (M, 3) m.

    Cells have 5/3 of ``voxel_m``, to which the cloud was thinned, so that a plane has about 25 points in them at
    any size; and 5 cm at least, for a cloud that came from elsewhere may be no denser than that.

    Raises:
        ValueError, DataError, SettingError: as for :func:`voxel_thin`.
    """
    cloud = float64("points", points, None, 3)
    _check_voxel(voxel_m)
    keys = _voxel_keys(cloud, max(_LEAST_CELL_M, _CELL_VOXELS * voxel_m))
    cells, cell_of_point, counts = np.unique(keys, return_inverse=True, return_counts=True)
    around = np.zeros(len(cells), dtype=np.int64)
    steps = (-1, 0, 1)
    for step in (_pack(np.array([x, y, z])) for x in steps for y in steps for z in steps):
        found = np.minimum(np.searchsorted(cells, cells + step), max(len(cells) - 1, 0))
        around += np.where(cells[found] == cells + step, counts[found], 0)
    return np.asarray(cloud[around[cell_of_point] > neighbours])


class VoxelThinner:
    """Weighted centroids of points by voxel, fed in parts.

    Args:
        voxel_m: edge of a voxel, metres.

    Raises:
        SettingError: it is not positive.
    """

    def __init__(self, voxel_m: float) -> None:
        _check_voxel(voxel_m)
        self._voxel_m = voxel_m
        self._keys: list[IntArray] = []
        self._sums: list[FloatArray] = []  # (n, 4): weighted coordinates and weight
        self._held_back = 0

    def add(self, points: ArrayLike, weights: ArrayLike | None = None) -> None:
        """Add points (N, 3) m with weights (N,), ones by default.

        Raises:
            ValueError: wrong shapes, or values that are not finite.
            DataError: points too far from the origin.
        """
        cloud = float64("points", points, None, 3)
        w = np.ones(len(cloud)) if weights is None else float64("weights", weights, len(cloud))
        sums = np.column_stack([cloud * w[:, None], w])
        keys, sums = _merge(_voxel_keys(cloud, self._voxel_m), sums)
        self._keys.append(keys)
        self._sums.append(sums)
        self._held_back += len(keys)
        if self._held_back > _MERGE_AT:
            self._compact()
            self._held_back = 0

    def points(self) -> FloatArray:
        """Centroids, (M, 3) m, in the order of their voxels."""
        if not self._keys:
            return np.empty((0, 3))
        self._compact()
        sums = self._sums[0]
        return np.asarray(sums[:, :3] / sums[:, 3:])

    def _compact(self) -> None:
        keys, sums = _merge(np.concatenate(self._keys), np.concatenate(self._sums))
        self._keys, self._sums = [keys], [sums]


def _merge(keys: IntArray, sums: FloatArray) -> tuple[IntArray, FloatArray]:
    """Add up rows (N, 4) of equal keys (N,)."""
    unique, inverse = np.unique(keys, return_inverse=True)
    merged = [np.bincount(inverse, sums[:, column], len(unique)) for column in range(sums.shape[1])]
    return unique, np.stack(merged, axis=1)


def _check_voxel(voxel_m: float) -> None:
    if not 0.0 < voxel_m < np.inf:
        raise SettingError("voxel_m", f"is {voxel_m}", "give a positive size in metres")


def _voxel_keys(points: FloatArray, voxel_m: float) -> IntArray:
    """One integer a voxel: (N, 3) m -> (N,)."""
    cells = np.floor(points / voxel_m)
    limit = 2 ** (_KEY_BITS - 1) - 2
    if np.abs(cells).max(initial=0.0) > limit:
        far_km = float(np.abs(points).max()) / 1e3
        problem = f"lies {far_km:.1f} km from the origin, too far for voxels of {voxel_m:g} m"
        raise DataError("cloud", problem, "subtract an offset from cloud and poses")
    return _pack(cells.astype(np.int64) + 2 ** (_KEY_BITS - 1))


def _pack(cells: IntArray) -> IntArray:
    """Additive in its argument, so that neighbours are found by adding a packed step."""
    return np.asarray((cells[..., 2] << 2 * _KEY_BITS) + (cells[..., 1] << _KEY_BITS) + cells[..., 0])
