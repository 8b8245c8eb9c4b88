"""Minimum-snap splines."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc_lab.synth.minimum_snap import minimum_snap


def test_spline_passes_its_waypoints_is_smooth_and_rests_at_both_ends() -> None:
    rng = np.random.default_rng(0)
    points, durations = rng.uniform(-2.0, 2.0, (6, 4)), rng.uniform(1.0, 4.0, 5)
    spline = minimum_snap(points, durations)
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    np.testing.assert_allclose(spline(knots), points, atol=1e-9)
    for derivative in (1, 2, 3):
        np.testing.assert_allclose(spline(knots[[0, -1]], derivative), 0.0, atol=1e-8)
    for derivative in range(1, 7):
        before, after = spline(knots[1:-1] - 1e-9, derivative), spline(knots[1:-1] + 1e-9, derivative)
        np.testing.assert_allclose(before, after, atol=1e-5 * (1.0 + np.abs(before).max()))


def test_derivatives_are_those_of_the_values() -> None:
    spline = minimum_snap([[0.0], [1.0], [-1.0]], [1.0, 2.0])
    t, h = np.linspace(0.1, 2.9, 40), 1e-5
    for derivative in (0, 1, 2):
        numeric = (spline(t + h, derivative) - spline(t - h, derivative)) / (2.0 * h)
        np.testing.assert_allclose(numeric, spline(t, derivative + 1), atol=1e-4)


def test_other_smooth_splines_have_more_snap() -> None:
    points, durations = np.array([[0.0], [1.0], [0.5], [2.0]]), np.array([1.0, 1.5, 1.0])
    best = minimum_snap(points, durations)
    t = np.linspace(0.0, best.duration_s, 4001)
    snap = np.sum(best(t, 4) ** 2)
    rng = np.random.default_rng(0)
    for _ in range(10):
        # A spline through the same waypoints and one more in between.
        extra = rng.uniform(0.2, 3.3)
        knots = np.sort(np.append(np.concatenate([[0.0], np.cumsum(durations)]), extra))
        values = best(knots) + 0.05 * (knots == extra)[:, None]
        other = minimum_snap(values, np.diff(knots))
        assert np.sum(other(t, 4) ** 2) > snap


def test_slowed_spline_has_the_same_path() -> None:
    spline = minimum_snap([[0.0, 0.0], [1.0, 2.0]], [2.0])
    slow, t = spline.slowed(2.0), np.linspace(0.0, 2.0, 9)
    np.testing.assert_allclose(slow(2.0 * t), spline(t), atol=1e-12)
    np.testing.assert_allclose(slow(2.0 * t, 2), spline(t, 2) / 4.0, atol=1e-12)


def test_waypoints_of_a_wrong_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"waypoints must have shape \(3, D\), got \(2, 1\)"):
        minimum_snap([[0.0], [1.0]], [1.0, 1.0])
