"""The rendered living room of the package: two flights as recordings in the ``folder`` format, and a bundle.

``python -m monoloc_lab.make.rendered_room`` renders the flights, ``make demo-bundle`` builds the bundle.
"""

from __future__ import annotations

from pathlib import Path

LIVING = Path(__file__).parent / "living"
"""The folder, as :mod:`monoloc_lab.make.rendered_room` writes it."""

BUILD = LIVING / "build" / "L2"
"""The build flight, with depth: 150 frames in medium light."""

TESTS = {light: LIVING / "test" / light for light in ("L1", "L2", "L3")}
"""The test flight through the same room, a few decimetres from the build flight: 150 frames in each light."""

BUNDLE = LIVING / "living.monoloc"
"""The finished bundle: every second frame of the build flight, with the settings of ``monoloc demo --build``."""
