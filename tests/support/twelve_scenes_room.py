"""The synthetic room as a scene of 12-Scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import synthetic_recordings as synthetic
from synthetic_room import SMALL_CAMERA, Room, make_path

KITCHEN = "apt1/kitchen"


def write_kitchen(scene: Path, sequences: list[int]) -> list[NDArray[np.float64]]:
    """Write walks of so many frames through the room, each from another time on; returns their poses."""
    synthetic.write_twelve_scenes_texts(scene, SMALL_CAMERA, SMALL_CAMERA, sequences)
    walks = [make_path(count, 1.1 + 3.0 * index, rate_hz=6.0) for index, count in enumerate(sequences)]
    for number, pose in enumerate(np.concatenate(walks)):
        synthetic.write_twelve_scenes_frame(scene, number, *Room().view(pose, SMALL_CAMERA), pose)
    return walks
