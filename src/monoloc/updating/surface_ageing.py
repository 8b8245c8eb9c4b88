"""Surfaces that the camera looks through, and surfaces before what the map knows, counted in voxels.

A depth image is compared with the map's depth in the same view, pixel by pixel. So a ray that grazes a surface does
not speak against it, as it would where all voxels along the ray are counted as free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.editing.alignment import known
from monoloc.editing.paired_map import cloud_of
from monoloc.geometry import FloatArray, invert, transform
from monoloc.map.cloud import voxel_thin
from monoloc.map.depth_rendering import cloud_depth, point_spacing_m
from monoloc.map.surface import surface_points
from monoloc.updating.observed_flight import ObservedFlight, UsableFrame
from monoloc.updating.tally import Tally, bernoulli_nats

_COLUMNS = 80  # of the images that are compared
_MAP_POINTS = 100_000  # from which the map's depth is rendered
_SURE_SD = 3.0  # standard deviations by which depth must differ from the map's
_EDGE = np.ones((5, 5), dtype=np.uint8)  # pixels within which the nearest and the farthest depth are taken
_LEAST_PIXELS = 2  # of a voxel in a view
_MOST_POINTS, _MOST_CELLS = 40_000, 20_000  # that are kept

_GONE_SEEN, _THERE_SEEN = np.asarray(0.8), np.asarray(0.05)  # share of views in which a voxel looks gone, if it is
_MOST_POINT_SD_M = 0.1  # of a depth point that may show a new surface

VOXEL_M = 0.15
"""Edge of the voxels in which surfaces are counted."""

Cells = NDArray[np.int64]


@dataclass(frozen=True)
class CountedVoxels:
    """Voxels, and what flights said of a change of each.

    Attributes:
        cells: (N, 3), in units of their edge from the world's origin.
        tally: of N changes.
    """

    cells: Cells
    tally: Tally

    @classmethod
    def none(cls) -> CountedVoxels:
        return cls(np.zeros((0, 3), dtype=np.int64), Tally.new(0))

    def __len__(self) -> int:
        return len(self.cells)

    def __getitem__(self, chosen: NDArray[Any]) -> CountedVoxels:
        return CountedVoxels(self.cells[chosen], self.tally[chosen])

    def without(self, others: Cells) -> CountedVoxels:
        """Those that are none of some others."""
        return self[~is_among_cells(self.cells, others)]

    def with_first(self, seen: Cells) -> CountedVoxels:
        """With those seen voxels (M, 3) that a flight is the first to name."""
        first = seen[~is_among_cells(seen, self.cells)]
        return CountedVoxels(np.concatenate([self.cells, first]), self.tally + Tally.new(len(first)))

    def after_flight(self, changed: NDArray[np.int64], unchanged: NDArray[np.int64]) -> CountedVoxels:
        """After a flight with so many views of each voxel, (N,), that speak for its change, and against it."""
        expected = changed + unchanged
        nats = bernoulli_nats(expected, changed, _GONE_SEEN, _THERE_SEEN)
        return CountedVoxels(self.cells, self.tally.after_flight(expected, changed, nats))

    def still_open(self) -> CountedVoxels:
        """Those for whose change anything speaks, at most the newest."""
        return self[np.flatnonzero(self.tally.is_above_prior)[-_MOST_CELLS:]]


@dataclass(frozen=True)
class Surfaces:
    """Evidence of changed surfaces.

    Attributes:
        gone, new: voxels that may be gone, and that may be new.
        points: of new surfaces, (P, 3) float32, world frame, metres.
    """

    gone: CountedVoxels
    new: CountedVoxels
    points: NDArray[np.float32]

    @classmethod
    def none(cls) -> Surfaces:
        return cls(CountedVoxels.none(), CountedVoxels.none(), np.zeros((0, 3), dtype=np.float32))

    def without(self, gone: Cells, new: Cells) -> Surfaces:
        """Without what was counted of some voxels, which have been dealt with."""
        return replace(self, gone=self.gone.without(gone), new=self.new.without(new))


@dataclass(frozen=True)
class _View:
    """What a frame says of voxels: of the map's surfaces, and of those that stand before them.

    Attributes:
        gone, kept: voxels of the map's surface that it looks through, and that it sees.
        hit: voxels in which it sees a surface before the map's.
        points: on those surfaces, (P, 3).
    """

    gone: Cells
    kept: Cells
    hit: Cells
    points: FloatArray


def surfaces_after(surfaces: Surfaces, bundle: Bundle, flight: ObservedFlight, rng: np.random.Generator) -> Surfaces:
    """Evidence of changed surfaces, after a flight."""
    seeing = [frame for frame in flight.frames if frame.depth is not None]
    if not seeing:
        return surfaces
    cloud = surface_points(bundle.original, _MAP_POINTS, rng)
    spacing_m = point_spacing_m(cloud)
    views = [_view(frame, flight, cloud, spacing_m) for frame in seeing]
    seen_gone, seen_kept = _counted([view.gone for view in views]), _counted([view.kept for view in views])
    hits = _counted([view.hit for view in views])
    gone, new = surfaces.gone.with_first(seen_gone[0]), surfaces.new.with_first(hits[0])
    looked_through = np.sum([_looks_through(frame, flight, new.cells) for frame in seeing], axis=0)
    gone = gone.after_flight(_counts_of(gone.cells, *seen_gone), _counts_of(gone.cells, *seen_kept)).still_open()
    new = new.after_flight(_counts_of(new.cells, *hits), looked_through).still_open()
    points = _thinned(np.concatenate([surfaces.points.astype(np.float64), *(view.points for view in views)]), bundle)
    is_kept = is_among_cells(cells_of(points.astype(np.float64)), new.cells)
    return Surfaces(gone, new, points[is_kept])


def cells_of(points: FloatArray) -> Cells:
    """Voxels of points (N, 3), world frame."""
    return np.asarray(np.floor(points / VOXEL_M), dtype=np.int64)


def is_among_cells(cells: Cells, others: Cells) -> NDArray[np.bool_]:
    """Whether each of N voxels is one of the others, (N,)."""
    among = {tuple(cell) for cell in others.tolist()}
    return np.array([tuple(cell) in among for cell in cells.tolist()], dtype=np.bool_)


def _view(frame: UsableFrame, flight: ObservedFlight, cloud: FloatArray, spacing_m: float) -> _View:
    camera, measured, nearest, farthest = _compared(frame)
    mapped = cloud_depth(cloud, camera, frame.pose, spacing_m)
    map_nearest, map_farthest = _range(mapped)
    is_known = (nearest > 0.0) & (map_nearest > 0.0)
    error_m = flight.error_m(measured.astype(np.float64))
    is_gone = is_known & (nearest - map_farthest > _SURE_SD * error_m)
    is_kept = is_known & (np.abs(measured - mapped) <= _SURE_SD * error_m)
    is_new = is_known & (map_nearest - farthest > _SURE_SD * error_m) & (error_m <= _MOST_POINT_SD_M)
    gone = _cells_with(cells_of(_points(frame, camera, mapped, is_gone)))
    kept = _cells_with(cells_of(_points(frame, camera, mapped, is_kept)))
    points = _points(frame, camera, measured, is_new)
    # A voxel that is partly seen stands.
    return _View(gone[~is_among_cells(gone, kept)], kept, _cells_with(cells_of(points)), points)


def _compared(
    frame: UsableFrame,
) -> tuple[Camera, NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Camera, depth, and the nearest and the farthest depth around each pixel, of a frame at the size compared."""
    assert frame.depth is not None
    full = frame.depth.camera
    camera = full.of_width(_COLUMNS)
    size = (camera.width, camera.height)
    measured = np.asarray(cv2.resize(frame.depth.depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
    return camera, measured, *_range(measured)


def _range(depth_m: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The nearest and the farthest depth around each pixel that has depth; 0 for others."""
    is_known = depth_m > 0.0
    nearest = np.asarray(cv2.erode(np.where(is_known, depth_m, np.float32(np.inf)), _EDGE))
    farthest = np.asarray(cv2.dilate(depth_m, _EDGE))
    return np.where(is_known, nearest, np.float32(0.0)), np.where(is_known, farthest, np.float32(0.0))


def _points(
    frame: UsableFrame, camera: Camera, depth_m: NDArray[np.float32], chosen: NDArray[np.bool_]
) -> FloatArray:
    return transform(frame.pose, camera.back_project(depth_m)[chosen])


def _cells_with(cells: Cells) -> Cells:
    """Voxels that hold enough pixels."""
    found, counts = np.unique(cells, axis=0, return_counts=True)
    return np.asarray(found[counts >= _LEAST_PIXELS])


def _counted(views: list[Cells]) -> tuple[Cells, NDArray[np.int64]]:
    """Voxels of several views, and in how many they occur."""
    found, counts = np.unique(np.concatenate(views), axis=0, return_counts=True)
    return found, counts.astype(np.int64)


def _counts_of(cells: Cells, counted: Cells, counts: NDArray[np.int64]) -> NDArray[np.int64]:
    table = dict(zip(map(tuple, counted.tolist()), counts.tolist(), strict=True))
    return np.array([table.get(tuple(cell), 0) for cell in cells.tolist()], dtype=np.int64)


def _looks_through(frame: UsableFrame, flight: ObservedFlight, cells: Cells) -> NDArray[np.int64]:
    """Whether a frame sees only what is behind each of N voxels, (N,)."""
    camera, _, nearest, _ = _compared(frame)
    centres = transform(invert(frame.pose), (cells + 0.5) * VOXEL_M)
    result = np.zeros(len(cells), dtype=np.int64)
    seen = np.flatnonzero(camera.in_sight(centres))
    pixels = np.rint(camera.project(centres[seen])).astype(np.int64)
    inside = np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    seen, (u, v) = seen[inside], pixels[inside].T
    behind_m = nearest[v, u] - centres[seen, 2]
    result[seen] = (nearest[v, u] > 0.0) & (
        behind_m > _SURE_SD * flight.error_m(nearest[v, u].astype(np.float64)) + VOXEL_M
    )
    return result


def _thinned(points: FloatArray, bundle: Bundle) -> NDArray[np.float32]:
    """Points that the map does not know, one a voxel of its cloud."""
    thin = voxel_thin(points, cloud_of(bundle).voxel_m)
    return np.asarray(thin[~known(bundle, thin)][-_MOST_POINTS:], dtype=np.float32)
