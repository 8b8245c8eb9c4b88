"""Edits of a map in a picture: boxes, arrows, numbers, and what went and came."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from monoloc.editing.box import EDGES, Box
from monoloc.editing.edit_history import DrawnEdit
from monoloc.geometry import FloatArray
from monoloc.viz.picture import BLUE, INK, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Projection = Callable[[FloatArray], FloatArray]
"""Points (N, 3), world frame, metres, to the page (N, 2); NaN where they are out of view."""

_STEPS = np.linspace(0.0, 1.0, 17)[:, None]  # of a line, a part of which may be out of view


def draw_edits(axis: Axes, edits: Sequence[DrawnEdit], project: Projection, with_content: bool = True) -> None:
    """Draw edits: red where something went, blue where something came, each with its number and kind.

    Args:
        axis: to draw on.
        edits: of the map.
        project: from the world to the page.
        with_content: whether to draw the surfaces and landmarks, too.
    """
    for edit in edits:
        if with_content:
            _draw_content(axis, edit, project)
    for edit in edits:
        if edit.place is not None:
            _draw_box(axis, edit.place, VERMILION if edit.is_taking or edit.moved_to else BLUE, project)
        if edit.place is not None and edit.moved_to is not None:
            _draw_box(axis, edit.moved_to, BLUE, project)
            _draw_arrow(axis, project(_line(edit.place.centre, edit.moved_to.centre)))
    for edit in edits:
        _draw_name(axis, edit, project)
    if edits and with_content:
        for colour, name in ((VERMILION, "went by an edit"), (BLUE, "came by an edit")):
            axis.plot([], [], "s", color=colour, markersize=5.0, label=name)


def _draw_content(axis: Axes, edit: DrawnEdit, project: Projection) -> None:
    for points, landmarks, colour in (
        (edit.went, edit.went_landmarks, VERMILION),
        (edit.came, edit.came_landmarks, BLUE),
    ):
        axis.plot(*project(points).T, ".", color=colour, markersize=1.6, alpha=0.7, rasterized=True)
        axis.plot(*project(landmarks).T, ".", color=colour, markersize=3.0)


def _draw_box(axis: Axes, box: Box, colour: str, project: Projection) -> None:
    for edge in EDGES:
        axis.plot(*project(_line(*box.corners[list(edge)])).T, color=colour, linewidth=1.3)


def _line(start: FloatArray, end: FloatArray) -> FloatArray:
    return np.asarray(start + _STEPS * (end - start))


def _draw_arrow(axis: Axes, page: FloatArray) -> None:
    if np.isfinite(page).all():
        style = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.6, "shrinkA": 0.0, "shrinkB": 0.0}
        axis.annotate("", tuple(page[-1]), xytext=tuple(page[0]), arrowprops=style)


def _draw_name(axis: Axes, edit: DrawnEdit, project: Projection) -> None:
    """On top of what is in view of its last box, on white so that it can be read over the map."""
    boxes = [project(box.corners) for box in (edit.moved_to, edit.place) if box is not None]
    in_view = [corners for box in boxes if len(corners := box[np.isfinite(box).all(axis=1)])]
    if not in_view:
        return
    corners = in_view[0]
    is_downward = axis.yaxis_inverted()
    top = corners[:, 1].min() if is_downward else corners[:, 1].max()
    axis.annotate(
        edit.name,
        (float(corners[:, 0].mean()), float(top)),
        xytext=(0.0, 3.0),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=9,
        fontweight="bold",
        color=INK,
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        annotation_clip=True,
        zorder=6,
    )
