"""Materials: a procedural texture in two colours, gloss, and emitted light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

Color = tuple[float, float, float]
LightGroup = Literal["daylight", "lamps"]


@dataclass(frozen=True)
class Material:
    """A surface.

    Attributes:
        texture: key of :data:`monoloc_lab.synth.textures.TEXTURES`.
        color, accent: main and second colour, sRGB, 0 to 1.
        repeat_m: period of the texture; 0 covers every face once.
        roughness: of the principled model (Burley 2012); 0 is a mirror, 1 is matt.
        metallic: 1 for bare metal.
        seed: of the texture.
        group: light group of the light that the surface emits; None if it emits none.
        luminance: of that light where the texture is white, cd/m^2, before the factor of a light.
    """

    texture: str = "plain"
    color: Color = (0.8, 0.8, 0.8)
    accent: Color = (0.5, 0.5, 0.5)
    repeat_m: float = 1.0
    roughness: float = 0.7
    metallic: float = 0.0
    seed: int = 0
    group: LightGroup | None = None
    luminance: float = 0.0

    def seeded(self, seed: int) -> Material:
        """The same material with another random pattern."""
        return replace(self, seed=seed)


def paint(color: Color, seed: int = 0) -> Material:
    """Emulsion paint on plaster."""
    return Material("plaster", color, repeat_m=2.0, roughness=0.9, seed=seed)


def lacquer(color: Color) -> Material:
    """A smooth painted surface: window frames, doors, white furniture."""
    return Material("plain", color, roughness=0.4)


def wood(color: Color, accent: Color, seed: int = 0) -> Material:
    return Material("wood", color, accent, repeat_m=1.2, roughness=0.45, seed=seed)


def fabric(color: Color, accent: Color, seed: int = 0) -> Material:
    return Material("fabric", color, accent, repeat_m=0.5, roughness=0.95, seed=seed)


METAL = Material("plain", (0.62, 0.62, 0.62), roughness=0.3, metallic=1.0)
BLACK_PLASTIC = Material("plain", (0.06, 0.06, 0.065), roughness=0.35)
CERAMIC = Material("plain", (0.85, 0.83, 0.8), roughness=0.25)
