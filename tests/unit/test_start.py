"""The first pose of a flight, and particles around it."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import make_pose, se3_exp
from monoloc.localizer_config import LocalizerConfig
from monoloc.start import Start, checked_start

POSE = se3_exp([0.5, -1.0, 2.0, 0.3, 0.2, -0.4])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("error_rad", [0.2, 3.0])
def test_disturbed_start_is_exactly_as_far_off_as_asked(seed: int, error_rad: float) -> None:
    start = Start.disturbed(POSE, np.random.default_rng(seed), 0.3, error_rad)
    errors = pose_errors(start.pose[None], POSE[None])
    assert (errors.position_m[0], errors.rotation_rad[0]) == pytest.approx((0.3, error_rad))
    assert (start.error_m, start.error_rad) == (0.3, error_rad)


def test_root_mean_square_distance_of_particles_is_the_error() -> None:
    config = LocalizerConfig(particles=20_000, log_scale_sd=0.07)
    particles = Start(POSE, 0.3, 0.2).particles(config, np.random.default_rng(1))
    errors = pose_errors(particles.poses, np.repeat(POSE[None], len(particles), axis=0))
    rms = [np.sqrt(np.mean(values**2)) for values in (errors.position_m, errors.rotation_rad)]
    assert rms == pytest.approx([0.3, 0.2], rel=0.02)
    assert particles.log_scale.std() == pytest.approx(0.07, rel=0.02)


@pytest.mark.parametrize(
    ("pose", "got"),
    [
        (np.diag([2.0, 2.0, 2.0, 1.0]), "one that is not rigid or not finite"),
        (np.full((4, 4), np.nan), "one that is not rigid or not finite"),
        (np.eye(4, dtype=np.complex128), "one that is not rigid or not finite"),
        (np.eye(3), r"shape \(3, 3\)"),
    ],
)
def test_pose_that_is_not_rigid_is_refused(pose: np.ndarray, got: str) -> None:
    with pytest.raises(ValueError, match=rf"^pose must be a rigid \(4, 4\) T_world_camera, got {got}$"):
        Start(pose)


@pytest.mark.parametrize("given", [POSE, POSE.tolist(), "truth"])
def test_start_that_is_no_start_is_refused(given: object) -> None:
    with pytest.raises(TypeError, match=r"^start must be a monoloc\.Start or None, got .*; write monoloc\.Start\("):
        checked_start(given)


def test_pose_that_is_not_in_metres_is_refused() -> None:
    with pytest.raises(ValueError, match="pose must be within 100000 m of the origin; give metres"):
        Start(make_pose(np.eye(3), np.array([1e155, 0.0, 0.0])))


@pytest.mark.parametrize("errors", [(-0.1, 0.1), (0.1, np.inf), (1e200, 0.1)])
def test_error_that_is_negative_or_huge_is_refused(errors: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="error_m and error_rad must be from 0 to 1000"):
        Start(POSE, *errors)
