"""Images that repeat although the poses move, as of a stream that froze; comparing corners leaves such pairs out."""

from __future__ import annotations

import numpy as np

from monoloc.geometry import steps_m
from monoloc.io.recording import Recording, evenly_spaced

_PAIRS = 30  # of neighbouring frames that are compared
_MOVED = 0.02  # metres plus radians; a camera that stands still may give the same image twice, compressed or rendered

LEAVE_OUT = "leave out the frames whose own image did not arrive"


def find_repeats(recording: Recording) -> str | None:
    """What is found of images that repeat, for a message; None if the poses move with the images, or are unknown.

    Raises:
        DataError: a frame cannot be read.
    """
    if recording.poses is None or len(recording) < 2:
        return None
    moving = np.flatnonzero(steps_m(recording.poses) > _MOVED)
    chosen = moving[evenly_spaced(len(moving), _PAIRS)] if len(moving) else moving
    same = [at for at in chosen.tolist() if np.array_equal(recording.color(at), recording.color(at + 1))]
    if not same:
        return None
    names = recording.frame_names
    found = f"{len(same)} of {len(chosen)} pairs of neighbouring frames looked at show one and the same image"
    return f"{found} while the poses move, as {names[same[0]]} and {names[same[0] + 1]}"
