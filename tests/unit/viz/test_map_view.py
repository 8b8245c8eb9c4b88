"""Pictures of maps that have little to show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.geometry import make_pose, so3_exp
from monoloc.viz import map_view
from monoloc.viz.map_view import MapView, plot_from_above, plot_from_pose
from plot_helpers import check_picture
from refusals import refuses_setting

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
NOTHING = np.zeros((0, 3))


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [2.0, 0.3, 0.0]])
@pytest.mark.filterwarnings("error")
def test_map_without_cameras_and_landmarks_is_drawn(tmp_path: Path, turn: list[float]) -> None:
    cloud = np.random.default_rng(0).uniform(0.0, [4.0, 3.0, 2.0], (1000, 3))
    view = MapView("A room", cloud, NOTHING, np.zeros((0, 4, 4)))
    plot_from_above(tmp_path / "a.png", (view, view), make_pose(so3_exp(turn), np.zeros(3)))
    check_picture(tmp_path / "a.png", 1800, 400)


def test_one_room_seen_from_two_heights_does_not_differ(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is above the cameras is left out of both maps alike, or of neither."""
    cloud = np.random.default_rng(0).uniform(0.0, [4.0, 3.0, 2.5], (3000, 3))
    low, high = (MapView("A room", cloud, NOTHING, make_pose(np.eye(3), [1.0, 1.0, z])[None]) for z in (0.5, 1.5))
    compared = []
    monkeypatch.setattr(map_view, "_draw_difference", lambda axis, before, after: compared.append((before, after)))
    plot_from_above(tmp_path / "a.png", (low, high), np.eye(4))
    ((before, after),) = compared
    np.testing.assert_array_equal(before, after)
    assert before[:, 2].max() == pytest.approx(1.7, abs=0.01)


@pytest.mark.filterwarnings("error")
def test_view_of_nothing_is_refused_unless_the_other_map_shows_something(tmp_path: Path) -> None:
    behind, before = (
        MapView("A room", np.array([[0.0, 0.0, z]]), np.array([[0.0, 0.0, 2.0]]), np.eye(4)[None])
        for z in (-1.0, 1.0)
    )
    picture = tmp_path / "a.png"
    refuses_setting(
        lambda: plot_from_pose(picture, (behind, behind), CAMERA, np.eye(4)), "pose", "shows nothing", "--reference 0"
    )
    assert not picture.exists()
    plot_from_pose(picture, (behind, before), CAMERA, np.eye(4))
    check_picture(picture, 1800, 400)
