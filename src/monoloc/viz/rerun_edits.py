"""Edits of a map in Rerun's viewer: boxes, arrows, numbers, and what went and came."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike

from monoloc.editing.box import Box
from monoloc.editing.edit_history import DrawnEdit
from monoloc.geometry import FloatArray, rotation_to_quaternion

# As in pictures, but visible on Rerun's dark background.
_WENT, _CAME, _NAME = 0xD55E00FF, 0x2E8BFFFF, 0xFFFFFFFF


Logged = list[tuple[list[object], type[rr.Boxes3D | rr.Arrows3D | rr.Points3D]]]
"""Paths of entities, and what each is."""


def log_edits(stream: rr.RecordingStream, edits: tuple[DrawnEdit, ...], down: ArrayLike) -> Logged:
    """Log each edit below ``world/edits`` by its number and kind: red where something went, blue where it came.

    Args:
        stream: to the viewer.
        edits: of the map.
        down: (3,) approximate down direction in the world; a name stands on top of its box.

    Returns:
        What was logged, for :func:`clear_edits`.
    """
    logged: Logged = []
    for edit in edits:
        for name, entity in _entities(edit, np.asarray(down, dtype=np.float64)).items():
            path: list[object] = ["world", "edits", edit.name, name]
            stream.log(path, entity, static=True)
            logged.append((path, type(entity)))
    return logged


def clear_edits(stream: rr.RecordingStream, logged: Logged) -> None:
    """Take the edits of another map away."""
    for path, kind in logged:
        stream.log(path, kind.cleared(), static=True)


def _entities(edit: DrawnEdit, down: FloatArray) -> dict[str, rr.Boxes3D | rr.Arrows3D | rr.Points3D]:
    entities: dict[str, rr.Boxes3D | rr.Arrows3D | rr.Points3D] = {}
    if edit.place is not None:
        entities["place"] = _box(edit.place, _WENT if edit.is_taking or edit.moved_to else _CAME)
        entities["name"] = _name(edit.name, edit.moved_to or edit.place, down)
    if edit.place is not None and edit.moved_to is not None:
        entities["moved to"] = _box(edit.moved_to, _CAME)
        shift = edit.moved_to.centre - edit.place.centre
        radius = rr.Radius.ui_points(2.0)
        entities["arrow"] = rr.Arrows3D(origins=[edit.place.centre], vectors=[shift], colors=_NAME, radii=radius)
    for name, points, color, size in (
        ("removed", edit.went, _WENT, 1.5),
        ("added", edit.came, _CAME, 1.5),
        ("removed landmarks", edit.went_landmarks, _WENT, 2.5),
        ("added landmarks", edit.came_landmarks, _CAME, 2.5),
    ):
        if len(points):
            entities[name] = rr.Points3D(points, colors=color, radii=rr.Radius.ui_points(size))
    return entities


def _box(box: Box, color: int) -> rr.Boxes3D:
    return rr.Boxes3D(
        centers=[box.centre],
        half_sizes=[box.half],
        quaternions=[rotation_to_quaternion(box.R_world_box)],
        colors=color,
        fill_mode="majorwireframe",
        radii=rr.Radius.ui_points(1.5),
    )


def _name(name: str, box: Box, down: FloatArray) -> rr.Points3D:
    corners = box.corners
    top = corners[np.argsort(corners @ down)[:4]].mean(axis=0)
    return rr.Points3D([top], labels=[name], show_labels=True, colors=_NAME, radii=rr.Radius.ui_points(1.0))
