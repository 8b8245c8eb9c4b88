"""Figure of the original and the adapted map: clouds, boxes, distances and their histogram."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from monoloc.editing.box import EDGES
from monoloc.editing.edit_history import DrawnEdit
from monoloc.evaluation.cloud_metrics import MapClouds
from monoloc.geometry import FloatArray, so3_exp
from monoloc.viz.edit_drawing import draw_edits
from monoloc.viz.picture import BLUE, GREY, INK, ORANGE, picture
from monoloc.viz.run_drawing import page_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection

_ELEVATION_DEG, _AZIMUTHS_DEG = 28.0, (-60.0, 30.0, 120.0, 210.0)
_POINTS_DRAWN = 25_000  # of each cloud; more would occlude each other
_DOTS: dict[str, Any] = {"s": 2.2, "linewidths": 0.0, "rasterized": True}
_CMAP = "viridis"


def plot_map_change(
    path: str | Path,
    clouds: MapClouds,
    down: FloatArray,
    title: str = "",
    edits: tuple[DrawnEdit, ...] = (),
) -> None:
    """Plot both clouds, their bounding boxes, the original cloud coloured by distance, and a histogram of distances.

    The figure follows Shukla et al. 2023, figure 3. It uses a parallel projection from the corner of the room with
    the least occlusion.

    Args:
        path: PNG to write.
        clouds: of the map before and after adaptation.
        down: (3,) approximate down direction in the world.
        title: title of the figure.
        edits: of the map, drawn with the boxes.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
    """
    original, adapted, distances_m = clouds.original, clouds.adapted, clouds.distances_m
    eye = _Eye.before(original, down)
    limit_cm = max(0.1, 100.0 * float(np.percentile(distances_m, 99.0)))
    with picture(path, 12.0, 9.8) as figure:
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        # Leaves space between the labels of the colour bar and of the histogram.
        (merged, boxes), (coloured, histogram) = figure.subplots(2, 2, gridspec_kw={"wspace": 0.06})
        both = np.concatenate([_thinned(original), _thinned(adapted)])
        colours = np.repeat([BLUE, ORANGE], [len(_thinned(original)), len(_thinned(adapted))])
        _scatter(merged, eye, both, c=colours, alpha=0.6)
        for colour, name in ((BLUE, "original"), (ORANGE, "adapted")):
            merged.plot([], [], "o", color=colour, markersize=5, label=name)
        merged.set_title("Original and adapted cloud")
        _scatter(boxes, eye, _thinned(original), color=GREY, alpha=0.25)
        for cloud, colour in ((original, BLUE), (adapted, ORANGE)):
            _draw_box(boxes, eye, cloud, colour)
        draw_edits(boxes, edits, lambda points: eye.project(points)[:, :2])
        boxes.set_title("Bounding boxes (width × depth × height)")
        values = 100.0 * _thinned(distances_m)
        dots = _scatter(coloured, eye, _thinned(original), c=values, cmap=_CMAP, vmin=0.0, vmax=limit_cm)
        coloured.set_title("Original cloud, by distance to the adapted one")
        figure.colorbar(dots, ax=coloured, shrink=0.7, pad=0.01, extend="max", label="C2C distance (cm)")
        corners = np.concatenate([_corners(original), _corners(adapted)])
        for axis in (merged, boxes, coloured):
            _frame(axis, eye, corners)
        _draw_histogram(histogram, 100.0 * distances_m, limit_cm)


@dataclass(frozen=True)
class _Eye:
    """A parallel projection.

    Attributes:
        axes: world axes that point right, back and up.
        up_sign: -1 if up is the negative direction of its axis, else 1.
        R_page_axes: rotation from these axes to the page, whose third axis points towards the viewer.
    """

    axes: tuple[int, int, int]
    up_sign: float
    R_page_axes: FloatArray

    @classmethod
    def before(cls, cloud: FloatArray, down: FloatArray) -> _Eye:
        """The view, out of four corners, from which the points (N, 3) are farthest away on average."""
        right, back, up, flipped = page_axes(down)
        sign = -1.0 if flipped else 1.0
        eyes = [cls((right, back, up), sign, _turn(azimuth)) for azimuth in _AZIMUTHS_DEG]
        return min(eyes, key=lambda eye: float(np.mean(eye._of_box(cloud)[:, 2])))

    def project(self, points: FloatArray) -> FloatArray:
        """Map world (N, 3) to page (N, 3): right, up, towards the viewer; metres."""
        return np.asarray(points[:, self.axes] * [1.0, 1.0, self.up_sign] @ self.R_page_axes.T)

    def _of_box(self, cloud: FloatArray) -> FloatArray:
        return self.project(cloud - 0.5 * (cloud.min(axis=0) + cloud.max(axis=0)))


def _turn(azimuth_deg: float) -> FloatArray:
    """Rotation from the axes right, back, up to the page, for an elevated viewer at an azimuth."""
    to_front = so3_exp([np.deg2rad(_ELEVATION_DEG - 90.0), 0.0, 0.0])
    return np.asarray(to_front @ so3_exp([0.0, 0.0, np.deg2rad(-90.0 - azimuth_deg)]))


def _scatter(axis: Axes, eye: _Eye, points: FloatArray, **style: Any) -> PathCollection:
    """Plot points (N, 3), the nearest last."""
    page = eye.project(points)
    order = np.argsort(page[:, 2])
    if "c" in style:
        style["c"] = style["c"][order]
    return axis.scatter(page[order, 0], page[order, 1], **_DOTS, **style)


def _draw_box(axis: Axes, eye: _Eye, cloud: FloatArray, colour: str) -> None:
    page = eye.project(_corners(cloud))
    hidden = int(np.argmin(page[:, 2]))
    size_m = np.ptp(cloud, axis=0)[list(eye.axes)]
    axis.plot([], [], color=colour, label=" × ".join(f"{size:.2f}" for size in size_m) + " m")
    for edge in EDGES:
        behind = {"linestyle": (0, (3, 3)), "linewidth": 0.8} if hidden in edge else {"linewidth": 1.5}
        axis.plot(*page[list(edge), :2].T, color=colour, **behind)


def _corners(cloud: FloatArray) -> FloatArray:
    """Corners (8, 3) of a cloud's bounding box; corner n is at the upper end of axis i if bit i of n is set."""
    bounds = np.stack([cloud.min(axis=0), cloud.max(axis=0)])
    return np.array([[bounds[(corner >> bit) & 1, bit] for bit in range(3)] for corner in range(8)])


def _frame(axis: Axes, eye: _Eye, corners: FloatArray) -> None:
    """Set the same view in each panel, with axis arrows and a scale bar instead of ticks (the view is oblique)."""
    page = eye.project(corners)
    low, high = page.min(axis=0)[:2], page.max(axis=0)[:2]
    margin = 0.04 * (high - low).max()
    bottom = low[1] - 2.0 * margin  # below the boxes, whose edges would cross the scale bar
    axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(bottom - margin, high[1] + 3.0 * margin))
    axis.set(xticks=[], yticks=[])
    axis.set_aspect("equal")
    axis.spines[:].set_visible(False)
    arrows = 2.5 * margin * eye.R_page_axes[:2].T * [[1.0], [1.0], [eye.up_sign]]
    # Arrows beyond the panel would not be drawn.
    foot = np.array([low[0], bottom]) - np.minimum(0.0, arrows.min(axis=0))
    for world_axis, arrow in zip(eye.axes, arrows, strict=True):
        tip, shape = tuple(foot + arrow), {"arrowstyle": "->", "color": INK, "shrinkA": 0, "shrinkB": 0}
        axis.annotate("", tip, tuple(foot), zorder=3, arrowprops=shape)
        right_pt, up_pt = 7.0 * arrow / np.linalg.norm(arrow)
        beyond: Any = {"xytext": (right_pt, up_pt), "textcoords": "offset points"}
        axis.annotate("xyz"[world_axis], tip, **beyond, ha="center", va="center", fontsize=9)
    right = high[0]
    axis.plot([right - 1.0, right], [bottom] * 2, color=INK, linewidth=2.0, solid_capstyle="butt")
    axis.annotate("1 m", (right - 0.5, bottom), (0, 4), textcoords="offset points", ha="center", fontsize=9)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="upper right")


def _draw_histogram(axis: Axes, distances_cm: FloatArray, limit_cm: float) -> None:
    import matplotlib

    counts, edges = np.histogram(distances_cm, bins=50, range=(0.0, limit_cm))
    middles = 0.5 * (edges[:-1] + edges[1:])
    colours = matplotlib.colormaps[_CMAP](middles / limit_cm)
    shares = 100.0 * counts / len(distances_cm)
    axis.bar(middles, shares, width=np.diff(edges), color=colours)
    axis.set_ylim(0.0, 1.16 * shares.max())  # space for the labels of the lines
    middle, most = np.percentile(distances_cm, [50.0, 95.0])
    are_apart = most - middle > 0.1 * limit_cm  # else one label would cover the other
    both = f"median {middle:.1f} cm\n95 % {most:.1f} cm"
    lines = [(middle, f"median\n{middle:.1f} cm"), (most, f"95 %\n{most:.1f} cm")] if are_apart else [(most, both)]
    for value, label in lines:
        axis.axvline(value, color=INK, linewidth=1.0, linestyle=(0, (4, 2)))
        axis.annotate(
            label,
            (value, 0.99),
            (4, 0),
            xycoords=axis.get_xaxis_transform(),
            textcoords="offset points",
            va="top",
            fontsize=9,
        )
    axis.set(xlabel="C2C distance (cm)", ylabel="share of points (%)", xlim=(0.0, limit_cm))
    axis.set_title(f"Distances up to the 99th percentile (largest {distances_cm.max():.1f} cm)")


def _thinned(values: FloatArray) -> FloatArray:
    return values[:: max(1, len(values) // _POINTS_DRAWN)]
