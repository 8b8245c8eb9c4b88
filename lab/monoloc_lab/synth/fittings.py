"""Fittings of a room: walls with openings, windows, doors, lamps, pictures, plants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc_lab.synth.furniture import Parts, a_color, box, rod
from monoloc_lab.synth.materials import BLACK_PLASTIC, METAL, Material, lacquer
from monoloc_lab.synth.rooms import Part

WALL_M = 0.24  # thickness of outer walls, and so depth of a window reveal
_WARM = (1.0, 0.86, 0.68)  # of lamps
_WHITE = (0.87, 0.87, 0.85)


@dataclass(frozen=True)
class Opening:
    """An opening in a wall, seen from inside.

    Attributes:
        middle: its centre along the wall, from the centre of the wall to the right, metres.
        width: metres.
        bottom, top: above the floor, metres.
        is_passage: whether nothing closes it.
    """

    middle: float
    width: float
    bottom: float
    top: float
    is_passage: bool = False


def wall(width: float, height: float, openings: tuple[Opening, ...], surface: Material, skirting: Material) -> Parts:
    """A wall whose inner face is at y = 0, with openings, and with skirting between doors."""
    parts: list[Part] = []
    left = -width / 2.0 - WALL_M
    base = -width / 2.0
    for opening in (*sorted(openings, key=lambda o: o.middle), None):
        edge = opening.middle - opening.width / 2.0 if opening else width / 2.0 + WALL_M
        parts.append(
            box((edge - left, WALL_M, height), ((left + edge) / 2.0, WALL_M / 2.0, height / 2.0), surface, 0)
        )
        if opening is None:
            parts.append(_skirting(base, width / 2.0, skirting))
            break
        right = opening.middle + opening.width / 2.0
        if opening.bottom > 0.0:
            size = (opening.width, WALL_M, opening.bottom)
            parts.append(box(size, (opening.middle, WALL_M / 2.0, opening.bottom / 2.0), surface, 0))
        else:
            parts.append(_skirting(base, edge - 0.09, skirting))
            base = right + 0.09
        size = (opening.width, WALL_M, height - opening.top)
        parts.append(box(size, (opening.middle, WALL_M / 2.0, (height + opening.top) / 2.0), surface, 0))
        left = right
    return tuple(parts)


def _skirting(left: float, right: float, material: Material) -> Part:
    return box((right - left, 0.014, 0.07), ((left + right) / 2.0, -0.007, 0.035), material, 0.003)


def window(opening: Opening, panes: int, sky: float, seed: int) -> Parts:
    """Frame, sill, and a luminous picture of the outdoors behind the glass."""
    frame, y, bar = lacquer(_WHITE), WALL_M - 0.06, 0.06
    width, height = opening.width, opening.top - opening.bottom
    middle, z = opening.middle, (opening.top + opening.bottom) / 2.0
    outdoors = Material(
        "outdoors", (1.0, 1.02, 1.06), (0.5, 0.62, 0.35), 0.0, seed=seed, group="daylight", luminance=sky
    )
    # One face only: textured lights are sampled by texture coordinates, which must be unique.
    parts = [Part("panel", (width, 0.0, height), (middle, WALL_M - 0.01, z), outdoors)]
    for s in (-1, 1):
        parts.append(box((width, 0.06, bar), (middle, y, z + s * (height - bar) / 2.0), frame))
    for index in range(panes + 1):
        x = middle + (index / panes - 0.5) * (width - bar)
        parts.append(box((bar, 0.06, height - 2.0 * bar), (x, y, z), frame))
    parts.append(box((width + 0.1, WALL_M - 0.05, 0.03), (middle, 0.06, opening.bottom + 0.015), frame, 0.008))
    return tuple(parts)


def radiator(width: float) -> Parts:
    """A panel radiator below a window; the face of the wall is at y = 0."""
    height = 0.55
    enamel = lacquer((0.88, 0.88, 0.86))
    ribs = [box((0.03, 0.012, height - 0.06), (x, -0.104, 0.14 + height / 2.0), enamel) for x in _ribs(width)]
    return (box((width, 0.05, height), (0.0, -0.07, 0.14 + height / 2.0), enamel, 0.01), *ribs)


def _ribs(width: float) -> list[float]:
    return [float(x) for x in np.arange(-width / 2.0 + 0.05, width / 2.0 - 0.04, 0.06)]


def door(opening: Opening, leaf: Material) -> Parts:
    """A closed door in its frame, with two panels and a handle; the face of the wall is at y = 0."""
    frame = lacquer(_WHITE)
    middle, width, height = opening.middle, opening.width, opening.top
    parts = [box((width, 0.045, height), (middle, 0.045, height / 2.0), leaf)]
    for z, tall in ((0.52, 0.72), (1.43, 0.82)):
        parts.append(box((width - 0.26, 0.012, tall), (middle, 0.02, z * height / 2.02), leaf, 0.006))
    for s in (-1, 1):
        parts.append(box((0.09, 0.05, height + 0.09), (middle + s * (width / 2.0 + 0.045), 0.0, height / 2.0), frame))
    parts.append(box((width, 0.05, 0.09), (middle, 0.0, height + 0.045), frame))
    x = middle + width / 2.0 - 0.08
    parts.append(box((0.03, 0.05, 0.03), (x, 0.0, 1.02), METAL))
    parts.append(box((0.13, 0.018, 0.02), (x - 0.05, -0.03, 1.02), METAL, 0.005))
    parts.append(box((0.04, 0.012, 0.2), (x, 0.018, 0.98), METAL, 0.004))
    return tuple(parts)


def curtain(width: float, height: float, cloth: Material) -> Parts:
    """A curtain in folds; z = 0 is its lower hem."""
    fold = 0.07
    count = max(2, round(width / fold))
    return tuple(
        Part(
            "cylinder",
            (fold * 1.25, fold * (1.0 if index % 2 else 0.6), height),
            ((index - (count - 1) / 2.0) * width / count, 0.0, height / 2.0),
            cloth,
        )
        for index in range(count)
    )


def rail(width: float) -> Parts:
    """A curtain rail along x."""
    return (Part("cylinder", (0.022, 0.022, width), (0.0, 0.0, 0.0), METAL, (0.0, np.pi / 2.0, 0.0)),)


def picture(width: float, height: float, content: Material, frame: Material | None) -> Parts:
    """A poster or a framed picture on a wall at +y; the origin is its centre."""
    if frame is None:
        return (box((width, 0.003, height), (0.0, -0.002, 0.0), content, 0.0),)
    rim = 0.03
    rims = [box((width + 2.0 * rim, 0.025, rim), (0.0, -0.0125, s * (height + rim) / 2.0), frame) for s in (-1, 1)]
    rims += [box((rim, 0.025, height), (s * (width + rim) / 2.0, -0.0125, 0.0), frame) for s in (-1, 1)]
    return (box((width, 0.012, height), (0.0, -0.006, 0.0), content, 0.0), *rims)


def glow(lumens: float, area_m2: float) -> Material:
    """A uniform lamp surface with a luminous flux; a matt surface of luminance L emits pi L per square metre."""
    return Material("plain", _WARM, group="lamps", luminance=lumens / (np.pi * area_m2))


def pendant(drop: float, lumens: float) -> Parts:
    """A globe on a cord; the origin is its suspension point."""
    diameter = 0.28
    globe = glow(lumens, np.pi * diameter**2)
    return (
        rod(0.09, 0.03, (0.0, 0.0, -0.03), lacquer(_WHITE)),
        rod(0.012, drop, (0.0, 0.0, -0.03 - drop), BLACK_PLASTIC),
        Part("ellipsoid", (diameter,) * 3, (0.0, 0.0, -0.03 - drop - diameter / 2.0), globe),
    )


def floor_lamp() -> Parts:
    """A floor lamp 1.6 m high with a luminous cloth shade."""
    shade = glow(600.0, np.pi * 0.38 * 0.28)
    return (
        rod(0.28, 0.025, (0.0, 0.0, 0.0), METAL),
        rod(0.022, 1.32, (0.0, 0.0, 0.025), METAL),
        rod(0.44, 0.28, (0.0, 0.0, 1.34), shade, 0.72),
    )


def table_lamp(lumens: float, rng: np.random.Generator) -> Parts:
    """A table lamp 0.45 m high."""
    foot = Material("plain", a_color(rng), roughness=0.25)
    shade = glow(lumens, np.pi * 0.22 * 0.18)
    return (
        Part("ellipsoid", (0.15, 0.15, 0.2), (0.0, 0.0, 0.1), foot),
        rod(0.02, 0.09, (0.0, 0.0, 0.19), METAL),
        rod(0.25, 0.18, (0.0, 0.0, 0.27), shade, 0.7),
    )


def plant(height: float, rng: np.random.Generator) -> Parts:
    """A pot with a bush of long leaves."""
    pot = Material("plain", a_color(rng, 0.5, 0.75), roughness=0.5)
    leaf = Material("leaves", (0.13, 0.30, 0.12), (0.28, 0.44, 0.18), 0.2, 0.5, seed=int(rng.integers(1 << 16)))
    earth = Material("plaster", (0.16, 0.11, 0.08), repeat_m=0.2, roughness=1.0)
    pot_height, width = 0.3 * height, 0.26 * height + 0.06
    parts = [rod(width * 0.72, pot_height, (0.0, 0.0, 0.0), pot, 1.35)]
    parts.append(rod(width * 0.85, 0.01, (0.0, 0.0, pot_height), earth))
    for index in range(int(rng.integers(16, 26))):
        angle, lean = 2.4 * index + rng.uniform(-0.3, 0.3), rng.uniform(0.1, 0.85)
        length = (0.45 + 0.25 * rng.uniform()) * height
        axis = np.array([np.cos(angle), np.sin(angle), 0.0])
        across = np.array([-axis[1], axis[0], 0.0])
        root = np.array([0.0, 0.0, pot_height]) + 0.02 * axis
        centre = root + 0.5 * length * (np.sin(lean) * axis + np.cos(lean) * np.array([0.0, 0.0, 1.0]))
        x, y, z = (float(c) for c in centre)
        tilt = lean * across
        turn = (float(tilt[0]), float(tilt[1]), float(tilt[2]))
        parts.append(Part("ellipsoid", (0.09 * height, 0.03 * height, length), (x, y, z), leaf, turn))
    return tuple(parts)
