"""How much an image counts beside those of a moment ago.

Noise and evidence are stated for frames at up to 16 Hz. The images of a faster camera have the same errors as their
neighbours: if each counted as a frame, a camera would seem the surer, and drift the more, the faster it is.
"""

from __future__ import annotations

_FRAME_S, _LEAST_S = 0.06, 1e-3  # between images that count as frames of their own, and at least


def share_of_frame(elapsed_s: float) -> float:
    """How much of a frame an image counts as, above 0 and up to 1, by the seconds since the last."""
    return min(1.0, max(elapsed_s, _LEAST_S) / _FRAME_S)
