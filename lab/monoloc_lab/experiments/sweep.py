"""Plots of one varied setting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from monoloc_lab.experiments.drawing import CM, logarithmic
from monoloc_lab.experiments.gather import Spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_sweep(axis: Axes, name: str, colour: str, points: Mapping[float, Spread], marker: str = "o") -> None:
    """Medians over seeds connected by a line, ranges as bars; both axes are logarithmic.

    Args:
        points: by the value of the setting, which is positive; in metres, drawn in centimetres.
    """
    found = {value: spread for value, spread in points.items() if spread.values}
    values = list(found)
    medians = [CM * spread.median for spread in found.values()]
    low, high = ([CM * spread.range[end] for spread in found.values()] for end in (0, 1))
    axis.vlines(values, low, high, color=colour, alpha=0.3, linewidth=5.0)
    axis.plot(values, medians, marker, linestyle="-", color=colour, markeredgecolor="white", markersize=7, label=name)
    logarithmic(axis.xaxis)
    logarithmic(axis.yaxis)


def mark_default(axis: Axes, value: float) -> None:
    """A vertical line at the default."""
    axis.axvline(value, color="#666666", linewidth=1.0, linestyle=(0, (2, 2)), zorder=0)
    axis.annotate(
        "default",
        (value, 1.0),
        (3, -3),
        xycoords=axis.get_xaxis_transform(),
        textcoords="offset points",
        va="top",
        fontsize=8,
        color="#666666",
    )


def least(points: Mapping[float, Spread]) -> float:
    """The value with the smallest median."""
    return min((value for value in points if points[value].values), key=lambda value: points[value].median)


def row_of(label: Sequence[str], *spreads: Spread) -> tuple[str, ...]:
    """A table row of errors in centimetres."""
    return (*label, *(spread.centimetres() for spread in spreads))
