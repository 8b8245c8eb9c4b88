"""Procedural textures. All tile, except those that cover a face once."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc_lab.synth.materials import Color, Material

Image = NDArray[np.float32]  # (H, W, 3), sRGB, 0 to 1
Grey = NDArray[np.float32]  # (H, W)

_SIZE = 512
ATLAS_CELLS = 8  # cells per side of an atlas texture


def texture(material: Material) -> Image:
    """The material's pattern, (H, W, 3) float32 sRGB from 0 to 1; row 0 is the top."""
    rng = np.random.default_rng(material.seed)
    image = TEXTURES[material.texture](_color(material.color), _color(material.accent), rng)
    return np.clip(image, 0.0, 1.0).astype(np.float32)


def _color(color: Color) -> NDArray[np.float32]:
    return np.array(color, dtype=np.float32)


def _mix(color: NDArray[np.float32], accent: NDArray[np.float32], share: Grey) -> Image:
    return np.asarray(color + share[..., None] * (accent - color), dtype=np.float32)


def noise(rng: np.random.Generator, sigma_x: float, sigma_y: float, size: int = _SIZE) -> Grey:
    """Tiling Gaussian noise of unit variance, smoothed by a number of pixels; drawn in the frequency domain."""
    fy, fx = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None]
    filter_ = np.exp(-2.0 * np.pi**2 * ((sigma_x * fx) ** 2 + (sigma_y * fy) ** 2))
    spectrum = np.fft.rfft2(rng.standard_normal((size, size))) * filter_
    spectrum[0, 0] = 0.0
    smooth = np.fft.irfft2(spectrum, (size, size))
    return np.asarray(smooth / smooth.std(), dtype=np.float32)


def _plain(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    return np.broadcast_to(color, (4, 4, 3)).astype(np.float32)


def _plaster(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    grain = 0.5 * noise(rng, 1.0, 1.0) + 0.8 * noise(rng, 5.0, 5.0) + 1.2 * noise(rng, 60.0, 60.0)
    return np.asarray(color * (1.0 + 0.014 * grain[..., None]), dtype=np.float32)


def _wood(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """Wood grain along u: rings as bent stripes, with pores."""
    v = np.arange(_SIZE, dtype=np.float32)[:, None] / _SIZE
    bend = 0.05 * noise(rng, 90.0, 20.0) + 0.008 * noise(rng, 30.0, 4.0)
    rings = 0.5 + 0.5 * np.sin(2.0 * np.pi * (9.0 * v + 9.0 * bend))
    pores = noise(rng, 14.0, 0.7)
    tone = noise(rng, 120.0, 40.0)
    share = np.clip(0.15 + 0.45 * rings**2 + 0.10 * pores + 0.12 * tone, 0.0, 1.0)
    return _mix(color, accent, share)


def _boards(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """A floor of boards along u with different tones and dark joints."""
    image = np.empty((_SIZE, _SIZE, 3), dtype=np.float32)
    rows, grain = 8, _wood(color, accent, rng)
    height = _SIZE // rows
    for row in range(rows):
        shift = int(rng.integers(_SIZE))
        for start in (0, _SIZE // 2):
            tone = 1.0 + 0.09 * rng.standard_normal()
            piece = np.roll(grain, int(rng.integers(_SIZE)), axis=(0, 1))[:height, : _SIZE // 2] * tone
            piece[:2] *= 0.55
            piece[:, :2] *= 0.6
            columns = (start + shift + np.arange(_SIZE // 2)) % _SIZE
            image[row * height : (row + 1) * height, columns] = piece
    return image


def _tiles(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """Square tiles with joints."""
    tiles = 4
    side = _SIZE // tiles
    tone = 1.0 + 0.03 * rng.standard_normal((tiles, tiles)).astype(np.float32)
    field = np.kron(tone, np.ones((side, side), np.float32)) * (1.0 + 0.02 * noise(rng, 12.0, 12.0))
    place = np.arange(_SIZE) % side
    joint = (place < 4)[:, None] | (place < 4)[None]
    return np.where(joint[..., None], accent, color * field[..., None]).astype(np.float32)


def _brick(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """Running bond: ``color`` bricks in ``accent`` mortar."""
    rows, columns = 12, 4
    v, u = np.mgrid[0:_SIZE, 0:_SIZE].astype(np.float32) / _SIZE
    wobble = 0.0015 * noise(rng, 6.0, 6.0)
    row = np.floor((v + wobble) % 1.0 * rows).astype(int) % rows
    along = (u + wobble) * columns + 0.5 * (row % 2)
    column = np.floor(along).astype(int) % columns
    tone = 1.0 + 0.13 * rng.standard_normal((rows, columns)).astype(np.float32)
    field = tone[row, column] * (1.0 + 0.06 * noise(rng, 2.0, 2.0))
    across, vertical = along % 1.0, (v + wobble) % 1.0 * rows % 1.0
    joint = (across < 0.045) | (vertical < 0.13)
    brick = color * field[..., None] + 0.02 * noise(rng, 20.0, 20.0)[..., None]
    return np.where(joint[..., None], accent * (1.0 + 0.05 * noise(rng, 1.0, 1.0)[..., None]), brick)


def _fabric(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """A plain weave of uneven yarn."""
    v, u = np.mgrid[0:_SIZE, 0:_SIZE]
    over = ((u // 4 + v // 4) % 2).astype(np.float32)
    share = 0.25 + 0.3 * over + 0.12 * noise(rng, 24.0, 0.8) + 0.12 * noise(rng, 0.8, 24.0) + 0.1 * noise(rng, 40, 40)
    return _mix(color, accent, np.clip(share, 0.0, 1.0))


def _stripes(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """Curtains and cushions: vertical stripes of uneven width on a weave."""
    edges = np.sort(rng.uniform(0.0, 1.0, 2 * int(rng.integers(3, 7))))
    u = np.arange(_SIZE) / _SIZE
    inside = (np.searchsorted(edges, u) % 2).astype(np.float32)
    share = (
        np.broadcast_to(inside, (_SIZE, _SIZE)) * 0.8 + 0.05 * noise(rng, 0.8, 30.0) + 0.05 * noise(rng, 12.0, 0.8)
    )
    return _mix(color, accent, np.clip(share, 0.0, 1.0))


def _carpet(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """A woven carpet: border bands and a repeated, mirrored figure; covers its face once."""
    v, u = np.abs(np.mgrid[0:_SIZE, 0:_SIZE].astype(np.float32) / (_SIZE - 1) * 2.0 - 1.0)
    tile = 64
    figure = (noise(rng, 4.0, 4.0, tile) > 0.35).astype(np.float32)
    figure = np.maximum(figure, figure[:, ::-1])
    figure = np.maximum(figure, figure[::-1])
    field = np.tile(figure, (_SIZE // tile, _SIZE // tile))
    rim = np.maximum(u, v)
    share = np.where(rim < 0.78, 0.55 * field, 0.0)
    share = np.where((rim > 0.80) & (rim < 0.84), 0.9, share)
    share = np.where((rim > 0.88) & (rim < 0.95), 0.65 - 0.4 * field, share)
    share = share + 0.07 * noise(rng, 1.0, 1.0) + 0.05 * noise(rng, 30.0, 30.0)
    return _mix(color, accent, np.clip(share, 0.0, 1.0))


def _leaves(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    share = 0.5 + 0.25 * noise(rng, 10.0, 3.0) + 0.15 * noise(rng, 40.0, 40.0)
    return _mix(color, accent, np.clip(share, 0.0, 1.0))


def _lines_of_text(image: Image, ink: NDArray[np.float32], rng: np.random.Generator, area: tuple[int, ...]) -> None:
    """Lines of text as dashes of uneven length, drawn into an image."""
    top, bottom, left, right, line = area
    for y in range(top, bottom - line // 2, line):
        x = left
        stop = right - int(rng.integers(0, max(1, (right - left) // 3)))
        while x < stop:
            length = int(rng.integers(line // 2, 4 * line))
            cv2.rectangle(image, (x, y), (min(x + length, stop), y + max(1, line // 2 - 1)), ink.tolist(), -1)
            x += length + line // 2


def _landscape(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """A landscape of hills under a sky, without its frame."""
    v = np.linspace(0.0, 1.0, _SIZE, dtype=np.float32)[:, None]
    image = _mix(color, np.array([0.95, 0.9, 0.82], np.float32), np.broadcast_to(v, (_SIZE, _SIZE)) ** 1.5)
    image += 0.06 * np.clip(noise(rng, 70.0, 16.0), 0.0, 2.0)[..., None] * (1.0 - v[..., None])
    for layer in range(4):
        depth = (layer + 1) / 4.0
        ridge = 0.38 + 0.14 * layer + 0.07 * noise(rng, 40.0 / depth, 1.0)[0] + 0.01 * noise(rng, 3.0, 1.0)[1]
        hill = accent * (1.15 - 0.75 * depth) + np.array([0.08, 0.1, 0.14], np.float32) * (1.0 - depth)
        ground = hill * (1.0 + 0.12 * noise(rng, 3.0, 2.0)[..., None])
        image = np.where((v > ridge[None])[..., None], ground, image)
    return image.astype(np.float32)


def _poster(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """A printed poster: paper, a few large shapes, a title and small lines."""
    image = np.ascontiguousarray(np.broadcast_to(np.array([0.93, 0.91, 0.86], np.float32), (_SIZE, _SIZE, 3)))
    for tone in (color, accent, 0.5 * (color + accent), 0.35 * accent):
        x, y = (int(c) for c in rng.integers(80, 430, 2))
        r = int(rng.integers(50, 150))
        if rng.uniform() < 0.5:
            cv2.circle(image, (x, min(y, 300)), r, tone.tolist(), -1, cv2.LINE_AA)
        else:
            corners = np.array([x, min(y, 300)]) + rng.uniform(-r, r, (3, 2))
            cv2.fillPoly(image, [corners.astype(np.int32)], tone.tolist(), cv2.LINE_AA)
    ink = np.array([0.12, 0.12, 0.14], np.float32)
    _lines_of_text(image, ink, rng, (390, 430, 40, 480, 34))
    _lines_of_text(image, ink, rng, (440, 490, 40, 440, 11))
    return image * (1.0 + 0.01 * noise(rng, 1.0, 1.0)[..., None])


def _books(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """An atlas of book spines, one per cell: cloth, bands and a title."""
    side = _SIZE // ATLAS_CELLS
    image = np.empty((_SIZE, _SIZE, 3), dtype=np.float32)
    for row in range(ATLAS_CELLS):
        for column in range(ATLAS_CELLS):
            hue, saturation, value = rng.uniform(0.0, 1.0), rng.uniform(0.05, 0.6), rng.uniform(0.12, 0.85)
            ground = hsv(hue, saturation, value)
            ink = hsv(rng.uniform(), 0.3, 0.9 if value < 0.5 else 0.15)
            cell = np.ascontiguousarray(np.broadcast_to(ground, (side, side, 3)))
            for y in rng.integers(2, side - 6, 2):
                cell[y : y + int(rng.integers(1, 4))] = ink
            _lines_of_text(cell, ink, rng, (14, 14 + int(rng.integers(10, 34)), 18, 46, 7))
            image[row * side : (row + 1) * side, column * side : (column + 1) * side] = cell
    return image * (1.0 + 0.03 * noise(rng, 1.0, 1.0)[..., None])


def _screen(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """A page on a computer screen."""
    image = np.ascontiguousarray(np.broadcast_to(color, (_SIZE, _SIZE, 3)).astype(np.float32))
    cv2.rectangle(image, (0, 0), (_SIZE, 40), (0.5 * accent).tolist(), -1)
    _lines_of_text(image, accent, rng, (70, 480, 30, 330, 18))
    cv2.rectangle(image, (360, 80), (490, 240), (0.6 * color + 0.4 * accent).tolist(), -1)
    return image


def _outdoors(color: NDArray[np.float32], accent: NDArray[np.float32], rng: np.random.Generator) -> Image:
    """The view from a window: an overcast sky, trees, a street below; in linear light."""
    v = np.linspace(0.0, 1.0, _SIZE, dtype=np.float32)[:, None]
    image = np.broadcast_to(color * (1.0 - 0.25 * v[..., None]), (_SIZE, _SIZE, 3)).astype(np.float32)
    image = image * (1.0 + 0.05 * noise(rng, 60.0, 20.0)[..., None])
    for height, tone in ((0.62, 0.28), (0.74, 0.16)):
        crowns = height + 0.05 * noise(rng, 22.0, 1.0)[0] + 0.015 * noise(rng, 4.0, 1.0)[1]
        leaves = accent * tone * (1.0 + 0.25 * noise(rng, 3.0, 3.0)[..., None])
        image = np.where((v > crowns[None])[..., None], leaves, image)
    return image.astype(np.float32)


def hsv(hue: float, saturation: float, value: float) -> NDArray[np.float32]:
    """A colour from hue, saturation and value, 0 to 1, as sRGB (3,)."""
    pixel = np.array([[[360.0 * hue, saturation, value]]], dtype=np.float32)
    return np.asarray(cv2.cvtColor(pixel, cv2.COLOR_HSV2RGB)[0, 0], dtype=np.float32)


TEXTURES: dict[str, Callable[[NDArray[np.float32], NDArray[np.float32], np.random.Generator], Image]] = {
    "plain": _plain,
    "plaster": _plaster,
    "wood": _wood,
    "boards": _boards,
    "tiles": _tiles,
    "brick": _brick,
    "fabric": _fabric,
    "stripes": _stripes,
    "carpet": _carpet,
    "leaves": _leaves,
    "landscape": _landscape,
    "poster": _poster,
    "books": _books,
    "screen": _screen,
    "outdoors": _outdoors,
}
