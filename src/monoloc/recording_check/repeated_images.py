"""Images that repeat although the poses move, as of a stream that froze; comparing corners leaves such pairs out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.contrast import has_contrast
from monoloc.geometry import steps_m
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.same_image import is_same_image

_PAIRS = 30  # of neighbouring frames that are compared
_LEAST_SAME = 2  # of them: a single one is no frozen stream
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
    same = [at for at in chosen.tolist() if _is_repeated(recording.color(at), recording.color(at + 1))]
    if len(same) < _LEAST_SAME:
        return None
    names = recording.frame_names
    found = f"{len(same)} of {len(chosen)} pairs of neighbouring frames looked at show one and the same image"
    return f"{found} while the poses move, as {names[same[0]]} and {names[same[0] + 1]}"


def _is_repeated(image: NDArray[np.uint8], following: NDArray[np.uint8]) -> bool:
    """Whether two images (H, W, 3) are the same and show something: a blank wall looks the same from everywhere."""
    return is_same_image(image, following) and has_contrast(image)
