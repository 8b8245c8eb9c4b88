"""How much the frames of a flight weigh."""

from __future__ import annotations

import numpy as np

from map_helpers import make_mixture, make_particles
from monoloc.geometry import FloatArray
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.scan import EMPTY_SCAN, Scan
from monoloc.likelihood.weighing import FrameWeighing
from particle_helpers import particles_at, scan_ahead

SCAN = scan_ahead(make_mixture(30), 60, np.random.default_rng(0))


class _ByHeight:
    """A likelihood of a thousandth of the particle's z, whatever the scan."""

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        return 1e-3 * poses[:, 2, 3]


def after(frames: list[tuple[float, Scan, Scan]]) -> FloatArray:
    """Log-weights of particles after frames: seconds since the last, scan and corners."""
    weighing = FrameWeighing(_ByHeight(), LikelihoodConfig(), np.random.default_rng(0))
    particles = particles_at(make_particles(50, np.random.default_rng(0))[0])
    for elapsed_s, scan, corners in frames:
        particles = weighing.begin(scan, corners, elapsed_s)(particles)
    return particles.log_weights


def test_a_fast_camera_has_no_more_evidence_in_a_second_than_one_of_16_hz() -> None:
    first = (0.0, SCAN, EMPTY_SCAN)
    slow = after([first, *([(0.06, SCAN, SCAN)] * 5)])
    fast = after([first, *([(0.015, SCAN, SCAN)] * 20)])
    np.testing.assert_allclose(fast, slow, atol=1e-9)
    one = after([first])
    assert np.ptp(slow) > 3.0 * np.ptp(one) > 0.0


def test_slower_cameras_have_as_much_evidence_a_frame() -> None:
    log_weights = [after([(0.0, SCAN, EMPTY_SCAN), (elapsed_s, SCAN, SCAN)]) for elapsed_s in (0.06, 0.5)]
    np.testing.assert_array_equal(*log_weights)


def test_a_scan_counts_by_the_time_since_the_last_scan_and_not_since_the_last_frame() -> None:
    """As where depth has its turn in every other frame of a camera of 33 Hz."""
    first, scan, nothing = (0.0, SCAN, EMPTY_SCAN), (0.03, SCAN, EMPTY_SCAN), (0.03, EMPTY_SCAN, EMPTY_SCAN)
    in_turn = after([first, nothing, scan, nothing, scan])
    slow = after([first, *([(0.06, SCAN, EMPTY_SCAN)] * 2)])
    np.testing.assert_allclose(in_turn, slow, atol=1e-9)
