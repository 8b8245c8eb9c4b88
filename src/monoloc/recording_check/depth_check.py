"""Whether a sensor's depth is z, and registered to the colour image, by planes and by the edges of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.io.corrected import DEPTH_FIXES, DepthFix, given_depth_fix, is_seven_scenes, with_depth_fix
from monoloc.io.recording import Recording, evenly_spaced, scale_sd_of
from monoloc.recording_check.image_quality import small_gray
from monoloc.supervision.distinct_views import DistinctViews

_FRAMES = 16
_LEAST_FRAMES = 6  # in which a quantity is measured

# Planes: of z read as z, the largest holds 1.5 to 2.6 times the points of the same depth read as range (RedKitchen
# 0:200, desk 0:350), in every frame; z taken for range and converted, 1.4 to 3.4 times fewer than as it was (parts of
# both, the rendered living room).
_POINTS, _TRIALS, _LEAST_POINTS = 1500, 150, 300
_PLANE_TOLERANCE = 0.01  # of depth
_FLATTER, _AGREEING = 1.25, 0.8  # median ratio, and share of the frames that are flatter

# Edges: strength of the image's gradient at depth's edges, relative to that around. Registered depth gave 1.6 to 2.8
# (RedKitchen, the desk, the rendered living room, NYU; 1.2 in a blurred turn), and at most 1.2 times that at a zoom
# of 5 % and more. Of a wider depth camera, taken as registered, it was 1.0 to 1.1, and 1.6 to 2.1 times that after
# zooms of 1.27 to 1.63. Depth cameras see up to 1.6 times as much as their colour cameras (RealSense D435).
# Registered edges fit best up to 5 pixels of 320 off, by up to 1.21 times better there, and 1.64 times in 15 frames
# of one view. Mirrored, flipped or turned, they gave 0.9 to 1.6, and 1.7 to 2.5 times that once this was undone.
_EDGE, _LEAST_EDGES = 0.05, 200
_EDGE_WIDTH, _HOLE = 640, 0.02  # pixels that edges are looked for in; width of a hole that they lie at, share of it
_NEIGHBOURHOOD_PX, _SEARCH_PX = 41, 16
_ZOOMS = np.exp(0.0125 * np.arange(-18, 46))  # 0.80 to 1.75
_GAIN, _LEAST_ZOOM = 1.4, 0.05  # of depth that is not registered, by a zoom that differs from 1 at least so much
_LEAST_SHIFT_PX = 6  # of 320, or by a shift at least so far
_LEAST_VIEWS = 3  # of fewer, edges may fit somewhere else by chance
# Sides of the image that are exchanged, by what the depth is.
_FLIPS = {"mirrored": (True, False), "mirrored top to bottom": (False, True), "turned by 180 degrees": (True, True)}


@dataclass(frozen=True)
class DepthCheck:
    """What a recording's depth looks like.

    Attributes:
        coverage: mean share of pixels with depth.
        median_m: median depth.
        flatness: factor by which planes are flatter if the depth is taken as range, or no longer is where it was
            to be; None if unknown.
        edges: strength of the image's gradient at depth's edges, 1 as anywhere; None if unknown.
        misfit: how depth's edges fit those of the images, where the depth is not registered; None where it is.
        zoom: factor about the image's centre that brings depth's edges there; None where that takes no zoom.
        fix: key of ``DEPTH_FIXES`` under which the depth fits; None if it fits as it is, or if none is known.
        has_few_views: whether the camera hovers in one or two views.
        was_z: whether depth was z that was to be taken as range.
    """

    coverage: float
    median_m: float
    flatness: float | None
    edges: float | None
    misfit: str | None = None
    zoom: float | None = None
    fix: DepthFix | None = None
    has_few_views: bool = False
    was_z: bool = False

    @property
    def is_certain(self) -> bool:
        """Whether what is wrong is no accident of one view."""
        return not self.has_few_views or self.coverage == 0.0 or self.fix == "range" or self.was_z

    @property
    def problem(self) -> str | None:
        """What is wrong, for a message."""
        if self.coverage == 0.0:
            return "no pixel has depth"
        if self.was_z:
            return f"depth is z already: planes are {self.flatness:.1f} times as flat without --fix-depth range"
        if self.fix == "range":
            return f"depth is {DEPTH_FIXES['range']}: planes are {self.flatness:.1f} times as flat"
        if self.misfit is not None:
            named = f", as if {DEPTH_FIXES[self.fix]}" if self.fix else ""
            chance = "" if self.is_certain else ", perhaps by chance, as the camera hovers in one view"
            return f"depth is not registered to the images: its edges fit {self.misfit}{named}{chance}"
        return None

    @property
    def remedy(self) -> str:
        if self.coverage == 0.0:
            return "record within the sensor's range; of an app's depth, only that of the highest confidence counts"
        if self.was_z:
            return "leave out --fix-depth range"
        if self.fix is not None:
            return f"give --fix-depth {self.fix}"
        if self.misfit in _FLIPS:
            return "store depth and colour images the same way around"
        return "align depth to colour in the recorder, or state the depth camera (depth_fx, ...) in a dataset.toml"


def check_depth(recording: Recording) -> DepthCheck:
    """Look at a few frames of a recording with depth.

    Depth by structure from motion is z in the images by its making. Only its coverage is measured: its edges lie
    where there is texture, and often not where surfaces end.

    Raises:
        DataError: a frame cannot be read.
    """
    chosen = evenly_spaced(len(recording), _FRAMES).tolist()
    depths = [recording.depth(index) for index in chosen]
    values = np.concatenate([depth[depth > 0.0][::37] for depth in depths])
    coverage = float(np.mean([(depth > 0.0).mean() for depth in depths]))
    median_m = float(np.median(values)) if len(values) else float("nan")
    if scale_sd_of(recording) is not None:
        return DepthCheck(coverage, median_m, flatness=None, edges=None)
    was_converted = given_depth_fix(recording) == "range"
    flatness, is_other = _flatness_otherwise(recording, depths, was_converted)
    images = [_relative_gradient(recording.color(index)) for index in chosen]
    aligned = _Alignment(recording, depths, images)
    check = DepthCheck(
        coverage,
        median_m,
        flatness,
        aligned.stated,
        aligned.misfit,
        aligned.zoom,
        "range" if is_other and not was_converted else None,
        was_z=is_other and was_converted,
        has_few_views=recording.poses is not None and _views(recording.poses[chosen]) < _LEAST_VIEWS,
    )
    if aligned.misfit is None or aligned.misfit in _FLIPS or is_other:
        return check
    name: DepthFix = "registered" if is_seven_scenes(recording) else "kinect"
    fixed = with_depth_fix(recording, name)
    refined = _Alignment(fixed, [fixed.depth(index) for index in chosen], images)
    is_better = refined.misfit is None and (refined.stated or 0.0) > _GAIN * (aligned.stated or 0.0)
    return replace(check, fix=name if is_better else None)


def _views(poses: FloatArray) -> int:
    """How often a camera with ``T_world_camera`` (N, 4, 4) sees the scene from a new view."""
    views = DistinctViews()
    return sum(views.is_new(pose) for pose in poses)


def _flatness_otherwise(
    recording: Recording, depths: list[NDArray[np.float32]], was_converted: bool
) -> tuple[float | None, bool]:
    """Median ratio of planar points, depth taken as range over depth as it is, and whether it is range.

    The same without the conversion from range, if it ``was_converted``.
    """
    rays = recording.camera.pixel_rays().reshape(-1, 3)
    range_per_z = np.linalg.norm(rays, axis=1)
    otherwise = range_per_z if was_converted else 1.0 / range_per_z
    ratios = []
    for depth in depths:
        known = np.flatnonzero(depth > 0.0)
        if len(known) < _LEAST_POINTS:
            continue
        chosen = known[:: max(1, len(known) // _POINTS)]
        points = rays[chosen] * depth.reshape(-1)[chosen, None].astype(np.float64)
        ratios.append(_planar_share(points * otherwise[chosen, None]) / _planar_share(points))
    if len(ratios) < _LEAST_FRAMES:
        return None, False
    ratio = float(np.median(ratios))
    return ratio, ratio > _FLATTER and float(np.mean(np.array(ratios) > 1.0)) >= _AGREEING


def _planar_share(points: FloatArray) -> float:
    """Share of points (N, 3) on the largest plane (Fischler & Bolles 1981)."""
    chosen = np.random.default_rng(0).integers(len(points), size=(_TRIALS, 3))
    a, b, c = np.moveaxis(points[chosen], 1, 0)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals, a = normals[length > 0.0] / length[length > 0.0, None], a[length > 0.0]
    if len(normals) == 0:
        return 1.0
    distance = np.abs(points @ normals.T - np.sum(a * normals, axis=1))
    return float((distance < _PLANE_TOLERANCE * points[:, 2:]).mean(axis=0).max())


def _relative_gradient(color: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Gradient of an image relative to its mean around, (h, w) float32, of the size of :func:`small_gray`."""
    gray = small_gray(color).astype(np.float32)
    gradient = np.hypot(cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1))
    around = cv2.blur(gradient, (_NEIGHBOURHOOD_PX, _NEIGHBOURHOOD_PX))
    return np.asarray(gradient / np.maximum(around, 1e-3), dtype=np.float32)


def front_edges(depth_m: NDArray[np.float32]) -> NDArray[np.int64]:
    """Pixels (E, 2), x and y, of a depth image (H, W) beside which a farther surface begins, or behind a narrow hole.

    Stereo cameras leave such holes along the edges of what is in front.
    """
    step = max(1, depth_m.shape[1] // _EDGE_WIDTH)
    depth = depth_m[::step, ::step]
    marked = np.zeros(depth.shape, dtype=np.bool_)
    for turns in range(4):
        marked |= np.rot90(_before_farther(np.rot90(depth, turns), round(_HOLE * depth.shape[1])), -turns)
    return np.asarray(np.argwhere(marked)[:, ::-1] * step)


def _before_farther(depth: NDArray[np.float32], hole_px: int) -> NDArray[np.bool_]:
    """Pixels (H, W) whose next depth to the right, at most so many pixels away, is that of a farther surface."""
    count = depth.shape[1]
    columns = np.arange(count, dtype=np.int32)
    known = np.where(depth > 0.0, columns, np.int32(count))
    following = np.full_like(known, count)
    following[:, :-1] = np.minimum.accumulate(known[:, :0:-1], axis=1)[:, ::-1]
    beyond = np.take_along_axis(depth, np.minimum(following, count - 1), axis=1)
    is_near = (following < count) & (following - columns <= hole_px + 1)
    return np.asarray((depth > 0.0) & is_near & (beyond > (1.0 + _EDGE) * depth))


class _Alignment:
    """How well depth's edges lie on those of the images.

    Attributes:
        stated: mean relative gradient at depth's edges; None if too few frames have edges.
        misfit: how the edges fit much better, if the depth is not registered; else None.
        zoom: that of the best zoom and shift, if it is this that fits; else None.
    """

    def __init__(
        self, recording: Recording, depths: list[NDArray[np.float32]], images: list[NDArray[np.float32]]
    ) -> None:
        edges = [front_edges(depth) for depth in depths]
        seen = [(xy, image) for xy, image in zip(edges, images, strict=True) if len(xy) >= _LEAST_EDGES]
        self.stated: float | None = None
        self.misfit: str | None = None
        self.zoom: float | None = None
        if len(seen) < _LEAST_FRAMES:
            return
        self._camera = recording.camera
        self._edges, self._shapes = [xy for xy, _ in seen], [image.shape for _, image in seen]
        self._spectra = [spectrum(np.pad(image, _SEARCH_PX, mode="edge"), image.shape) for _, image in seen]
        stated = self._strength(self._edges)
        self.stated = float(_around(stated, 1).max())
        zoom, of_zoom = self._best_zoom()
        found = {what: float(self._strength(self._flipped(*sides)).max()) for what, sides in _FLIPS.items()}
        found |= {self._shift_words(stated): float(stated.max()), f"{zoom:.2f} times as wide": of_zoom}
        best = max(found, key=lambda what: found[what])
        # Where all frames are of one view, its edges fit well somewhere nearby by chance.
        if found[best] > _GAIN * float(_around(stated, _LEAST_SHIFT_PX - 1).max()):
            self.misfit, self.zoom = best, zoom if found[best] == of_zoom else None

    def _best_zoom(self) -> tuple[float, float]:
        """The best of the zooms that differ from 1, about the principal point, and its strength at the best shift."""
        zooms = _ZOOMS[np.abs(_ZOOMS - 1.0) >= _LEAST_ZOOM - 1e-6]
        centre = np.array([self._camera.cx, self._camera.cy])
        best = [float(self._strength([(xy - centre) * zoom + centre for xy in self._edges]).max()) for zoom in zooms]
        return float(zooms[int(np.argmax(best))]), max(best)

    def _flipped(self, sideways: bool, upright: bool) -> list[FloatArray]:
        """The edges, with the image's sides exchanged."""
        last = np.array([self._camera.width - 1.0, self._camera.height - 1.0])
        return [np.where([sideways, upright], last - xy, xy) for xy in self._edges]

    def _shift_words(self, stated: NDArray[np.float32]) -> str:
        row, column = np.unravel_index(int(np.argmax(stated)), stated.shape)
        per_px = self._camera.width / self._shapes[0][1]
        x, y = (round((int(at) - _SEARCH_PX) * per_px) for at in (column, row))
        return f"moved by ({x}, {y}) pixels"

    def _strength(self, edges: Sequence[NDArray[np.int64] | FloatArray]) -> NDArray[np.float32]:
        """Mean relative gradient at edges (E, 2) of each frame, for each shift of the search; 0 with few inside."""
        inside = [self._edge_pixels(xy, shape) for xy, shape in zip(edges, self._shapes, strict=True)]
        weights = [_weights(flat, shape) for flat, shape in zip(inside, self._shapes, strict=True)]
        strength = mean_correlation(self._spectra, weights)
        return strength if sum(map(len, inside)) >= _LEAST_FRAMES * _LEAST_EDGES else np.zeros_like(strength)

    def _edge_pixels(self, xy: NDArray[np.int64] | FloatArray, shape: tuple[int, ...]) -> NDArray[np.int64]:
        """Pixels of an image (h, w), counted by rows, of edges (E, 2)."""
        factor = shape[1] / self._camera.width
        moved = np.round((xy + 0.5) * factor - 0.5).astype(np.int64)
        inside = (moved >= 0).all(axis=1) & (moved < [shape[1], shape[0]]).all(axis=1)
        return np.asarray(np.ravel_multi_index((moved[inside, 1], moved[inside, 0]), shape))


def _around(strength: NDArray[np.float32], reach_px: int) -> NDArray[np.float32]:
    """The part of the search, (2 S + 1, 2 S + 1), that shifts by so many pixels at most."""
    return strength[
        _SEARCH_PX - reach_px : _SEARCH_PX + reach_px + 1, _SEARCH_PX - reach_px : _SEARCH_PX + reach_px + 1
    ]


def _weights(flat: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Share of the edges in each pixel of an image (h, w)."""
    counts = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)
    return np.asarray(counts / max(1, len(flat)), dtype=np.float32)


def spectrum(values: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Fourier transform of an array, filled up with zeros beyond an image's shape (h, w) widened by the search."""
    rows, columns = (cv2.getOptimalDFTSize(side + 2 * _SEARCH_PX) for side in shape)
    filled = np.zeros((rows, columns), dtype=np.float32)
    filled[: values.shape[0], : values.shape[1]] = values
    return np.asarray(cv2.dft(filled), dtype=np.float32)


def mean_correlation(spectra: list[NDArray[np.float32]], weights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Mean over images of the sum of pixels times weights, for each shift of the search: (2 S + 1, 2 S + 1).

    By the correlation theorem, one inverse transform serves all images.

    Args:
        spectra: of the images, widened by the search on every side.
        weights: (h, w) of each image.
    """
    total = np.zeros_like(spectra[0])
    for image, weight in zip(spectra, weights, strict=True):
        total += cv2.mulSpectrums(image, spectrum(weight, weight.shape), 0, conjB=True)
    shifts, side = cv2.idft(total, flags=cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT), 2 * _SEARCH_PX + 1
    return np.asarray(shifts[:side, :side] / len(spectra), dtype=np.float32)
