"""Distances and intersections of boxes."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import make_pose, so3_exp
from monoloc_lab.synth.boxes import Boxes


def test_distance_is_that_to_the_nearest_point_inside() -> None:
    rng = np.random.default_rng(0)
    pose = make_pose(so3_exp(np.array([0.3, -0.5, 0.8])), np.array([1.0, 2.0, 0.5]))
    boxes = Boxes(pose[None], np.array([[0.3, 0.6, 0.2]]))
    inside = rng.uniform(-1.0, 1.0, (60_000, 3)) * boxes.half_sizes[0]
    cloud = inside @ pose[:3, :3].T + pose[:3, 3]
    points = rng.uniform(-1.0, 4.0, (20, 3))
    distance = boxes.distance_m(points)
    nearest = np.linalg.norm(points[:, None] - cloud[None], axis=2).min(axis=1)
    outside = distance > 0.05
    assert outside.sum() > 10
    np.testing.assert_allclose(distance[outside], nearest[outside], atol=0.03)
    assert boxes.distance_m(pose[None, :3, 3])[0] == pytest.approx(-0.2)


def test_boxes_intersect_if_they_share_a_point() -> None:
    rng = np.random.default_rng(1)
    agreed = {True: 0, False: 0}
    for _ in range(60):
        poses = make_pose(so3_exp(rng.normal(size=(2, 3))), rng.uniform(-0.8, 0.8, (2, 3)))
        one, other = (Boxes(pose[None], rng.uniform(0.2, 0.7, (1, 3))) for pose in poses)
        points = rng.uniform(-1.0, 1.0, (20_000, 3)) * one.half_sizes[0] @ poses[0, :3, :3].T + poses[0, :3, 3]
        shared = bool((other.distance_m(points) < -0.01).any())
        if shared:
            assert one.intersect(other) and other.intersect(one)
        elif one.intersect(other):
            continue  # a smaller intersection than the sampling can show
        agreed[shared] += 1
    assert min(agreed.values()) > 10
