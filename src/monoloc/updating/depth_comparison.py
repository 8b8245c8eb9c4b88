"""A sensor's depth beside that of landmarks: whether both are in one unit.

Landmarks fix the pose of a frame that teaches, whatever its depth says. Depth in another unit would show all surfaces
of the room as gone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth.depth_image import sample_depth
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.recording import Recording
from monoloc.recording_check.explanations import depth_scale_option

_LEAST_RATIOS = 30  # of a flight, that tell
# Logarithm of the median ratio. In right flights it was 0.001 or less (RedKitchen, the desk), and 0.01 in their worst
# frame; from about 0.07 on, a surface at 3 m seems to be elsewhere with the certainty that an update asks for.
_MOST_OFF = 0.05


def depth_ratios(
    depth: DepthPrediction, detected: Camera, pixels: FloatArray, pose: FloatArray, points: NDArray[np.float32]
) -> FloatArray:
    """Depth over that of landmarks at their keypoints, (R,), of those where there is depth.

    Args:
        detected: camera of the pixels.
        pixels: (A, 2) of keypoints that are landmarks.
        pose: ``T_world_camera``, (4, 4).
        points: (A, 3), their landmarks, world frame, metres.
    """
    seen_m = sample_depth(pixels.astype(np.float32), detected, depth.depth_m, depth.camera)
    local = transform(invert(pose), points.astype(np.float64))
    is_seen = seen_m > 0.0
    return np.asarray(seen_m[is_seen] / local[is_seen, 2])


def scale_problem(recording: Recording, ratios: Sequence[FloatArray]) -> str | None:
    """Why a flight's depth is in another unit than the map, and what to do; None if it is not, or too little tells.

    Args:
        ratios: :func:`depth_ratios` of its frames.
    """
    every = np.concatenate([np.zeros(0), *ratios])
    if len(every) < _LEAST_RATIOS:
        return None
    factor = float(np.median(every))
    if abs(np.log(factor)) <= _MOST_OFF:
        return None
    option = depth_scale_option(recording, factor)
    fix = "correct its depth" if option is None else f"give {option}"
    return f"its depth is {factor:.3g} times as far as the map's landmarks; {fix}, or leave it out: --depth predicted"
