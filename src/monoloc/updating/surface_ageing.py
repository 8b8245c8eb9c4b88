"""Surfaces that the camera looks through, and surfaces before what the map knows, counted in voxels.

A depth image is compared with the map's depth in the same view, pixel by pixel. So a ray that grazes a surface does
not speak against it, as it would where all voxels along the ray are counted as free.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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
from monoloc.updating.update_rules import UpdateRules

_COLUMNS = 80  # of the images that are compared
_MAP_POINTS = 100_000  # from which the map's depth is rendered
_SURE_SD = 3.0  # standard deviations by which depth must differ from the map's
_EDGE = np.ones((5, 5), dtype=np.uint8)  # pixels within which the nearest and the farthest depth are taken
_LEAST_PIXELS = 2  # of a voxel in a view
_MOST_POINTS, _MOST_CELLS = 40_000, 20_000  # that are kept

Cells = NDArray[np.int64]


@dataclass(frozen=True)
class Surfaces:
    """Evidence of changed surfaces.

    Attributes:
        gone, new: voxels, (N, 3) and (M, 3), in units of the rules' edge from the world's origin.
        gone_tally, new_tally: of their being gone, and of their being new.
        points: of new surfaces, (P, 3) float32, world frame, metres.
    """

    gone: Cells
    gone_tally: Tally
    new: Cells
    new_tally: Tally
    points: NDArray[np.float32]

    @classmethod
    def none(cls, rules: UpdateRules) -> Surfaces:
        cells, tally = np.zeros((0, 3), dtype=np.int64), Tally.new(0, rules)
        return cls(cells, tally, cells, tally, np.zeros((0, 3), dtype=np.float32))

    def without(self, gone: Cells, new: Cells) -> Surfaces:
        """Without what was counted of some voxels, which have been dealt with."""
        gone_kept, new_kept = ~is_among_cells(self.gone, gone), ~is_among_cells(self.new, new)
        return replace(
            self,
            gone=self.gone[gone_kept],
            gone_tally=self.gone_tally[gone_kept],
            new=self.new[new_kept],
            new_tally=self.new_tally[new_kept],
        )


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


def surfaces_after(
    surfaces: Surfaces, bundle: Bundle, flight: ObservedFlight, rules: UpdateRules, rng: np.random.Generator
) -> Surfaces:
    """Evidence of changed surfaces, after a flight."""
    seeing = [frame for frame in flight.frames if frame.depth is not None]
    if not seeing:
        return surfaces
    cloud = surface_points(bundle.original, _MAP_POINTS, rng)
    spacing_m = point_spacing_m(cloud)
    views = [_view(frame, flight, cloud, spacing_m, rules) for frame in seeing]
    gone, through = _counted([view.gone for view in views])
    surfaces = _with_cells(surfaces, gone, _counted([view.hit for view in views])[0], rules)
    seen_kept = _counts_of(surfaces.gone, *_counted([view.kept for view in views]))
    seen_gone = _counts_of(surfaces.gone, gone, through)
    hits = _counts_of(surfaces.new, *_counted([view.hit for view in views]))
    free = np.sum([_looks_through(frame, flight, surfaces.new, rules) for frame in seeing], axis=0)
    points = [surfaces.points.astype(np.float64), *(view.points for view in views)]
    return _bounded(
        Surfaces(
            surfaces.gone,
            _after(surfaces.gone_tally, seen_gone, seen_kept, rules),
            surfaces.new,
            _after(surfaces.new_tally, hits, free, rules),
            _thinned(np.concatenate(points), bundle),
        ),
        rules,
    )


def cells_of(points: FloatArray, rules: UpdateRules) -> Cells:
    """Voxels of points (N, 3), world frame."""
    return np.asarray(np.floor(points / rules.voxel_m), dtype=np.int64)


def is_among_cells(cells: Cells, others: Cells) -> NDArray[np.bool_]:
    """Whether each of N voxels is one of the others, (N,)."""
    among = {tuple(cell) for cell in others.tolist()}
    return np.array([tuple(cell) in among for cell in cells.tolist()], dtype=np.bool_)


def _after(tally: Tally, changed: NDArray[np.int64], unchanged: NDArray[np.int64], rules: UpdateRules) -> Tally:
    expected = changed + unchanged
    rates = np.asarray(rules.gone_seen), np.asarray(rules.there_seen)
    return tally.after_flight(expected, changed, bernoulli_nats(expected, changed, *rates), rules)


def _view(
    frame: UsableFrame, flight: ObservedFlight, cloud: FloatArray, spacing_m: float, rules: UpdateRules
) -> _View:
    camera, measured, nearest, farthest = _compared(frame)
    mapped = cloud_depth(cloud, camera, frame.pose, spacing_m)
    map_nearest, map_farthest = _range(mapped)
    is_known = (nearest > 0.0) & (map_nearest > 0.0)
    error_m = flight.error_m(measured.astype(np.float64))
    is_gone = is_known & (nearest - map_farthest > _SURE_SD * error_m)
    is_kept = is_known & (np.abs(measured - mapped) <= _SURE_SD * error_m)
    is_new = is_known & (map_nearest - farthest > _SURE_SD * error_m) & (error_m <= rules.most_point_sd_m)
    gone = _cells_with(cells_of(_points(frame, camera, mapped, is_gone), rules))
    kept = _cells_with(cells_of(_points(frame, camera, mapped, is_kept), rules))
    points = _points(frame, camera, measured, is_new)
    # A voxel that is partly seen stands.
    return _View(gone[~is_among_cells(gone, kept)], kept, _cells_with(cells_of(points, rules)), points)


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


def _with_cells(surfaces: Surfaces, gone: Cells, new: Cells, rules: UpdateRules) -> Surfaces:
    """With voxels that a flight is the first to name."""
    gone = gone[~is_among_cells(gone, surfaces.gone)]
    new = new[~is_among_cells(new, surfaces.new)]
    return replace(
        surfaces,
        gone=np.concatenate([surfaces.gone, gone]),
        gone_tally=surfaces.gone_tally + Tally.new(len(gone), rules),
        new=np.concatenate([surfaces.new, new]),
        new_tally=surfaces.new_tally + Tally.new(len(new), rules),
    )


def _looks_through(frame: UsableFrame, flight: ObservedFlight, cells: Cells, rules: UpdateRules) -> NDArray[np.int64]:
    """Whether a frame sees only what is behind each of N voxels, (N,)."""
    camera, _, nearest, _ = _compared(frame)
    centres = transform(invert(frame.pose), (cells + 0.5) * rules.voxel_m)
    result = np.zeros(len(cells), dtype=np.int64)
    seen = np.flatnonzero(camera.in_sight(centres))
    pixels = np.rint(camera.project(centres[seen])).astype(np.int64)
    inside = np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    seen, (u, v) = seen[inside], pixels[inside].T
    behind_m = nearest[v, u] - centres[seen, 2]
    result[seen] = (nearest[v, u] > 0.0) & (
        behind_m > _SURE_SD * flight.error_m(nearest[v, u].astype(np.float64)) + rules.voxel_m
    )
    return result


def _thinned(points: FloatArray, bundle: Bundle) -> NDArray[np.float32]:
    """Points that the map does not know, one a voxel of its cloud."""
    thin = voxel_thin(points, cloud_of(bundle).voxel_m)
    return np.asarray(thin[~known(bundle, thin)][-_MOST_POINTS:], dtype=np.float32)


def _bounded(surfaces: Surfaces, rules: UpdateRules) -> Surfaces:
    """Without voxels of which nothing speaks for a change any more, and of points only those in a new voxel."""
    gone = np.flatnonzero(surfaces.gone_tally.is_above_prior(rules))[-_MOST_CELLS:]
    new = np.flatnonzero(surfaces.new_tally.is_above_prior(rules))[-_MOST_CELLS:]
    kept = is_among_cells(cells_of(surfaces.points.astype(np.float64), rules), surfaces.new[new])
    return Surfaces(
        surfaces.gone[gone],
        surfaces.gone_tally[gone],
        surfaces.new[new],
        surfaces.new_tally[new],
        surfaces.points[kept],
    )
