"""Point clouds: from posed RGB-D frames, voxel thinning, outlier removal."""

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

# A larger relative depth step between neighbouring pixels is an edge between surfaces, where sensors report depths of
# neither ("flying pixels"). Within one surface, such a step occurs only at viewing angles below 2 degrees.
DISCONTINUITY = 0.05
_CELL_VOXELS, _MIN_CELL_M = 5.0 / 3.0, 0.05  # size of the cells that count neighbours
_STRIDE = 4  # from one used pixel to the next: of a Kinect's depth, at 4 m, these are 3 cm apart, a voxel
_LEAST_NEIGHBOURS = 5  # a plane has about 25, so its edges stay
_KEY_BITS = 21  # voxel coordinates along one axis: +-2^20 voxels
_MERGE_AT = 2_000_000  # pending voxels that trigger a merge


def cloud_from_recording(
    recording: Recording,
    voxel_m: float = 0.03,
    max_depth_m: float = 4.0,
    progress: Callable[[int, int], None] | None = None,
) -> FloatArray:
    """Build the thinned cloud of a recording: (N, 3) float64, world frame, metres.

    Every fourth pixel in both directions is back-projected and averaged in voxels, except at depth discontinuities
    and beyond ``max_depth_m``. The weights are ``z ** -4``, because the standard deviation of
    structured-light and stereo depth grows with the square of depth (Khoshelham and Elberink 2012). Memory grows with
    the number of occupied voxels, not with the number of frames.

    Args:
        recording: frames with depth and poses.
        voxel_m: edge of the voxels; the cloud has one point per occupied voxel.
        max_depth_m: largest depth that is used.
        progress: called with (completed frames, total frames).

    Raises:
        DataError: the recording has no poses, no depth, or no usable pixel.
        SettingError: a size is not positive.
    """
    if not max_depth_m > 0.0:
        raise SettingError("max_depth_m", f"is {max_depth_m}", "give a positive depth in metres")
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "give a recording with poses, or a cloud file")
    if not recording.has_depth:
        raise DataError(recording.name, "has no depth", "give a recording with depth, or a cloud (--cloud)")
    rays = recording.camera.pixel_rays()[::_STRIDE, ::_STRIDE]
    thinner = VoxelThinner(voxel_m)
    for index, T_world_camera in enumerate(recording.poses):
        depth = recording.depth(index).astype(np.float64)
        usable = ((depth > 0.0) & (depth <= max_depth_m) & ~at_discontinuity(depth, DISCONTINUITY))[
            ::_STRIDE, ::_STRIDE
        ]
        z = depth[::_STRIDE, ::_STRIDE][usable]
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
    """Replace the points in each voxel of a grid at the origin by their centroid: (N, 3) m -> (M, 3) m.

    Raises:
        ValueError: the shape is wrong, or a value is not finite.
        DataError: a point is too far from the origin for the voxel size.
        SettingError: the voxel size is not positive.
    """
    thinner = VoxelThinner(voxel_m)
    thinner.add(points)
    return thinner.points()


def remove_outliers(points: ArrayLike, voxel_m: float = 0.03) -> FloatArray:
    """Keep points with at least five others in the surrounding 27 cells: (N, 3) m -> (M, 3) m.

    The cell size is 5/3 of ``voxel_m``, the voxel size of the thinned cloud, so that a plane has about 25 points in
    the 27 cells at any size. It is at least 5 cm, because clouds from other sources may be sparser.

    Raises:
        ValueError, DataError, SettingError: see :func:`voxel_thin`.
    """
    cloud = float64("points", points, None, 3)
    _check_voxel(voxel_m)
    keys = _voxel_keys(cloud, max(_MIN_CELL_M, _CELL_VOXELS * voxel_m))
    cells, cell_of_point, counts = np.unique(keys, return_inverse=True, return_counts=True)
    around = np.zeros(len(cells), dtype=np.int64)
    steps = (-1, 0, 1)
    for step in (_pack(np.array([x, y, z])) for x in steps for y in steps for z in steps):
        found = np.minimum(np.searchsorted(cells, cells + step), max(len(cells) - 1, 0))
        around += np.where(cells[found] == cells + step, counts[found], 0)
    return np.asarray(cloud[around[cell_of_point] > _LEAST_NEIGHBOURS])


class VoxelThinner:
    """Accumulates weighted centroids of points by voxel.

    Args:
        voxel_m: edge of a voxel, metres.

    Raises:
        SettingError: the edge is not positive.
    """

    def __init__(self, voxel_m: float) -> None:
        _check_voxel(voxel_m)
        self._voxel_m = voxel_m
        self._keys: list[IntArray] = []
        self._sums: list[FloatArray] = []  # (n, 4): weighted coordinates and weight
        self._pending = 0

    def add(self, points: ArrayLike, weights: ArrayLike | None = None) -> None:
        """Add points (N, 3) m with weights (N,), 1 by default.

        Raises:
            ValueError: a shape is wrong, or a value is not finite.
            DataError: a point is too far from the origin.
        """
        cloud = float64("points", points, None, 3)
        w = np.ones(len(cloud)) if weights is None else float64("weights", weights, len(cloud))
        sums = np.column_stack([cloud * w[:, None], w])
        keys, sums = _merge(_voxel_keys(cloud, self._voxel_m), sums)
        self._keys.append(keys)
        self._sums.append(sums)
        self._pending += len(keys)
        if self._pending > _MERGE_AT:
            self._compact()
            self._pending = 0

    def points(self) -> FloatArray:
        """Return the centroids, (M, 3) m, ordered by voxel."""
        if not self._keys:
            return np.empty((0, 3))
        self._compact()
        sums = self._sums[0]
        return np.asarray(sums[:, :3] / sums[:, 3:])

    def _compact(self) -> None:
        keys, sums = _merge(np.concatenate(self._keys), np.concatenate(self._sums))
        self._keys, self._sums = [keys], [sums]


def _merge(keys: IntArray, sums: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sum rows (N, 4) with equal keys (N,)."""
    unique, inverse = np.unique(keys, return_inverse=True)
    merged = [np.bincount(inverse, sums[:, column], len(unique)) for column in range(sums.shape[1])]
    return unique, np.stack(merged, axis=1)


def _check_voxel(voxel_m: float) -> None:
    if not 0.0 < voxel_m < np.inf:
        raise SettingError("voxel_m", f"is {voxel_m}", "give a positive size in metres")


def _voxel_keys(points: FloatArray, voxel_m: float) -> IntArray:
    """Integer key of the voxel of each point: (N, 3) m -> (N,)."""
    cells = np.floor(points / voxel_m)
    limit = 2 ** (_KEY_BITS - 1) - 2
    if np.abs(cells).max(initial=0.0) > limit:
        far_km = float(np.abs(points).max()) / 1e3
        problem = f"lies {far_km:.1f} km from the origin, too far for voxels of {voxel_m:g} m"
        raise DataError("cloud", problem, "subtract an offset from cloud and poses")
    return _pack(cells.astype(np.int64) + 2 ** (_KEY_BITS - 1))


def _pack(cells: IntArray) -> IntArray:
    """Pack cell coordinates into one integer. Packing is linear: key plus packed step is the neighbour's key."""
    return np.asarray((cells[..., 2] << 2 * _KEY_BITS) + (cells[..., 1] << _KEY_BITS) + cells[..., 0])
