"""Picture of an update: the map before and after from above, with what changes in colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.editing.edit_history import DrawnEdit
from monoloc.geometry import FloatArray, transform
from monoloc.viz.edit_drawing import draw_edits, draw_names
from monoloc.viz.picture import BLUE, GREEN, GREY, ORANGE, VERMILION, picture

_COLOURS = {
    "retire landmarks": VERMILION,
    "add landmarks": BLUE,
    "remove surfaces": ORANGE,
    "add surfaces": GREEN,
}
_BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "borderaxespad": 4.5, "ncols": 2}


@dataclass(frozen=True)
class UpdateView:
    """What is drawn of a map.

    Attributes:
        title: of the panel.
        cloud: points of its surface, (N, 3), world frame, metres.
        landmarks: (L, 3), world frame, metres.
        edits: of the map.
    """

    title: str
    cloud: FloatArray
    landmarks: FloatArray
    edits: tuple[DrawnEdit, ...]


def plot_update(
    path: str | Path,
    before: UpdateView,
    after: UpdateView,
    changes: Sequence[tuple[str, str, FloatArray]],
    T_level_world: FloatArray,
) -> None:
    """Draw both maps from above with their edits, and the proposed changes, with their ids, over the map before.

    Args:
        path: PNG to write.
        before, after: the map as it was, and with what was applied.
        changes: id and kind of each proposal, and its points, (N, 3), world frame, metres.
        T_level_world: to the axes that are drawn, z up, (4, 4).

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
    """

    def project(points: FloatArray) -> FloatArray:
        return transform(T_level_world, points)[:, :2]

    clouds = [project(view.cloud) for view in (before, after)]
    low, high = np.percentile(np.concatenate(clouds), [0.5, 99.5], axis=0)
    margin = 0.05 * float((high - low).max())
    size_in = 5.2 * float(np.clip((high - low)[1] / (high - low)[0], 0.5, 1.6))
    with picture(path, 17.0, size_in + 1.5) as figure:
        axes = figure.subplots(1, 3, squeeze=False)[0].tolist()
        for axis in axes:
            axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
            axis.set(xlabel="x of frame map (m)", ylabel="y of frame map (m)", aspect="equal")
        for axis, view, cloud in zip((axes[0], axes[2]), (before, after), clouds, strict=True):
            axis.plot(*cloud.T, ".", color=GREY, markersize=0.6, alpha=0.3, rasterized=True)
            axis.plot(
                *project(view.landmarks).T, ".", color=BLUE, markersize=1.5, label=f"{len(view.landmarks)} landmarks"
            )
            draw_edits(axis, view.edits, project, with_content=False)
            axis.set_title(view.title)
            axis.legend(**_BELOW)
        axis = axes[1]
        axis.plot(*clouds[0].T, ".", color=GREY, markersize=0.6, alpha=0.3, rasterized=True)
        for _, kind, points in changes:
            axis.plot(*project(points).T, ".", color=_COLOURS[kind], markersize=3.0)
        draw_names(axis, [(name, np.median(project(points), axis=0)) for name, _, points in changes])
        for kind in dict.fromkeys(kind for _, kind, _ in changes):
            axis.plot([], [], ".", color=_COLOURS[kind], markersize=8.0, label=kind)
        axis.set_title(f"{len(changes)} proposals")
        if changes:
            axis.legend(**_BELOW)
