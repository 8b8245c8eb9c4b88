"""The rendered living room of the package: two flights as recordings in the ``folder`` format, and a bundle.

``python -m monoloc_lab.make.rendered_room`` renders the flights, ``make demo-bundle`` builds the bundle.
"""

from __future__ import annotations

from pathlib import Path

LIVING = Path(__file__).parent / "living"
"""The folder, as :mod:`monoloc_lab.make.rendered_room` writes it."""


def build_of(room: Path) -> Path:
    """The build flight in the folder of a rendered room."""
    return room / "build" / "L2"


def tests_of(room: Path) -> dict[str, Path]:
    """The test flight in the folder of a rendered room, by light."""
    return {light: room / "test" / light for light in ("L1", "L2", "L3")}


BUILD = build_of(LIVING)
"""The build flight, with depth: 150 frames in medium light."""

TESTS = tests_of(LIVING)
"""The test flight through the same room, a few decimetres from the build flight: 150 frames in each light."""

BUNDLE = LIVING / "living.monoloc"
"""The finished bundle: every second frame of the build flight, with the settings of ``monoloc demo --build``."""
