"""Drawing of a run: axes, labels and bounds."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from matplotlib.figure import Figure

from monoloc.geometry import make_pose
from monoloc.supervision.state import State
from monoloc.viz.run_drawing import _STATE_COLOURS, DrawnRun, _beside, draw_errors, norm_bound_95, view_axes
from plot_helpers import FRAMES, make_run


def test_every_state_but_tracking_has_a_colour() -> None:
    assert set(_STATE_COLOURS) == set(get_args(State)) - {"tracking"}


def test_errors_of_a_lost_camera_do_not_scale_the_axis() -> None:
    run = make_run() | {"states": ["lost"] * 5 + ["tracking"] * (FRAMES - 5)}
    run["estimated"][:5, :3, 3] += 100.0
    run["covariances"][:5] = 100.0 * np.eye(6)
    for states, least_cm, most_cm in ((run["states"], 3.0, 50.0), (["lost"] * FRAMES, 1e4, 1e5)):
        figure = Figure()
        draw_errors(figure.subfigures(), DrawnRun(**run | {"states": states}))
        assert least_cm < figure.axes[0].get_ylim()[1] < most_cm


@pytest.mark.parametrize(
    ("down", "axes"),
    [
        ([0, 1, 0], (0, 2, 1, True)),  # 7-Scenes: y down, so x right and z forward
        ([0, -1, 0], (2, 0, 1, False)),
        ([0, 0, -1], (0, 1, 2, False)),  # most robots: z up
        ([1, 0, 0], (2, 1, 0, True)),
    ],
)
def test_top_view_looks_down_and_is_not_mirrored(down: list[float], axes: tuple[int, int, int, bool]) -> None:
    rotation = np.zeros((3, 3))
    rotation[:, 1] = down  # the camera's y axis in the world; the others are not used
    assert view_axes(make_pose(rotation, np.zeros(3))[None]) == axes
    right, forward, up, up_is_negative = axes
    sign = -1.0 if up_is_negative else 1.0
    np.testing.assert_array_equal(np.cross(np.eye(3)[right], np.eye(3)[forward]), sign * np.eye(3)[up])


@pytest.mark.parametrize("turned", range(0, 360, 60))
@pytest.mark.parametrize("flipped", [False, True])
def test_label_of_an_end_hides_no_trajectory_and_stays_inside(turned: float, flipped: bool) -> None:
    """A straight trajectory with arrows on one side leaves room on the other."""
    angle = np.deg2rad(turned)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    trajectory = np.stack([np.linspace(0.0, 2.0, 60), np.zeros(60)], axis=-1) @ turn.T
    crowd = np.concatenate([trajectory, trajectory + turn @ [0.0, 0.2]])
    axis = Figure().subplots()
    axis.set_xlim(-2.5, 2.5)
    axis.set_ylim(*([2.5, -2.5] if flipped else [-2.5, 2.5]))
    (right_pt, up_pt), box = _beside(axis, trajectory[0], crowd)
    assert np.abs(box).max() < 2.5
    low, high = box.min(axis=0), box.max(axis=0)
    assert not np.any(np.all((crowd > low) & (crowd < high), axis=1))
    np.testing.assert_array_equal(np.sign(box[0] - trajectory[0]), np.sign([right_pt, -up_pt if flipped else up_pt]))


@pytest.mark.parametrize("spreads", [(1.0, 1.0, 1.0), (3.0, 1.0, 0.2), (1.0, 0.0, 0.0)])
def test_bound_of_a_length_is_its_95_percent_quantile(spreads: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(7)
    lengths = np.linalg.norm(rng.normal(size=(200_000, 3)) * spreads, axis=1)
    (bound,) = norm_bound_95(np.diag(spreads)[None] ** 2)
    assert bound == pytest.approx(np.quantile(lengths, 0.95), rel=0.03)


def test_bound_of_zero_covariance_is_zero() -> None:
    assert norm_bound_95(np.zeros((1, 3, 3))) == [0.0]
