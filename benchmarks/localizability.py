"""Whether the predicted number of landmarks agrees with the images of a recording.

    python benchmarks/localizability.py ROOM BUNDLE SOURCE FRAMES

Prints a row of CSV for each frame: the number of landmarks that ``monoloc map localizability`` expects at the frame's
reference pose, the number found near it, and whether the landmarks alone find the camera, without a prior, less than
30 cm off, at a pose that does not rest on a few corners.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import cv2
import numpy as np
from rendered_flights import print_table

from monoloc.bundle import read_bundle
from monoloc.evaluation.consistency import FAR_M
from monoloc.geometry import pose_distance_m
from monoloc.io.registry import open_recording, select_frames
from monoloc.landmarks.expected_landmarks import ExpectedLandmarks
from monoloc.landmarks.influential_corners import sd_without_influential_corners
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.landmarks.pnp import PRIOR_COVARIANCE


def rows(room: str, bundle_path: str, source: str, frames: str) -> Iterator[dict[str, object]]:
    bundle, recording = read_bundle(bundle_path), select_frames(open_recording(source), frames)
    views = bundle.landmarks.views
    assert views is not None and recording.poses is not None
    localizer = OrbLandmarkLocalizer(bundle.landmarks, recording.camera)
    expected = ExpectedLandmarks(bundle.landmarks.points, views, bundle.camera)
    for index, pose in enumerate(recording.poses):
        seen = localizer.detect(recording.color(index))
        place = localizer.relocalize(seen)
        off_m = np.inf
        if place is not None and sd_without_influential_corners(place) < FAR_M:
            off_m = float(np.linalg.norm(place.pose[:3, 3] - pose[:3, 3]))
        yield {
            "room": room,
            "frame": index,
            "distance": f"{pose_distance_m(pose, views.poses).min():.2f}",
            "expected": f"{expected.count(pose, recording.camera, expected.rates(pose[:3, 3])):.1f}",
            "found": localizer.measure_near(seen, pose, PRIOR_COVARIANCE).found,
            "localized": int(off_m < FAR_M),
        }


if __name__ == "__main__":
    cv2.setNumThreads(1)
    print_table(rows(*sys.argv[1:]))
