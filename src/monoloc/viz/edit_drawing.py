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

_NAME_SIZE = np.array([0.14, 0.07])  # of a name, of what is drawn
_ROW_POINTS = 13.0  # from one name to that above it
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
    _draw_names(axis, edits, project)
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


def _draw_names(axis: Axes, edits: Sequence[DrawnEdit], project: Projection) -> None:
    """Each on top of what is in view of its last box."""
    up = -1.0 if axis.yaxis_inverted() else 1.0
    tops = [(edit.name, _top(edit, project, up)) for edit in edits]
    draw_names(axis, [(name, top) for name, top in tops if top is not None])


def draw_names(axis: Axes, names: Sequence[tuple[str, FloatArray]]) -> None:
    """Draw names at places of a page, (2,), each above those that it would hide."""
    size = np.abs(axis.dataLim.size) * _NAME_SIZE
    up = -1.0 if axis.yaxis_inverted() else 1.0
    taken: list[FloatArray] = []
    for name, anchor in names:
        rows, at = 0, anchor
        while any((np.abs(at - other) < size).all() for other in taken) and rows < len(names):
            rows += 1
            at = anchor + np.array([0.0, up * rows * size[1]])
        taken.append(at)
        _draw_name(axis, name, anchor, rows)


def _top(edit: DrawnEdit, project: Projection, up: float) -> FloatArray | None:
    """Middle of the upper edge, (2,), of what is in view of an edit's last box; None if nothing is."""
    boxes = [project(box.corners) for box in (edit.moved_to, edit.place) if box is not None]
    in_view = [corners for box in boxes if len(corners := box[np.isfinite(box).all(axis=1)])]
    return np.array([in_view[0][:, 0].mean(), up * (up * in_view[0][:, 1]).max()]) if in_view else None


def _draw_name(axis: Axes, name: str, anchor: FloatArray, rows: int) -> None:
    """On white, so that it can be read over the map, so many rows above the anchor."""
    axis.annotate(
        name,
        (float(anchor[0]), float(anchor[1])),
        xytext=(0.0, 3.0 + _ROW_POINTS * rows),
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
