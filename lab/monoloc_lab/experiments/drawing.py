"""Plots that several figures share: ranges over seeds, trajectories in the map, images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.viz.picture import BLUE, GREEN, INK, PURPLE, VERMILION
from monoloc.viz.run_drawing import draw_mixture, view_axes
from monoloc_lab.experiments.gather import Spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

SIZE_COLOURS = (BLUE, GREEN, VERMILION, PURPLE)  # of the networks, largest first
CM = 100.0  # in a metre
_ROBUST = (2.0, 98.0)  # percentiles of a trajectory that the view contains
_MARGIN_M = 0.25
_LEAST_SHAPE = 0.45  # height of a view over its width


@dataclass(frozen=True)
class Series:
    """The spreads of one method, one per group of the axis; None where there is none."""

    name: str
    colour: str
    spreads: Sequence[Spread | None]


def draw_ranges(axis: Axes, groups: Sequence[str], series: Sequence[Series]) -> None:
    """Medians over seeds as dots, ranges as bars, in groups, of spreads in metres; the axis is logarithmic, in cm."""
    step = 0.76 / max(1, len(series))
    for number, one in enumerate(series):
        offset = (number - 0.5 * (len(series) - 1)) * step
        for group, spread in enumerate(one.spreads):
            if spread is None or not spread.values:
                continue
            at, median_cm, (low, high) = group + offset, CM * spread.median, spread.range
            axis.plot([at, at], [CM * low, CM * high], color=one.colour, linewidth=5.0, alpha=0.3)
            axis.plot(at, median_cm, "o", color=one.colour, markersize=6.5, markeredgecolor="white")
            axis.annotate(
                f"{median_cm:.2g}" if median_cm < 10 else f"{median_cm:.0f}",
                (at, CM * high),
                (0, 4),
                textcoords="offset points",
                ha="center",
                fontsize=7.5,
                color=one.colour,
            )
        axis.plot([], [], "o", color=one.colour, label=one.name)
    for group in range(1, len(groups)):
        axis.axvline(group - 0.5, color="#E8E8E8", linewidth=1.0)
    axis.set_xticks(range(len(groups)), groups)
    axis.set_xlim(-0.5, len(groups) - 0.5)
    axis.grid(False, axis="x")
    axis.tick_params(axis="x", length=0)
    logarithmic(axis.yaxis)


def draw_points(
    axis: Axes, title: str, groups: Sequence[str], series: Mapping[str, tuple[str, Sequence[Sequence[float]]]]
) -> None:
    """Single values as dots, in groups; the axis is logarithmic.

    Args:
        series: by its name, the colour and the values of each group.
    """
    for number, (name, (colour, values)) in enumerate(series.items()):
        offset = 0.2 * (number - 0.5 * (len(series) - 1))
        points = [(group + offset, value) for group, each in enumerate(values) for value in each]
        axis.plot(*np.transpose(points or [(0.0, np.nan)]), "o", color=colour, markersize=6, label=name)
    axis.set_xticks(range(len(groups)), groups)
    axis.set_yscale("log")
    axis.grid(axis="y", alpha=0.3)
    axis.set_title(title)


def draw_bound(axis: Axes, name: str, spread: Spread, colour: str, style: Any) -> None:
    """A horizontal line for a spread in metres that all groups share; the axis is in centimetres."""
    if spread.values:
        axis.axhline(CM * spread.median, color=colour, linestyle=style, linewidth=1.2, zorder=1, label=name)


def logarithmic(axis: Any) -> None:
    """Make an x or y axis logarithmic, with plain numbers; call it after everything is drawn."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    axis._set_axes_scale("log")
    axis.axes.autoscale_view()
    low, high = axis.get_view_interval()
    few, many = (1.0, 2.0, 5.0), (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)
    axis.set_major_locator(LogLocator(subs=few if high > 6.0 * low else many))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def legend_below(figure: Figure | SubFigure, axes: Sequence[Axes], columns: int) -> None:
    """One legend for all panels, with each name once."""
    named: dict[str, Any] = {}
    for axis in axes:
        handles, names = axis.get_legend_handles_labels()
        for name, handle in zip(names, handles, strict=True):
            named.setdefault(name, handle)
    figure.legend(list(named.values()), list(named), loc="outside lower center", ncols=columns)


@dataclass(frozen=True)
class DrawnTrajectory:
    """A trajectory in a plot.

    Attributes:
        poses: ``T_world_camera`` (N, 4, 4), NaN for frames without a pose.
        points: draw points, not a line, because the method localises every frame on its own.
    """

    name: str
    colour: str
    poses: FloatArray
    points: bool = False


@dataclass(frozen=True)
class Views:
    """The extent of two views, from above and from the side, at one scale.

    Attributes:
        axes: world axes that point right, forward and up on the page.
        up_is_negative: whether the last of these axes points down.
        low, high: corners (3,) of the extent, in the order of ``axes``.
    """

    axes: tuple[int, int, int]
    up_is_negative: bool
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, truth: FloatArray, trajectories: Sequence[FloatArray]) -> Views:
        """Views that contain the whole truth (N, 4, 4) and the trajectories without their outliers."""
        right, forward, up, up_is_negative = view_axes(truth)
        axes = [right, forward, up]
        positions = [poses[np.isfinite(poses).all(axis=(1, 2))][:, axes, 3] for poses in trajectories]
        without_outliers = [np.percentile(each, _ROBUST, axis=0) for each in positions if len(each)]
        corners = np.concatenate([truth[:, axes, 3], *without_outliers])
        low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
        middle, size = 0.5 * (low + high), high - low
        size[0] = max(size[0], size[1] * _LEAST_SHAPE)
        size[1] = max(size[1], size[0] * _LEAST_SHAPE)
        return cls((right, forward, up), up_is_negative, middle - 0.5 * size, middle + 0.5 * size)

    @property
    def shape(self) -> float:
        """Height of both views together, over their width."""
        width, depth, height = self.high - self.low
        return float((depth + height) / width)


def draw_trajectories(
    figure: Figure,
    panels: Mapping[str, Sequence[DrawnTrajectory]],
    truth: FloatArray,
    views: Views,
    room: tuple[FloatArray, FloatArray],
) -> list[Axes]:
    """Draw trajectories over the map of a room, one column per title.

    Args:
        truth: ``T_world_camera``, (N, 4, 4).
        room: means (K, 3) and covariances (K, 3, 3) of the map.

    Returns:
        The axes, for a legend.
    """
    right, forward, up = views.axes
    _, depth, height = views.high - views.low
    grid = figure.subplots(
        2, len(panels), squeeze=False, sharex=True, sharey="row", gridspec_kw={"height_ratios": [depth, height]}
    )
    for column, (title, trajectories) in enumerate(panels.items()):
        for row, plane in enumerate(([right, forward], [right, up])):
            axis = grid[row, column]
            draw_mixture(axis, plane, *room)
            axis.plot(*truth[:, plane, 3].T, color=INK, linewidth=4.0, alpha=0.3, label="truth")
            for drawn in trajectories:
                style: Any = {"linestyle": "", "marker": "."} if drawn.points else {"linewidth": 1.4}
                axis.plot(*drawn.poses[:, plane, 3].T, color=drawn.colour, markersize=4, label=drawn.name, **style)
            axis.plot(*truth[0, plane, 3], "o", color=INK, markersize=6, markeredgecolor="white", label="true start")
            axis.set(xlim=(views.low[0], views.high[0]), ylim=(views.low[1 + row], views.high[1 + row]))
            axis.set_aspect("equal")
        grid[0, column].set_title(title)
        grid[1, column].set_xlabel(f"{'xyz'[right]} (m)")
    if views.up_is_negative:
        grid[1, 0].invert_yaxis()
    grid[0, 0].set_ylabel(f"from above: {'xyz'[forward]} (m)")
    grid[1, 0].set_ylabel(f"side: {'xyz'[up]} (m)")
    return list(grid.ravel())


def show_image(axis: Axes, image: Any, title: str = "", **style: Any) -> Any:
    """Show an image without ticks, grey where it is undefined."""
    shown = axis.imshow(image, **style)
    axis.set(xticks=[], yticks=[], facecolor="#D0D0D0")
    axis.grid(False)
    axis.spines[:].set_visible(False)
    if title:
        axis.set_title(title, fontsize=9.5)
    return shown
