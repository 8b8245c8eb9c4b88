"""Pictures of a map: from above or as a camera sees it; of two maps of one world, what only one of them holds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.editing.edit_history import DrawnEdit
from monoloc.errors import SettingError
from monoloc.evaluation.cloud_metrics import cloud_distances
from monoloc.geometry import FloatArray, invert, transform
from monoloc.map.depth_rendering import cloud_depth, point_spacing_m
from monoloc.viz.edit_drawing import draw_edits
from monoloc.viz.picture import BLUE, GREY, INK, ORANGE, VERMILION, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

CHANGED_M = 0.15
"""Distance to the other map's nearest point, from which a point is only in one: it went or came, or the other
recording did not see it."""

ABOVE_CAMERAS_M = 0.2
"""Surfaces higher than that above the highest camera, such as the ceiling, are left out of pictures from above."""

_VIEW_PX = 480  # width of a view from a pose
_CMAP = "viridis"
_BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "borderaxespad": 4.5, "ncols": 2}
_DOTS: dict[str, Any] = {"linewidths": 0.0, "rasterized": True}


@dataclass(frozen=True)
class MapView:
    """What is drawn of one bundle.

    Attributes:
        name: of the bundle.
        cloud: points of its surface, (N, 3), world frame, metres.
        landmarks: (L, 3), world frame, metres.
        poses: ``T_world_camera`` of the cameras that built it, (V, 4, 4), possibly none.
        edits: of the map, world frame.
    """

    name: str
    cloud: FloatArray
    landmarks: FloatArray
    poses: FloatArray
    edits: tuple[DrawnEdit, ...] = ()


def plot_from_above(path: str | Path, views: tuple[MapView, ...], T_level_world: FloatArray) -> None:
    """Draw one map from above, or two of the same world side by side, and what differs.

    Args:
        path: PNG to write.
        views: one, or before and after.
        T_level_world: to the axes that are drawn, z up, (4, 4).

    Raises:
        MissingExtraError: matplotlib or SciPy is not installed.
        DataError: the file cannot be written.
    """
    views = tuple(_levelled(view, T_level_world) for view in views)

    def project(points: FloatArray) -> FloatArray:
        return transform(T_level_world, points)[:, :2]

    shown = _below_ceiling(views)
    low, high = _limits(views, shown)
    lowest, highest = np.percentile(np.concatenate(shown)[:, 2], [1.0, 99.0])
    size_in = 5.2 * float(np.clip((high - low)[1] / (high - low)[0], 0.5, 1.6))
    with picture(path, 6.6 if len(views) == 1 else 17.0, size_in + 1.2) as figure:
        axes = _panels(figure, 1 if len(views) == 1 else 3)
        for axis in axes:
            axis.set(
                xlim=(low[0], high[0]),
                ylim=(low[1], high[1]),
                xlabel="x of frame map (m)",
                ylabel="y of frame map (m)",
                aspect="equal",
            )
        for axis, view, cloud in zip(axes, views, shown, strict=False):
            x, y, height = cloud[np.argsort(cloud[:, 2])].T
            dots = axis.scatter(x, y, 1.2, height, cmap=_CMAP, vmin=lowest, vmax=highest, **_DOTS)
            _draw_cameras(axis, view)
            draw_edits(axis, view.edits, project)
            axis.set_title(f"{view.name}, from above")
            axis.legend(**_BELOW)
        figure.colorbar(dots, ax=axes[: len(views)], shrink=0.7, pad=0.01, label="height along z (m)")
        if len(views) == 2:
            _draw_difference(axes[2], *shown)
            draw_edits(axes[2], _later_edits(*views), project, with_content=False)


def plot_from_pose(path: str | Path, views: tuple[MapView, ...], camera: Camera, T_world_camera: FloatArray) -> None:
    """Draw the depth of one map that a camera sees, with its landmarks; of two, both and what differs.

    Args:
        path: PNG to write.
        views: one, or before and after.
        camera: its intrinsics.
        T_world_camera: its pose, (4, 4).

    Raises:
        MissingExtraError: matplotlib or SciPy is not installed.
        DataError: the file cannot be written.
        SettingError: the camera sees nothing of the maps.
    """
    camera = camera.of_width(_VIEW_PX)
    images = [cloud_depth(view.cloud, camera, T_world_camera, point_spacing_m(view.cloud)) for view in views]
    seen = np.concatenate([image[image > 0.0] for image in images])
    if len(seen) == 0:
        raise SettingError("pose", "shows nothing of the map", "give one that looks at it, such as --reference 0")
    farthest_m = float(np.percentile(seen, 99.0))
    panels = 1 if len(views) == 1 else 3
    with picture(path, 1.0 + 5.4 * panels, 0.8 + 5.0 * camera.height / camera.width) as figure:
        axes = _panels(figure, panels)
        for axis, view, image in zip(axes, views, images, strict=False):
            dots = _show(axis, image, farthest_m)
            pixels = _in_view(view.landmarks, image, camera, T_world_camera)
            axis.plot(*pixels.T, ".", markersize=2.5, color=ORANGE)
            draw_edits(axis, view.edits, partial(_pixels, camera, T_world_camera), with_content=False)
            axis.set_title(f"{view.name}: depth (grey: no surface), and {len(pixels)} landmarks in view")
        figure.colorbar(dots, ax=axes[: len(views)], shrink=0.8, pad=0.01, extend="max", label="depth (m)")
        if len(views) == 2:
            both = (images[0] > 0.0) & (images[1] > 0.0)
            axes[2].imshow(np.where(both, images[1], np.nan), cmap="Greys", vmin=0.0, vmax=2.0 * farthest_m)
            change = np.where(both, images[1] - images[0], np.nan)
            far = np.where(np.abs(change) > CHANGED_M, change, np.nan)
            moved = axes[2].imshow(far, cmap="RdBu", vmin=-1.0, vmax=1.0)
            axes[2].set_title("after minus before: red is nearer, blue farther")
            draw_edits(axes[2], _later_edits(*views), partial(_pixels, camera, T_world_camera), with_content=False)
            figure.colorbar(moved, ax=axes[2], shrink=0.8, pad=0.01, extend="both", label="change of depth (m)")
        for axis in axes:
            axis.grid(False)
            axis.set(xticks=[], yticks=[])


def _panels(figure: Figure, count: int) -> list[Axes]:
    axes: list[Axes] = figure.subplots(1, count, squeeze=False)[0].tolist()
    return axes


def _later_edits(before: MapView, after: MapView) -> tuple[DrawnEdit, ...]:
    """What was edited between two maps; nothing if one is not an edited copy of the other."""
    count = len(before.edits)
    is_copy = [edit.record for edit in before.edits] == [edit.record for edit in after.edits[:count]]
    return after.edits[count:] if is_copy else ()


def _pixels(camera: Camera, T_world_camera: FloatArray, points: FloatArray) -> FloatArray:
    """Pixels (N, 2) of points (N, 3), world frame; NaN out of the image."""
    local = transform(invert(T_world_camera), points)
    pixels = np.full((len(points), 2), np.nan)
    is_seen = camera.in_sight(local)
    pixels[is_seen] = camera.project(local[is_seen])
    is_in = np.all((pixels >= -0.5) & (pixels < [camera.width - 0.5, camera.height - 0.5]), axis=1)
    return np.where(is_in[:, None], pixels, np.nan)


def _levelled(view: MapView, T: FloatArray) -> MapView:
    return replace(view, cloud=transform(T, view.cloud), landmarks=transform(T, view.landmarks), poses=T @ view.poses)


def _below_ceiling(views: tuple[MapView, ...]) -> list[FloatArray]:
    """The views' points without what is far above all cameras.

    Of two maps, both end at the same height: else what lies between their heights would be in one of them alone.
    """
    heights = [view.poses[:, 2, 3].max() for view in views if len(view.poses)]
    if not heights:
        return [view.cloud for view in views]
    below = [view.cloud[view.cloud[:, 2] < max(heights) + ABOVE_CAMERAS_M] for view in views]
    return below if all(len(cloud) for cloud in below) else [view.cloud for view in views]


def _limits(views: tuple[MapView, ...], shown: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner (2,) of what is drawn: all cameras, and all but the farthest points."""
    corners = [np.percentile(cloud[:, :2], [0.5, 99.5], axis=0) for cloud in shown]
    every = np.concatenate([*corners, *(view.poses[:, :2, 3] for view in views)])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.03 * (high - low).max() + 0.1
    return low - margin, high + margin


def _draw_cameras(axis: Axes, view: MapView) -> None:
    label = f"{len(view.landmarks)} landmarks"
    axis.plot(*view.landmarks[:, :2].T, ".", color=ORANGE, markersize=2.0, label=label)
    if len(view.poses):
        label = f"{len(view.poses)} cameras that built it"
        axis.plot(*view.poses[:, :2, 3].T, color=INK, linewidth=2.6)
        axis.plot(*view.poses[:, :2, 3].T, color="white", linewidth=1.3, label="_")
        axis.plot([], [], color=INK, linewidth=1.6, label=label)


def _draw_difference(axis: Axes, before: FloatArray, after: FloatArray) -> None:
    went = before[cloud_distances(before, after) > CHANGED_M]
    came = after[cloud_distances(after, before) > CHANGED_M]
    axis.plot(*after[:, :2].T, ".", color=GREY, markersize=0.8, alpha=0.3, rasterized=True)
    axis.plot(*went[:, :2].T, ".", color=VERMILION, markersize=2.0, label=f"only before: {len(went)} points")
    axis.plot(*came[:, :2].T, ".", color=BLUE, markersize=2.0, label=f"only after: {len(came)} points")
    axis.set_title(f"What differs by more than {100.0 * CHANGED_M:.0f} cm")
    axis.legend(**_BELOW, markerscale=4.0)


def _show(axis: Axes, depth: NDArray[np.float32], farthest_m: float) -> AxesImage:
    axis.set_facecolor("0.85")
    return axis.imshow(np.where(depth > 0.0, depth, np.nan), cmap=_CMAP, vmin=0.0, vmax=farthest_m)


def _in_view(
    landmarks: FloatArray, depth: NDArray[np.float32], camera: Camera, T_world_camera: FloatArray
) -> FloatArray:
    """Pixels (N, 2) of the landmarks that no surface hides."""
    points = transform(invert(T_world_camera), landmarks)
    points = points[camera.in_sight(points)]
    pixels = camera.project(points)
    inside = np.all((pixels >= -0.5) & (pixels < [camera.width - 0.5, camera.height - 0.5]), axis=1)
    pixels, z = pixels[inside], points[inside, 2]
    u, v = np.rint(pixels).astype(np.int64).T
    surface = depth[v, u]
    return np.asarray(pixels[(surface == 0.0) | (z < surface + CHANGED_M)])
