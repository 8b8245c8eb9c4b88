"""Furniture in common sizes; each function returns the parts of an object, in metres.

An object stands on z = 0, with its centre at the origin, its back towards +y and its front towards -y.
"""

from __future__ import annotations

import numpy as np

from monoloc_lab.synth.materials import BLACK_PLASTIC, CERAMIC, METAL, Color, Material, fabric, lacquer, wood
from monoloc_lab.synth.rooms import Part, Vector
from monoloc_lab.synth.textures import ATLAS_CELLS, hsv

Parts = tuple[Part, ...]

# Ground and grain of common woods, sRGB.
WOODS: tuple[tuple[Color, Color], ...] = (
    ((0.78, 0.63, 0.44), (0.62, 0.45, 0.28)),  # oak
    ((0.86, 0.76, 0.60), (0.76, 0.62, 0.44)),  # birch
    ((0.45, 0.29, 0.19), (0.30, 0.18, 0.11)),  # walnut
    ((0.62, 0.42, 0.27), (0.48, 0.29, 0.17)),  # cherry
)
CLOTHS: tuple[tuple[Color, Color], ...] = (
    ((0.45, 0.47, 0.50), (0.33, 0.35, 0.38)),
    ((0.36, 0.42, 0.40), (0.25, 0.31, 0.30)),
    ((0.62, 0.56, 0.47), (0.50, 0.44, 0.36)),
    ((0.30, 0.35, 0.46), (0.21, 0.25, 0.35)),
    ((0.55, 0.33, 0.25), (0.42, 0.24, 0.18)),
)


def a_wood(rng: np.random.Generator) -> Material:
    ground, grain = WOODS[rng.integers(len(WOODS))]
    return wood(ground, grain, int(rng.integers(1 << 16)))


def a_cloth(rng: np.random.Generator) -> Material:
    ground, yarn = CLOTHS[rng.integers(len(CLOTHS))]
    return fabric(ground, yarn, int(rng.integers(1 << 16)))


def a_color(rng: np.random.Generator, saturation: float = 0.5, value: float = 0.7) -> Color:
    """A random muted colour."""
    r, g, b = hsv(rng.uniform(), saturation * rng.uniform(0.4, 1.0), value * rng.uniform(0.6, 1.1))
    return (float(r), float(g), float(b))


def box(size: Vector, centre: Vector, material: Material, bevel_m: float = 0.004, cell: int | None = None) -> Part:
    return Part("box", size, centre, material, bevel_m=bevel_m, cell=cell)


def rod(width: float, height: float, foot: Vector, material: Material, taper: float = 1.0) -> Part:
    """A vertical cylinder whose lower end is at ``foot``."""
    x, y, z = foot
    return Part("cylinder", (width, width, height), (x, y, z + height / 2.0), material, taper=taper)


def table(width: float, depth: float, height: float, top: Material, frame: Material) -> Parts:
    """A table with four legs; dining tables are 0.72 to 0.76 m high, coffee tables 0.40 to 0.45 m."""
    leg, thick, inset = 0.055, 0.028, 0.06
    x, y, z = width / 2.0 - inset, depth / 2.0 - inset, (height - thick) / 2.0
    legs = [box((leg, leg, height - thick), (sx * x, sy * y, z), frame) for sx in (-1, 1) for sy in (-1, 1)]
    apron_z, apron = height - thick - 0.04, 0.08 if height > 0.6 else 0.05
    rails = [box((2.0 * x - leg, 0.02, apron), (0.0, s * y, apron_z), frame) for s in (-1, 1)]
    rails += [box((0.02, 2.0 * y - leg, apron), (s * x, 0.0, apron_z), frame) for s in (-1, 1)]
    return (box((width, depth, thick), (0.0, 0.0, height - thick / 2.0), top, 0.006), *legs, *rails)


def chair(seat: Material, frame: Material) -> Parts:
    """A dining chair: seat 0.45 m high, 0.42 m wide; back to 0.86 m."""
    width, depth, height, leg = 0.42, 0.42, 0.45, 0.036
    x, y = width / 2.0 - leg / 2.0, depth / 2.0 - leg / 2.0
    front = [box((leg, leg, height - 0.04), (s * x, -y, (height - 0.04) / 2.0), frame) for s in (-1, 1)]
    back = [box((leg, leg, 0.86), (s * x, y + 0.02, 0.43), frame) for s in (-1, 1)]
    rails = [box((2.0 * x - leg, 0.02, 0.07), (0.0, y + 0.02, z), frame) for z in (0.62, 0.72, 0.82)]
    under = [box((2.0 * x - leg, 0.018, 0.04), (0.0, s * y, 0.36), frame) for s in (-1, 1)]
    return (
        box((width, depth - 0.02, 0.045), (0.0, -0.01, height - 0.02), seat, 0.015),
        *front,
        *back,
        *rails,
        *under,
    )


def office_chair(cloth: Material) -> Parts:
    """A swivel chair: seat 0.48 m high, back to 1.0 m, five feet."""
    parts = [
        box((0.48, 0.46, 0.08), (0.0, 0.0, 0.48), cloth, 0.035),
        box((0.44, 0.07, 0.50), (0.0, 0.23, 0.78), cloth, 0.03),
        box((0.05, 0.03, 0.30), (0.0, 0.28, 0.58), BLACK_PLASTIC),
        rod(0.05, 0.36, (0.0, 0.0, 0.08), METAL),
    ]
    for angle in np.arange(5) * 2.0 * np.pi / 5.0:
        x, y = float(np.sin(angle)), float(np.cos(angle))
        turn = (0.0, 0.0, float(-angle))
        parts.append(Part("box", (0.04, 0.28, 0.03), (0.15 * x, 0.15 * y, 0.085), BLACK_PLASTIC, turn, 0.006))
        parts.append(Part("ellipsoid", (0.055, 0.055, 0.055), (0.28 * x, 0.28 * y, 0.0275), BLACK_PLASTIC))
    return tuple(parts)


def sofa(width: float, cloth: Material, cushions: tuple[Material, ...]) -> Parts:
    """A sofa 0.88 m deep: seat 0.44 m high, back to 0.82 m."""
    arm, depth = 0.16, 0.88
    inner = width - 2.0 * arm
    seats = max(1, round(inner / 0.75))
    each = inner / seats
    parts = [box((inner, depth - 0.12, 0.24), (0.0, 0.0, 0.18), cloth, 0.02)]
    parts += [box((arm, depth - 0.04, 0.52), (s * (width - arm) / 2.0, 0.0, 0.32), cloth, 0.05) for s in (-1, 1)]
    parts.append(box((inner, 0.18, 0.68), (0.0, depth / 2.0 - 0.11, 0.46), cloth, 0.06))
    for index in range(seats):
        x = (index - (seats - 1) / 2.0) * each
        parts.append(box((each - 0.01, 0.62, 0.16), (x, -0.09, 0.375), cloth, 0.05))
        back = (x, depth / 2.0 - 0.28, 0.62)
        parts.append(Part("box", (each - 0.03, 0.15, 0.36), back, cloth, (-0.16, 0.0, 0.0), 0.06))
    for index, cushion in enumerate(cushions):
        x = (-1.0) ** index * (inner / 2.0 - 0.24)
        turn = (-0.42, 0.15 * (-1.0) ** index, 0.0)
        parts.append(Part("box", (0.40, 0.13, 0.40), (x, 0.0, 0.66), cushion, turn, 0.06))
    feet = [
        rod(0.05, 0.06, (sx * (width / 2.0 - 0.1), sy * 0.34, 0.0), WOOD_FOOT) for sx in (-1, 1) for sy in (-1, 1)
    ]
    return (*parts, *feet)


WOOD_FOOT = wood(*WOODS[2])


def cabinet(width: float, depth: float, height: float, body: Material, front: Material, columns: int) -> Parts:
    """A chest with doors: sideboards, dressers, wardrobes, kitchen counters."""
    plinth, gap = 0.07, 0.004
    parts = [
        box((width - 0.04, depth - 0.06, plinth), (0.0, 0.02, plinth / 2.0), BLACK_PLASTIC),
        box((width, depth - 0.02, height - plinth - 0.025), (0.0, 0.01, (height + plinth - 0.025) / 2.0), body),
        box((width + 0.02, depth, 0.025), (0.0, 0.0, height - 0.0125), body),
    ]
    each, tall = width / columns, height - plinth - 0.03
    rows = 1 if height < 0.5 or height > 1.3 else 2
    for column in range(columns):
        x = (column - (columns - 1) / 2.0) * each
        for row in range(rows):
            z = plinth + (row + 0.5) * tall / rows
            size = (each - gap, 0.018, tall / rows - gap)
            parts.append(box(size, (x, -depth / 2.0 + 0.011, z), front))
            handle = (x, -depth / 2.0 - 0.008, z + 0.3 * tall / rows if rows == 2 else z)
            parts.append(box((0.12, 0.02, 0.012), handle, METAL))
    return tuple(parts)


def shelf(
    width: float, height: float, boards: int, body: Material, back: Material, rng: np.random.Generator
) -> Parts:
    """A bookcase 0.30 m deep, filled with books and a few other objects."""
    depth, thick = 0.30, 0.022
    inner = width - 2.0 * thick
    parts = [box((thick, depth, height), (s * (width - thick) / 2.0, 0.0, height / 2.0), body) for s in (-1, 1)]
    parts.append(box((inner, 0.008, height), (0.0, depth / 2.0 - 0.004, height / 2.0), back))
    spacing = (height - thick - 0.06) / boards
    for index in range(boards + 1):
        z = 0.06 + index * spacing
        parts.append(box((inner, depth - 0.012, thick), (0.0, -0.006, z + thick / 2.0), body))
        if index < boards:
            parts += _filled(inner, z + thick, spacing - thick, rng)
    return tuple(parts)


def _filled(inner: float, floor: float, room: float, rng: np.random.Generator) -> list[Part]:
    """Runs of books with gaps, jars and boxes in between."""
    books = Material("books", repeat_m=0.0, roughness=0.6, seed=int(rng.integers(8)))
    parts: list[Part] = []
    x, stop = -inner / 2.0 + 0.01, inner / 2.0 - 0.01
    while x < stop - 0.05:
        kind = rng.uniform()
        if kind < 0.75:
            run = min(stop, x + rng.uniform(0.15, 0.5))
            tall, deep = rng.uniform(0.6, 0.85) * room, rng.uniform(0.15, 0.22)
            while x < run - 0.015:
                width = min(run - x, rng.uniform(0.014, 0.045))
                height, depth = tall * rng.uniform(0.85, 1.0), deep * rng.uniform(0.88, 1.0)
                centre = (x + width / 2.0, -0.13 + depth / 2.0 + rng.uniform(0.0, 0.02), floor + height / 2.0)
                size = (width - 0.001, depth, height)
                parts.append(box(size, centre, books, 0.0, int(rng.integers(ATLAS_CELLS**2))))
                x += width
        elif kind < 0.9:
            width, height = rng.uniform(0.08, 0.13), rng.uniform(0.4, 0.75) * room
            if x + width > stop:
                break
            tone = Material("plain", a_color(rng), roughness=0.3)
            parts.append(rod(width, height, (x + width / 2.0, -0.03, floor), tone, float(rng.uniform(0.7, 1.15))))
            x += width
        else:
            width, height = rng.uniform(0.16, 0.28), rng.uniform(0.35, 0.7) * room
            if x + width > stop:
                break
            parts.append(
                box((width, 0.2, height), (x + width / 2.0, -0.02, floor + height / 2.0), a_cloth(rng), 0.008)
            )
            x += width
        x += rng.uniform(0.0, 0.12)
    return parts


def bed(width: float, frame: Material, cover: Material, pillow: Material) -> Parts:
    """A bed 2.08 m long, 0.50 m high, with its head at +y."""
    length = 2.08
    pillows = [
        Part(
            "box", (0.62, 0.40, 0.15), (s * (width / 4.0) if width > 1.2 else 0.0, 0.72, 0.585), pillow, bevel_m=0.07
        )
        for s in ((-1, 1) if width > 1.2 else (0,))
    ]
    return (
        box((width, length, 0.22), (0.0, 0.0, 0.19), frame, 0.01),
        box((width - 0.06, 0.05, 0.95), (0.0, length / 2.0 + 0.025, 0.475), frame, 0.01),
        box((width - 0.04, length - 0.04, 0.20), (0.0, 0.0, 0.40), pillow, 0.05),
        box((width + 0.02, 1.45, 0.24), (0.0, -0.28, 0.41), cover, 0.05),
        *pillows,
    )


def television() -> Parts:
    """A flat screen on a foot."""
    width, height = 1.0, 0.58
    return (
        box((width, 0.045, height), (0.0, 0.0, 0.07 + height / 2.0), BLACK_PLASTIC, 0.006),
        box((0.06, 0.05, 0.09), (0.0, 0.02, 0.05), BLACK_PLASTIC),
        box((0.4 * width, 0.2, 0.012), (0.0, 0.0, 0.006), BLACK_PLASTIC),
    )


def monitor(rng: np.random.Generator) -> Parts:
    """A computer screen, 0.54 m wide, with a keyboard in front."""
    page = Material("screen", (0.32, 0.34, 0.37), a_color(rng, 0.3, 0.9), 0.0, 0.3, seed=int(rng.integers(1 << 16)))
    return (
        box((0.54, 0.03, 0.33), (0.0, 0.0, 0.30), BLACK_PLASTIC, 0.005),
        box((0.51, 0.004, 0.30), (0.0, -0.0165, 0.30), page, 0.0),
        box((0.05, 0.03, 0.20), (0.0, 0.025, 0.10), METAL),
        box((0.22, 0.18, 0.012), (0.0, 0.02, 0.006), METAL),
        box((0.44, 0.13, 0.02), (0.0, -0.26, 0.01), BLACK_PLASTIC, 0.004),
    )


def bowl(rng: np.random.Generator) -> Parts:
    """A bowl with fruit."""
    fruit = [
        Part(
            "ellipsoid", (0.075, 0.075, 0.07), (x, y, 0.085), Material("plain", a_color(rng, 0.9, 0.9), roughness=0.4)
        )
        for x, y in ((-0.05, 0.0), (0.045, 0.035), (0.03, -0.05))
    ]
    return (rod(0.13, 0.075, (0.0, 0.0, 0.0), CERAMIC, 1.9), *fruit)


def books_lying(rng: np.random.Generator) -> Parts:
    """A small pile of books."""
    books = Material("books", repeat_m=0.0, roughness=0.6, seed=int(rng.integers(8)))
    parts, z = [], 0.0
    for _ in range(int(rng.integers(2, 5))):
        thick, turn = float(rng.uniform(0.015, 0.04)), float(rng.uniform(-0.3, 0.3))
        size = (float(rng.uniform(0.14, 0.2)), float(rng.uniform(0.2, 0.27)), thick)
        cell = int(rng.integers(ATLAS_CELLS**2))
        parts.append(Part("box", size, (0.0, 0.0, z + thick / 2.0), books, (0.0, 0.0, turn), 0.003, cell=cell))
        z += thick
    return tuple(parts)


def mug(rng: np.random.Generator) -> Parts:
    glaze = Material("plain", a_color(rng, 0.5, 0.95), roughness=0.2)
    return (rod(0.082, 0.095, (0.0, 0.0, 0.0), glaze), box((0.012, 0.04, 0.06), (0.0, -0.052, 0.05), glaze))


def vase(rng: np.random.Generator) -> Parts:
    glaze = Material("plain", a_color(rng, 0.4, 0.8), roughness=0.15)
    return (rod(0.07, 0.16, (0.0, 0.0, 0.0), glaze, 1.7), rod(0.119, 0.08, (0.0, 0.0, 0.16), glaze, 0.45))


def lacquered(rng: np.random.Generator) -> Material:
    """White, grey or a muted colour, for cabinets."""
    return lacquer((0.86, 0.85, 0.82) if rng.uniform() < 0.6 else a_color(rng, 0.3, 0.75))
