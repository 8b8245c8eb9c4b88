"""Views of rooms in which every part is drawn as its box, by NumPy alone: depth buffer, then textures.

A picture takes a quarter of a second, which path tracing exceeds by far. Light is a fixed shade of each face: there
are no shadows, no reflections and no exposure. Cylinders and ellipsoids are boxes. So it serves where rooms are
distinguished, not where depth or light are studied.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, transform
from monoloc_lab.synth.materials import Material
from monoloc_lab.synth.rooms import Part, Room
from monoloc_lab.synth.textures import ATLAS_CELLS, texture

_NEAREST_M = 0.05
_FINER = 1.25  # times as many pixels a side as the picture has, so that edges are smoother
_SIZE, _LEVELS = 512, 9  # of a texture, and of its pyramid (Williams 1983): 512 to 2 pixels
_OFFSETS = np.cumsum([0, *((_SIZE >> level) ** 2 for level in range(_LEVELS - 1))])
_PYRAMID = int(_OFFSETS[-1] + (_SIZE >> (_LEVELS - 1)) ** 2)  # pixels of all levels
_KEPT = 300  # textures, 1 MB each, for the next rooms
_LIGHT = np.array([0.35, -0.5, 0.79])  # direction towards it, world frame
_AMBIENT, _DIRECTED = 0.62, 0.33

# Of a box: each face's normal and the axes along its edges, with their signs.
_FACES = [
    (axis, sign, first, second) for axis, first, second in ((0, 1, 2), (1, 0, 2), (2, 0, 1)) for sign in (-1.0, 1.0)
]


class BoxView:
    """Draws placed rooms.

    Args:
        rooms: each with its ``T_world_room``, (4, 4).
    """

    def __init__(self, rooms: Sequence[tuple[Room, FloatArray]]) -> None:
        self._textures: dict[Material, int] = {}
        corners, edges, spans, numbers = [], [], [], []
        for room, T_world_room in rooms:
            for thing in room.objects:
                for part in thing.parts:
                    for corner, edge, span in _faces(part, T_world_room @ thing.pose @ part.pose):
                        corners.append(corner)
                        edges.append(edge)
                        spans.append(span)
                        numbers.append(self._textures.setdefault(part.material, len(self._textures)))
        self._corners, self._edges = np.array(corners), np.array(edges)  # (F, 3), (F, 2, 3)
        self._spans, self._numbers = np.array(spans), np.array(numbers)  # (F, 4) first and last u, v; (F,)
        self._pyramids = np.concatenate([_pyramid(material) for material in self._textures])
        normals = np.cross(self._edges[:, 0], self._edges[:, 1])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        shines = np.array([material.group is not None for material in self._textures])[self._numbers]
        shade = _AMBIENT + _DIRECTED * np.abs(normals @ _LIGHT) * np.where(normals @ _LIGHT > 0.0, 1.0, 0.6)
        self._shades = np.where(shines, 1.0, shade)

    def __call__(self, camera: Camera, T_world_camera: FloatArray) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Colour (H, W, 3) RGB, and depth (H, W), metres, 0 where nothing is."""
        fine = camera.resized(round(_FINER * camera.width), round(_FINER * camera.height))
        depth, face = self._hit(fine, T_world_camera)
        color = self._shaded(fine, T_world_camera, depth, face)
        size = (camera.width, camera.height)
        small = cv2.resize(color, size, interpolation=cv2.INTER_AREA)
        seen = np.where(face >= 0, depth, 0.0).astype(np.float32)
        seen = np.asarray(cv2.resize(seen, size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
        return np.round(small).astype(np.uint8), seen

    def _hit(self, camera: Camera, T_world_camera: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Depth and number of the nearest face at each pixel, (H, W) each; infinity and -1 where there is none."""
        T_camera_world = invert(T_world_camera)
        corners = transform(T_camera_world, self._corners)
        edges = self._edges @ T_camera_world[:3, :3].T
        normals = np.cross(edges[:, 0], edges[:, 1])
        offsets = np.einsum("fi,fi->f", normals, corners)
        quads = corners[:, None] + np.stack(
            [np.zeros_like(edges[:, 0]), edges[:, 0], edges.sum(axis=1), edges[:, 1]], 1
        )
        windows = _windows(quads, camera)
        rays = camera.pixel_rays().reshape(camera.height, camera.width, 3)
        depth = np.full((camera.height, camera.width), np.inf)
        face = np.full((camera.height, camera.width), -1, dtype=np.int64)
        before_camera = quads[..., 2].max(axis=1) > _NEAREST_M
        for number in np.flatnonzero((offsets < 0.0) & before_camera).tolist():  # normals point outwards
            left, top, right, bottom = windows[number].tolist()
            if right <= left or bottom <= top:
                continue
            window = slice(top, bottom), slice(left, right)
            ray = rays[window]
            with np.errstate(divide="ignore", invalid="ignore"):
                z = offsets[number] / (ray @ normals[number])
            local = z[..., None] * ray - corners[number]
            first, second = edges[number]
            u, v = local @ (first / (first @ first)), local @ (second / (second @ second))
            hit = (z > _NEAREST_M) & (z < depth[window]) & (u >= 0.0) & (u <= 1.0) & (v >= 0.0) & (v <= 1.0)
            depth[window][hit], face[window][hit] = z[hit], number
        return depth, face

    def _shaded(
        self, camera: Camera, T_world_camera: FloatArray, depth: FloatArray, face: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        """Colour of each pixel, (H, W, 3), 0 to 255, with the texture's level that its footprint asks for."""
        shape, face, z = face.shape, face.ravel(), depth.ravel()
        seen = np.flatnonzero(face >= 0)
        face, z = face[seen], z[seen]
        points = transform(T_world_camera, z[:, None] * camera.pixel_rays().reshape(-1, 3)[seen])
        local = points - self._corners[face]
        # u and v are linear in the place on a face.
        lengths = np.linalg.norm(self._edges, axis=2)
        periods = self._spans[:, 2:] - self._spans[:, :2]
        slopes = self._edges * (periods / lengths**2)[..., None]
        uv = self._spans[face, :2] + np.einsum("ni,nci->nc", local, slopes[face])
        texels = (_SIZE * np.abs(periods) / lengths).max(axis=1)  # a metre
        level = np.log2(np.maximum(texels[face] * z / camera.focal_px, 1.0))
        level = np.clip(np.round(level).astype(np.int64), 0, _LEVELS - 1)
        color = np.zeros((depth.size, 3), dtype=np.float32)
        color[seen] = self._sampled(self._numbers[face], level, uv) * self._shades[face, None]
        return color.reshape(*shape, 3)

    def _sampled(self, number: NDArray[np.int64], level: NDArray[np.int64], uv: FloatArray) -> NDArray[np.float32]:
        """Bilinear samples of textures at levels and coordinates (N, 2) in periods, (N, 3)."""
        size = _SIZE >> level
        place = uv % 1.0 * size[:, None] - 0.5
        low = np.floor(place).astype(np.int64)
        share = (place - low).astype(np.float32)
        start = number * _PYRAMID + _OFFSETS[level]
        sampled = np.zeros((len(uv), 3), dtype=np.float32)
        for right in (0, 1):
            for down in (0, 1):
                column, row = (low[:, 0] + right) % size, (low[:, 1] + down) % size
                weight = (share[:, 0] if right else 1.0 - share[:, 0]) * (share[:, 1] if down else 1.0 - share[:, 1])
                sampled += weight[:, None] * self._pyramids[start + row * size + column]
        return sampled


def _faces(part: Part, T_world_part: FloatArray) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Corner (3,), edges (2, 3) and first and last u and v (4,) of the faces of a part, world frame."""
    half, rotation, centre = np.array(part.size) / 2.0, T_world_part[:3, :3], T_world_part[:3, 3]
    found = []
    for axis, sign, first, second in _FACES:
        if min(half[first], half[second]) <= 0.0 or (part.shape == "panel" and (axis, sign) != (1, -1.0)):
            continue
        corner, edges = np.zeros(3), np.zeros((2, 3))
        corner[axis] = sign * half[axis]
        corner[first], corner[second] = -half[first], half[second]
        edges[0, first], edges[1, second] = 2.0 * half[first], -2.0 * half[second]  # v runs down
        if np.cross(edges[0], edges[1])[axis] * sign < 0.0:  # the normal points outwards
            corner[first] = half[first]
            edges[0] *= -1.0
        span = _span(part, 2.0 * half[first], 2.0 * half[second])
        found.append((rotation @ corner + centre, edges @ rotation.T, span))
    return found


def _span(part: Part, width: float, height: float) -> FloatArray:
    """First u and v, last u and v of a face, in periods of the texture."""
    if part.cell is not None:
        row, column = divmod(part.cell, ATLAS_CELLS)
        return np.array([column, row, column + 1.0, row + 1.0]) / ATLAS_CELLS
    if part.material.repeat_m > 0.0:
        shift = np.array([0.37, 0.61]) * (np.sum(np.array(part.centre)) * 7.0 % 1.0)  # as in scene.py
        return np.concatenate([shift, shift + np.array([width, height]) / part.material.repeat_m])
    return np.array([0.0, 0.0, 1.0, 1.0])


@lru_cache(maxsize=_KEPT)
def _pyramid(material: Material) -> NDArray[np.uint8]:
    """A texture at all levels, one after another, (P, 3)."""
    image = np.round(255.0 * texture(material)).astype(np.uint8)
    small = cv2.resize(image, (_SIZE, _SIZE), interpolation=cv2.INTER_AREA)
    levels: list[NDArray[np.uint8]] = [np.asarray(small, np.uint8)]
    while len(levels) < _LEVELS:
        size = levels[-1].shape[0] // 2
        levels.append(np.asarray(cv2.resize(levels[-1], (size, size), interpolation=cv2.INTER_AREA), np.uint8))
    return np.concatenate([level.reshape(-1, 3) for level in levels])


def _windows(quads: FloatArray, camera: Camera) -> NDArray[np.int64]:
    """Left, top, right and bottom pixels that quads (F, 4, 3), camera frame, may cover, (F, 4); empty out of view."""
    ends = np.zeros((len(quads), 4))
    nearest, farthest = quads[..., 2].min(axis=1), quads[..., 2].max(axis=1)
    whole = np.flatnonzero(nearest > _NEAREST_M)
    pixels = camera.project(quads[whole].reshape(-1, 3)).reshape(-1, 4, 2)
    ends[whole] = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
    for number in np.flatnonzero((nearest <= _NEAREST_M) & (farthest > _NEAREST_M)):
        clipped = camera.project(_clipped(quads[number]))
        ends[number] = *clipped.min(axis=0), *clipped.max(axis=0)
    limits = np.array([camera.width, camera.height, camera.width, camera.height])
    ends[:, 2:] += 1.0
    return np.clip(np.floor(ends), 0, limits).astype(np.int64)


def _clipped(quad: FloatArray) -> FloatArray:
    """The corners of what of a polygon (N, 3) lies before the camera (Sutherland and Hodgman 1974)."""
    kept = []
    for here, following in zip(quad, np.roll(quad, -1, axis=0), strict=True):
        if here[2] > _NEAREST_M:
            kept.append(here)
        if (here[2] > _NEAREST_M) != (following[2] > _NEAREST_M):
            kept.append(here + (_NEAREST_M - here[2]) / (following[2] - here[2]) * (following - here))
    return np.array(kept)
