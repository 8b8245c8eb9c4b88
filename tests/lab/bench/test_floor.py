"""The floor of the benchmark has one place that looks like an image of it."""

from __future__ import annotations

import numpy as np

from monoloc.geometry import pose_distance_m
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.map.em import fit_mixture
from monoloc_lab.bench import floor
from monoloc_lab.bench.scenes import synthetic_cloud, weighing


def test_the_camera_is_found_among_the_landmarks_of_all_rooms() -> None:
    rng = np.random.default_rng(0)
    cloud = synthetic_cloud(20_000, rng)
    pose = weighing(cloud, 1, 50, rng).poses[0]
    landmarks = floor._landmarks(cloud, fit_mixture(cloud, 20, rng).mixture, 6000, 5, rng)
    localizer = OrbLandmarkLocalizer(landmarks, floor._CAMERA)
    found = localizer.relocalize(floor._seen(landmarks, pose, rng))
    assert len(landmarks) == 30_000 and found is not None
    assert pose_distance_m(pose, found.pose[None])[0] < 0.05
