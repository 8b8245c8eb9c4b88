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
_ROWS_ABOVE = 2.0  # that fit above a name, or it and others go below
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
    _name_colours(axis, edits, with_content)


def _name_colours(axis: Axes, edits: Sequence[DrawnEdit], with_content: bool) -> None:
    """Entries of a legend for the colours that occur."""
    went = any(edit.place is not None and (edit.is_taking or edit.moved_to is not None) for edit in edits)
    came = any(edit.moved_to is not None or (edit.place is not None and not edit.is_taking) for edit in edits)
    if with_content:
        went |= any(len(edit.went) + len(edit.went_landmarks) > 0 for edit in edits)
        came |= any(len(edit.came) + len(edit.came_landmarks) > 0 for edit in edits)
    for colour, name, occurs in ((VERMILION, "removed by an edit", went), (BLUE, "added by an edit", came)):
        if occurs:
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
    tops = [(edit.name, _top(axis, edit, project)) for edit in edits]
    draw_names(axis, [(name, top) for name, top in tops if top is not None])


def draw_names(axis: Axes, names: Sequence[tuple[str, FloatArray]]) -> None:
    """Draw names at places of a page, (2,), above those that each would hide, or below near the upper border."""
    lower, upper = _limits(axis)
    size = (upper - lower) * _NAME_SIZE
    up = -1.0 if axis.yaxis_inverted() else 1.0
    border = upper[1] if up > 0.0 else lower[1]
    taken: list[FloatArray] = []
    for name, anchor in names:
        is_below = up * (border - anchor[1]) < _ROWS_ABOVE * size[1]
        step = np.array([0.0, -up * size[1] if is_below else up * size[1]])
        rows = 0
        while any((np.abs(anchor + rows * step - other) < size).all() for other in taken) and rows < len(names):
            rows += 1
        taken.append(anchor + rows * step)
        _draw_name(axis, name, anchor, rows, is_below)


def _limits(axis: Axes) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits of a page, (2,) each."""
    both = np.sort([axis.get_xlim(), axis.get_ylim()], axis=1)
    return both[:, 0], both[:, 1]


def _top(axis: Axes, edit: DrawnEdit, project: Projection) -> FloatArray | None:
    """Middle of the upper edge, (2,), of what is on the page of an edit's last box; None if nothing is."""
    lower, upper = _limits(axis)
    for box in (edit.moved_to, edit.place):
        corners = np.zeros((0, 2)) if box is None else project(box.corners)
        corners = corners[np.isfinite(corners).all(axis=1)]
        if len(corners) and np.all(corners.max(axis=0) > lower) and np.all(corners.min(axis=0) < upper):
            seen = np.clip(corners, lower, upper)
            highest = seen[:, 1].min() if axis.yaxis_inverted() else seen[:, 1].max()
            return np.array([0.5 * (seen[:, 0].min() + seen[:, 0].max()), highest])
    return None


def _draw_name(axis: Axes, name: str, anchor: FloatArray, rows: int, is_below: bool) -> None:
    """On white, so that it can be read over the map, so many rows from the anchor, with a line to it."""
    offset = 3.0 + _ROW_POINTS * rows
    axis.annotate(
        name,
        (float(anchor[0]), float(anchor[1])),
        xytext=(0.0, -offset if is_below else offset),
        textcoords="offset points",
        ha="center",
        va="top" if is_below else "bottom",
        fontsize=9,
        fontweight="bold",
        color=INK,
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        arrowprops={"arrowstyle": "-", "color": INK, "linewidth": 0.8} if rows else None,
        annotation_clip=True,
        zorder=6,
    )
