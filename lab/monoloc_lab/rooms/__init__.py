"""The room that comes with monoloc, rendered: two flights as recordings of the ``folder`` format.

``benchmarks/make_embedded_room.py`` made it.
"""

from __future__ import annotations

from pathlib import Path

_LIVING = Path(__file__).parent / "living"

BUILD = _LIVING / "build" / "L2"
"""A flight with depth, to build from: 150 frames in medium light."""

TESTS = {light: _LIVING / "test" / light for light in ("L1", "L2", "L3")}
"""Another flight through the same room, a few decimetres away, in each of the three lights: 150 frames."""
