"""Edits in pictures and in Rerun's viewer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from edit_helpers import CUBE, mapped_room
from monoloc.editing.box import Box
from monoloc.editing.edit_history import DrawnEdit, drawn_edits
from monoloc.editing.edits import move, remove
from monoloc.evaluation.cloud_metrics import MapClouds
from monoloc.geometry import FloatArray, make_pose
from monoloc.viz.edit_drawing import draw_edits
from monoloc.viz.map_view import MapView, plot_from_above, plot_from_pose
from monoloc.viz.rerun_edits import clear_edits, log_edits
from monoloc.viz.viewer import show_map_change
from plot_helpers import check_picture
from viewer_helpers import Recorded

SHIFT = np.array([0.9, 0.0, -0.4])
GIVEN = {"lower_m": (CUBE.centre - CUBE.half).tolist(), "upper_m": (CUBE.centre + CUBE.half).tolist()}


@pytest.fixture(scope="module")
def edits() -> tuple[DrawnEdit, ...]:
    rng = np.random.default_rng(0)
    given = GIVEN | {"by_m": SHIFT.tolist()}
    moved = move(mapped_room(), CUBE, make_pose(np.eye(3), SHIFT), given, rng)
    wall = Box(np.array([-1.0, -0.5, 3.0]), np.full(3, 0.3), np.eye(3))
    return drawn_edits(remove(moved, wall, {}, rng), rng)


def test_names_and_arrow_are_drawn_as_far_as_they_are_in_view(edits: tuple[DrawnEdit, ...]) -> None:
    def halved(points: FloatArray) -> FloatArray:
        """From the front; what is on the right is out of view."""
        return np.where(points[:, :1] < 0.5, points[:, :2], np.nan)

    for project, names in ((lambda points: points[:, :2], 3), (halved, 2)):
        axis = Figure().add_subplot()
        draw_edits(axis, edits, project)
        assert len(axis.texts) == names  # one of them is the arrow
        assert {text.get_text() for text in axis.texts} >= {"1 move", "2 remove"}


@pytest.mark.parametrize("with_content", [True, False])
def test_colours_that_occur_are_named(edits: tuple[DrawnEdit, ...], with_content: bool) -> None:
    """A move goes and comes; a removal only goes. Boxes have these colours also where nothing else is drawn."""
    for drawn, names in (
        (edits[:1], ["removed by an edit", "added by an edit"]),
        (edits[1:], ["removed by an edit"]),
    ):
        axis = Figure().add_subplot()
        draw_edits(axis, drawn, lambda points: points[:, :2], with_content=with_content)
        assert axis.get_legend_handles_labels()[1] == names


def test_names_of_edits_in_one_place_are_above_each_other(edits: tuple[DrawnEdit, ...]) -> None:
    axis = Figure().add_subplot()
    draw_edits(axis, (edits[1], edits[1], edits[1]), lambda points: points[:, :2])
    heights = sorted(text.xyann[1] for text in axis.texts if isinstance(text, Annotation) and text.get_text())
    assert len(heights) == 3 and np.all(np.diff(heights) > 10.0)


@pytest.mark.parametrize("is_inverted", [True, False])
def test_name_of_a_box_that_is_larger_than_the_page_is_on_the_page(
    edits: tuple[DrawnEdit, ...], is_inverted: bool
) -> None:
    large = replace(edits[1], place=Box(np.zeros(3), np.full(3, 50.0), np.eye(3)))
    figure = Figure()
    FigureCanvasAgg(figure)
    axis = figure.add_subplot()
    axis.set(xlim=(-2.0, 2.0), ylim=(1.0, -1.0) if is_inverted else (-1.0, 1.0))
    draw_edits(axis, (large, large, edits[1]), lambda points: points[:, :2])
    figure.canvas.draw()
    page = axis.get_window_extent()
    names = [text.get_window_extent() for text in axis.texts if text.get_text()]
    assert len(names) == 3
    assert all(page.y0 <= name.y0 and name.y1 <= page.y1 for name in names)


@pytest.mark.parametrize("is_from_above", [True, False])
@pytest.mark.filterwarnings("error")
def test_maps_with_edits_are_drawn(tmp_path: Path, is_from_above: bool, edits: tuple[DrawnEdit, ...]) -> None:
    room = mapped_room()
    cloud, poses = room.original.sample(2000, np.random.default_rng(0)), room.reference_poses.poses
    before, after = (MapView("A room", cloud, room.landmarks.points, poses, shown) for shown in (edits[:1], edits))
    if is_from_above:
        plot_from_above(tmp_path / "a.png", (before, after), make_pose(np.eye(3), np.zeros(3)))
    else:
        plot_from_pose(tmp_path / "a.png", (before, after), room.camera, poses[0])
    check_picture(tmp_path / "a.png", 1800, 400)


@pytest.mark.parametrize("is_edited", [False, True])
def test_viewer_lists_edits_by_number_and_kind(tmp_path: Path, edits: tuple[DrawnEdit, ...], is_edited: bool) -> None:
    cloud = mapped_room().original.sample(500, np.random.default_rng(0))
    shown = edits if is_edited else ()
    down = np.array([0.0, 1.0, 0.0])
    clouds = MapClouds(cloud, cloud, np.ones(500))
    show_map_change("a map", False, tmp_path / "map.rrd", clouds, down, shown)
    recorded = Recorded(tmp_path / "map.rrd")
    names = {entity.split("/")[3].replace("\\", "") for entity in recorded.entities if "/world/edits/" in entity}
    assert names == ({"1 move", "2 remove"} if is_edited else set())
    if is_edited:
        (entity,) = (entity for entity in recorded.entities if entity.endswith("1\\ move/arrow"))
        np.testing.assert_allclose(recorded.static(entity, "Arrows3D:vectors"), [SHIFT], atol=1e-6)
        (entity,) = (entity for entity in recorded.entities if entity.endswith("1\\ move/name"))
        assert recorded.static(entity, "Points3D:labels") == ["1 move"]
        top = recorded.static(entity, "Points3D:positions")
        np.testing.assert_allclose(top, [CUBE.centre + SHIFT - [0.0, CUBE.half[1], 0.0]], atol=1e-6)


def test_edits_of_a_room_that_is_left_are_taken_away(tmp_path: Path, edits: tuple[DrawnEdit, ...]) -> None:
    stream = rr.RecordingStream("a place")
    stream.save(tmp_path / "place.rrd")
    clear_edits(stream, log_edits(stream, edits, [0.0, 1.0, 0.0]))
    kept = log_edits(stream, edits[1:], [0.0, 1.0, 0.0])
    stream.disconnect()
    recorded = Recorded(tmp_path / "place.rrd")
    for entity in recorded.entities:
        number = int(entity.split("/")[3].partition("\\")[0])
        component = {"place": "Boxes3D:centers", "name": "Points3D:labels"}.get(entity.rpartition("/")[2])
        if component is not None:
            assert bool(len(recorded.static(entity, component))) == (number == 2)
    assert kept
