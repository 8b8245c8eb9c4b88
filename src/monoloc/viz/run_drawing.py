"""The two halves of the localisation figure: views of the map, and errors over time.

Drawing functions return their artists by name, for one legend below both halves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from monoloc.editing.edit_history import DrawnEdit
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray
from monoloc.viz.edit_drawing import draw_edits
from monoloc.viz.picture import BLUE, GREEN, INK, ORANGE, PURPLE, VERMILION, YELLOW

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

_STATE_STRIP = 0.95, 1.0  # of a panel's height
_STATE_COLOURS = {"uncertain": YELLOW, "lost": VERMILION, "map-changed": PURPLE}
_DASHED = (0, (4, 2))
_ELLIPSE_SIGMA = 1.5
_VIEWS_ASPECT = 1.05  # total height of both views over their width, in the left half
_ARROWS_DRAWN = 16
_ARROWS_PER_WIDTH = 22.0  # width of the view over the length of an arrow
_VIEW_WIDTH_PT = 390.0  # approximate
_NAME_PT = (15.0, 6.0)  # half of the width and height of "start"
_GAP_PT = 4.0  # minimum distance of a label from what it must not cover


@dataclass(frozen=True)
class DrawnRun:
    """What is drawn of a run of N frames; of what is None, nothing.

    Attributes:
        estimated: ``T_world_camera``, (N, 4, 4).
        timestamps_s: (N,) seconds.
        truth: true ``T_world_camera``, (N, 4, 4), in the same world frame.
        covariances: (N, 6, 6) in the estimated camera's tangent space, order (rho, phi), m and rad.
        odometry: ``T_world_camera`` from odometry alone, (N, 4, 4), in the same world frame.
        unseen: (N,) True for frames that were not used to build the map.
        states: state of each frame, N of :data:`monoloc.supervision.state.State`.
        mixture: means (K, 3) and covariances (K, 3, 3) of the map, world frame, metres.
        edits: of the map.
    """

    estimated: FloatArray
    timestamps_s: FloatArray
    truth: FloatArray | None = None
    covariances: FloatArray | None = None
    odometry: FloatArray | None = None
    unseen: NDArray[np.bool_] | None = None
    states: Sequence[str] | None = None
    mixture: tuple[FloatArray, FloatArray] | None = None
    edits: Sequence[DrawnEdit] = ()

    def in_state(self, state: str) -> NDArray[np.bool_]:
        """Whether each frame is in the state, (N,); False if the states are unknown."""
        return np.array([s == state for s in self.states or [""] * len(self.estimated)])


# --- Views of the map ---


def draw_views(figure: SubFigure, run: DrawnRun) -> dict[str, Artist]:
    """Draw the trajectory over the map, from above and from the side."""
    right, forward, up, up_is_negative = view_axes(run.estimated)
    low_m, high_m = _bounds(run, (right, forward, up))
    heights = [high_m[axis] - low_m[axis] for axis in (forward, up)]
    top, side = figure.subplots(2, 1, height_ratios=heights)
    shown: dict[str, Artist] = {}
    for axis, plane in ((top, [right, forward]), (side, [right, up])):
        # matplotlib derives the step for rotated arrows from the extent of the data, which is 0 for a single frame.
        axis.update_datalim([low_m[plane], high_m[plane]])
        axis.set_xlim(low_m[plane[0]], high_m[plane[0]])
        axis.set_ylim(low_m[plane[1]], high_m[plane[1]])
        axis.set_aspect("equal", anchor="W")
        axis.set(xlabel=f"{'xyz'[plane[0]]} of the world (m)", ylabel=f"{'xyz'[plane[1]]} of the world (m)")
        if axis is side and up_is_negative:
            axis.invert_yaxis()
        _draw_map(axis, plane, run)
        draw_edits(axis, run.edits, partial(np.take, indices=plane, axis=1), with_content=False)
        shown |= _draw_trajectories(axis, plane, run)
    top.set_title("From above (arrows: viewing direction)")
    side.set_title("From the side")
    return shown


def view_axes(poses: FloatArray) -> tuple[int, int, int, bool]:
    """:func:`page_axes` from poses (N, 4, 4) of cameras that are upright on average."""
    return page_axes(poses[:, :3, 1].mean(axis=0))  # camera's y axis in the world


def page_axes(down: FloatArray) -> tuple[int, int, int, bool]:
    """World axes that point right, forward and up on the page, and whether up is the negative direction of its axis.

    Args:
        down: (3,) down direction in the world, of any length.
    """
    up = int(np.argmax(np.abs(down)))
    right, forward = (up + 1) % 3, (up + 2) % 3  # right x forward = +up, so nothing is mirrored
    return (forward, right, up, True) if down[up] > 0.0 else (right, forward, up, False)


def _bounds(run: DrawnRun, axes: tuple[int, int, int]) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner (3,) of the shown box, which contains the trajectories and the map without outliers.

    The box is enlarged so that the two views, stacked and at one scale, fill their half of the figure.
    """
    corners = [T[:, :3, 3] for T in (run.estimated, run.truth, run.odometry) if T is not None]
    if run.mixture is not None:
        corners.append(np.percentile(run.mixture[0], [2.0, 98.0], axis=0))
    every = np.concatenate(corners)
    centre_m = 0.5 * (every.min(axis=0) + every.max(axis=0))
    extent_m = np.ptp(every, axis=0)
    extent_m += 0.1 * extent_m.max() + 0.1

    right, forward, up = axes
    extent_m[up] = max(extent_m[up], 0.3 * extent_m[forward])
    height_m, width_m = extent_m[forward] + extent_m[up], extent_m[right]
    extent_m[right] = max(width_m, height_m / _VIEWS_ASPECT)
    extent_m[[forward, up]] *= max(1.0, width_m * _VIEWS_ASPECT / height_m)
    return centre_m - 0.5 * extent_m, centre_m + 0.5 * extent_m


def _draw_map(axis: Axes, plane: list[int], run: DrawnRun) -> None:
    if run.mixture is not None:
        draw_mixture(axis, plane, *run.mixture)


def draw_mixture(axis: Axes, plane: list[int], means: FloatArray, covariances: FloatArray) -> None:
    """Draw a map's components as ellipses in the background: means (K, 3), covariances (K, 3, 3), world frame."""
    from matplotlib.collections import EllipseCollection

    variances, vectors = np.linalg.eigh(covariances[:, plane][:, :, plane])
    minor_m, major_m = 2.0 * _ELLIPSE_SIGMA * np.sqrt(np.maximum(variances, 0.0)).T
    ellipses = EllipseCollection(
        major_m,
        minor_m,
        np.rad2deg(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])),
        units="xy",
        offsets=means[:, plane],
        offset_transform=axis.transData,
        facecolor=(0.5, 0.5, 0.5, 0.07),
        edgecolor=(0.5, 0.5, 0.5, 0.35),
        linewidth=0.6,
        zorder=0,
    )
    axis.add_collection(ellipses, autolim=False)


def _draw_trajectories(axis: Axes, plane: list[int], run: DrawnRun) -> dict[str, Artist]:
    shown: dict[str, Artist] = {}

    def draw(name: str, poses: FloatArray, *style: str, **details: Any) -> None:
        (shown[name],) = axis.plot(*poses[:, plane, 3].T, *style, **details)

    if run.odometry is not None:
        # With true poses, odometry starts at the truth; the estimate may start elsewhere.
        name = "odometry alone" if run.truth is None else "odometry alone, from the true start"
        draw(name, run.odometry, color=ORANGE, linestyle=_DASHED, linewidth=1.2)
    if run.truth is not None:
        draw("truth", run.truth, color=INK, linewidth=3.5, alpha=0.35)
    lost = run.in_state("lost")
    draw("estimate", np.where(lost[:, None, None], np.nan, run.estimated), color=BLUE, linewidth=1.3)
    if run.unseen is not None and not run.unseen.all():
        reference = run.estimated if run.truth is None else run.truth
        style = {"markersize": 3.2, "markerfacecolor": "none", "markeredgewidth": 0.8}
        draw("frames that built the map", reference[~run.unseen], "o", color=GREEN, **style)
    for state, colour in _STATE_COLOURS.items():
        if (selected := run.in_state(state)).any():
            axis.plot(*run.estimated[selected][:, plane, 3].T, "x", color=colour, markersize=5)

    some = run.estimated[:: max(1, len(run.estimated) // _ARROWS_DRAWN)]
    axis.quiver(
        *some[:, plane, 3].T,
        *some[:, plane, 2].T,
        angles="xy",
        scale=_ARROWS_PER_WIDTH,
        width=0.0035,
        color=BLUE,
        alpha=0.8,
    )
    # The labels of start and end must not cover trajectories, arrows, or each other.
    arrow = np.ptp(axis.get_xlim()) / _ARROWS_PER_WIDTH * some[:, plane, 2]
    crowd = [T[:, plane, 3] for T in (run.estimated, run.truth, run.odometry) if T is not None]
    crowd += [some[:, plane, 3] + share * arrow for share in (0.5, 1.0)]
    for pose, marker, name in ((run.estimated[0], "o", "start"), (run.estimated[-1], "s", "end")):
        at = pose[plane, 3]
        axis.plot(*at, marker, color=BLUE, markeredgecolor="white", markersize=8)
        (right_pt, up_pt), box = _beside(axis, at, np.concatenate(crowd))
        place: Any = {"xytext": (right_pt, up_pt), "textcoords": "offset points"}
        axis.annotate(name, at, **place, ha="center", va="center_baseline", color=BLUE)
        crowd.append(box)
    return shown


def _beside(axis: Axes, at: FloatArray, crowd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Place a label next to a point (2,) so that it covers no other points (N, 2), and then far from their mean.

    Returns:
        Offset of the label in points (2,), and centre and corners (5, 2) of its box, inside the limits of the axis.
    """
    low, high = (np.array(ends) for ends in zip(axis.get_xlim(), axis.get_ylim(), strict=True))
    m_per_pt = np.sign(high - low) * (high[0] - low[0]) / _VIEW_WIDTH_PT
    low_pt, high_pt, crowd_pt = (low - at) / m_per_pt, (high - at) / m_per_pt, (crowd - at) / m_per_pt
    middle_pt = crowd_pt.mean(axis=0)

    def merit(offset_pt: FloatArray) -> tuple[float, float]:
        ends_pt = offset_pt - _NAME_PT, offset_pt + _NAME_PT
        inside = np.all(ends_pt[0] > low_pt) and np.all(ends_pt[1] < high_pt)
        gap_pt = np.min(np.max(np.abs(crowd_pt - offset_pt) - _NAME_PT, axis=1)) if inside else -np.inf
        return min(float(gap_pt), _GAP_PT), float(np.linalg.norm(offset_pt - middle_pt))

    sides = [np.array([x, y]) for x in (1.0, -1.0, 0.0) for y in (-1.0, 1.0, 0.0) if x or y]
    best = max((side * (np.array(_NAME_PT) + _GAP_PT + 1.0) for side in sides), key=merit)
    corners = np.array([(0, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)])
    return best, at + (best + corners * _NAME_PT) * m_per_pt


# --- Errors over time ---


def draw_errors(figure: SubFigure, run: DrawnRun) -> dict[str, Artist]:
    """Draw position and rotation errors over time, with the bounds of the covariances."""
    nothing = (None, None)
    own = nothing if run.truth is None else _errors_cm_deg(run.estimated, run.truth)
    drift = nothing if run.truth is None or run.odometry is None else _errors_cm_deg(run.odometry, run.truth)
    bounds = nothing if run.covariances is None else _bounds_cm_deg(run.covariances)

    position, rotation = figure.subplots(2, 1, sharex=True)
    shown = _draw_error(position, "Position", " cm", run, own[0], drift[0], bounds[0])
    _draw_error(rotation, "Rotation", "°", run, own[1], drift[1], bounds[1])
    rotation.set_xlabel("time (s)")
    return shown


def _draw_error(
    axis: Axes,
    name: str,
    unit: str,
    run: DrawnRun,
    error: FloatArray | None,
    drift: FloatArray | None,
    bound: FloatArray | None,
) -> dict[str, Artist]:
    from matplotlib.patches import Patch

    shown: dict[str, Artist] = {}
    time_s = run.timestamps_s - run.timestamps_s[0]
    if bound is not None:
        axis.fill_between(time_s, bound, color=BLUE, alpha=0.15, linewidth=0.0)
        # Not the band itself: before matplotlib 3.10.5, a figure's legend refuses an artist of a subfigure.
        shown["stated 95 % bound"] = Patch(color=BLUE, alpha=0.15, linewidth=0.0)
    if drift is not None:
        axis.plot(time_s, drift, color=ORANGE, linestyle=_DASHED, linewidth=1.2)
    if error is not None:
        axis.plot(time_s, error, color=BLUE, linewidth=1.3)
    for state, colour in _STATE_COLOURS.items():
        # A state lasts until the next frame. The edges of the mask are starts and ends of intervals.
        edges = np.flatnonzero(np.diff(run.in_state(state).astype(np.int8), prepend=0, append=0))
        for start, end in edges.reshape(-1, 2):
            until_s = time_s[min(end, len(time_s) - 1)]
            # Along the upper edge: over the band, neither colour would be that of the legend.
            shown[state] = axis.axvspan(time_s[start], until_s, *_STATE_STRIP, color=colour, linewidth=0.0)
    if run.unseen is not None:
        built_s = time_s[~run.unseen]
        foot = np.full_like(built_s, 0.012)
        axis.plot(built_s, foot, "|", color=GREEN, markersize=6, transform=axis.get_xaxis_transform())
    axis.set_title(_error_title(name, unit, error, run.unseen))
    axis.set_ylabel(f"{name.lower()} {'bound' if error is None else 'error'} ({unit.strip()})")
    counts = ~run.in_state("lost")  # the error of a lost camera is meaningless
    counts |= not counts.any()
    curves = (None if curve is None else curve[counts] for curve in (error, drift, bound))
    axis.set_ylim(0.0, _error_limit(*curves))
    axis.margins(x=0.01)
    return shown


def _error_title(name: str, unit: str, error: FloatArray | None, unseen: NDArray[np.bool_] | None) -> str:
    if error is None:
        return f"{name}: no truth was given"

    def numbers(e: FloatArray) -> str:
        return f"median {np.median(e):.1f}{unit}, RMSE {np.sqrt(np.mean(e**2)):.1f}{unit}"

    text = f"{name} error: {numbers(error)}"
    if unseen is not None and unseen.any() and not unseen.all():
        text += f"\nframes that did not build the map: {numbers(error[unseen])}"
    return text


def _error_limit(error: FloatArray | None, drift: FloatArray | None, bound: FloatArray | None) -> float:
    """Upper limit of the axis: it shows the whole error, and drift and bound up to three times the largest error."""
    rest = max((float(np.max(v)) for v in (drift, bound) if v is not None), default=0.0)
    highest = rest if error is None else max(float(np.max(error)), min(rest, 3.0 * float(np.max(error))))
    return 1.08 * highest or 1.0


def _errors_cm_deg(poses: FloatArray, truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    errors = pose_errors(poses, truth)
    return 100.0 * errors.position_m, np.rad2deg(errors.rotation_rad)


def _bounds_cm_deg(covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    return 100.0 * norm_bound_95(covariances[:, :3, :3]), np.rad2deg(norm_bound_95(covariances[:, 3:, 3:]))


def norm_bound_95(covariances: FloatArray) -> FloatArray:
    """95 % quantile of the length of a zero-mean Gaussian vector: covariances (N, 3, 3) -> (N,).

    The squared length is approximated by a scaled chi-squared with the same first two moments (Satterthwaite 1946),
    and its quantile by Wilson and Hilferty (1931). The result is within about 2 % of the exact length.
    """
    mean = np.trace(covariances, axis1=-2, axis2=-1)
    half_variance = np.sum(covariances**2, axis=(-1, -2))
    # A zero covariance has no degrees of freedom. Any number is valid, because the mean of 0 makes the bound 0.
    dof = np.where(half_variance > 0.0, mean**2 / np.where(half_variance > 0.0, half_variance, 1.0), 1.0)
    spread = 2.0 / (9.0 * dof)
    return np.asarray(np.sqrt(mean * (1.0 - spread + 1.6449 * np.sqrt(spread)) ** 3))
