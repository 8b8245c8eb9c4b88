"""A sensor's depth beside that of landmarks: whether both are in one unit.

Landmarks fix the pose of a frame that an update uses, whatever its depth says. Depth in another unit would show all
surfaces of the room as gone, and extend the map by a second, larger or smaller room.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.depth.depth_image import sample_depth
from monoloc.depth.predictor import DepthPrediction
from monoloc.editing.alignment import PosedFrames
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.recording import Recording
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.recording_check.explanations import depth_scale_option
from monoloc.sensor_depth import sparse_depth

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


def check_depth_scale(bundle: Bundle, recording: Recording, posed: PosedFrames, given: Recording) -> None:
    """Refuse a recording whose depth is in another unit than the map.

    Args:
        bundle: the room.
        recording: with depth.
        posed: its :func:`monoloc.editing.alignment.poses_by_landmarks`.
        given: the recording as it was opened, which tells the option that corrects it.

    Raises:
        DataError: it is.
    """
    landmarks = bundle.landmarks
    localizer = OrbLandmarkLocalizer(landmarks, recording.camera)
    ratios = []
    for index, pose in zip(posed[0].tolist(), posed[1], strict=True):
        keypoints = localizer.detect(recording.color(index))
        _, which, where = localizer.matched_keypoints(keypoints, pose)
        depth = sparse_depth(recording.depth(index), recording.camera)
        camera, pixels = localizer.detector.camera, keypoints.pixels[where]
        ratios.append(depth_ratios(depth, camera, pixels, pose, landmarks.points[which]))
    if (found := scale_problem(given, ratios)) is None:
        return
    problem, fix = found
    if bundle.provenance.scale_sd is not None:  # to correct right depth would make it contradict the poses
        doubt = "no depth sensor measured the map's scale: if that is the wrong one"
        fix = f"{doubt}, build the room from this recording; else {fix}"
    raise DataError(recording.name, problem, fix)


def scale_problem(recording: Recording, ratios: Sequence[FloatArray]) -> tuple[str, str] | None:
    """How a recording's depth is in another unit than the map, and what to do; None if not, or too little tells.

    Args:
        recording: as it was opened.
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
    return f"its depth is {factor:.3g} times as far as the map's landmarks", fix
