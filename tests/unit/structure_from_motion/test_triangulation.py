"""Points from pixels, and how well these determine them."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import invert, make_pose, so3_exp, transform
from monoloc.structure_from_motion.triangulation import distance_sd, triangulate
from synthetic_room import CAMERA

POSES = make_pose(
    so3_exp([[0.0, 0.1 * i, 0.02 * i] for i in range(4)]), [[-0.2 * i, 0.05 * i, 0.0] for i in range(4)]
)
POINTS = np.array([[0.1, 0.0, 2.0], [-0.2, 0.2, 2.5]])


def test_covariance_is_that_of_repeated_measurements() -> None:
    rng, sd_px = np.random.default_rng(0), 0.4
    exact = [CAMERA.project(transform(invert(POSES), point[None])[:, 0]) for point in POINTS]
    lengths, found = [], []
    for _ in range(400):
        ends = [triangulate(CAMERA, POSES, pixels + rng.normal(0.0, sd_px, pixels.shape)) for pixels in exact]
        assert ends[0] is not None and ends[1] is not None
        found.append(ends[0][0])
        lengths.append(distance_sd(ends[0], ends[1])[0])
    assert np.mean(found, axis=0) == pytest.approx(POINTS[0], abs=0.005)
    first, second = (triangulate(CAMERA, POSES, pixels) for pixels in exact)
    assert first is not None and second is not None
    assert first[0] == pytest.approx(POINTS[0], abs=1e-9)
    # 400 draws give a standard deviation to 3.5 %.
    assert np.std(found, axis=0) == pytest.approx(sd_px * np.sqrt(np.diag(first[1])), rel=0.15)
    assert np.std(lengths) == pytest.approx(sd_px * distance_sd(first, second)[1], rel=0.15)


@pytest.mark.parametrize("unit", [0.01, 1.0, 30.0, 1000.0])
def test_unit_of_a_model_does_not_matter(unit: float) -> None:
    """Structure from motion chooses it."""
    poses = POSES.copy()
    poses[:, :3, 3] *= unit
    found = triangulate(CAMERA, poses[:2], CAMERA.project(transform(invert(POSES[:2]), POINTS[:1])[:, 0]))
    assert found is not None and found[0] == pytest.approx(unit * POINTS[0], rel=1e-6)


def test_one_side_and_behind_determine_nothing() -> None:
    twice = POSES[[0, 0]]
    assert triangulate(CAMERA, twice, CAMERA.project(transform(invert(twice), POINTS[:1])[:, 0])) is None
    assert triangulate(CAMERA, POSES[:2], np.array([[300.0, 128.0], [10.0, 128.0]])) is None
