"""Pictures of a map: from above or as a camera sees it; of two maps of one world, what went and what came."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.evaluation.cloud_metrics import cloud_distances
from monoloc.geometry import FloatArray, invert, transform
from monoloc.map.depth_rendering import cloud_depth
from monoloc.viz.picture import BLUE, GREY, INK, ORANGE, VERMILION, picture
from monoloc.viz.run_drawing import page_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

CHANGED_M = 0.15
"""Distance to the other map's nearest point, from which a point went or came."""

_ABOVE_CAMERAS_M = 0.2  # surfaces higher than that above the highest camera, such as the ceiling, are left out
_VIEW_PX = 480  # width of a view from a pose
_CMAP = "viridis"
_DOTS: dict[str, Any] = {"linewidths": 0.0, "rasterized": True}


@dataclass(frozen=True)
class MapView:
    """What is drawn of one bundle.

    Attributes:
        name: of the bundle.
        cloud: points of its surface, (N, 3), world frame, metres.
        landmarks: (L, 3), world frame, metres.
        poses: ``T_world_camera`` of the cameras that built it, (V, 4, 4), possibly none.
    """

    name: str
    cloud: FloatArray
    landmarks: FloatArray
    poses: FloatArray


def plot_from_above(path: str | Path, views: tuple[MapView, ...], down: FloatArray) -> None:
    """Draw one map from above, or two of the same world side by side, and what differs.

    Args:
        path: PNG to write.
        views: one, or before and after.
        down: (3,) approximate down direction in the world.

    Raises:
        MissingExtraError: matplotlib or SciPy is not installed.
        DataError: the file cannot be written.
    """
    right, forward, up, flipped = page_axes(down)
    plane, sign = [right, forward], -1.0 if flipped else 1.0
    shown = [_below_ceiling(view, up, sign) for view in views]
    every = np.concatenate(shown)
    low, high = np.percentile(every, [0.5, 99.5], axis=0)
    heights = sign * every[:, up]
    limits = tuple(np.percentile(heights, [1.0, 99.0]).tolist())
    size_in = 5.2 * float(np.clip((high - low)[forward] / (high - low)[right], 0.5, 1.6))
    with picture(path, 6.6 if len(views) == 1 else 17.0, size_in + 1.0) as figure:
        axes = _panels(figure, 1 if len(views) == 1 else 3)
        for axis, view, cloud in zip(axes, views, shown, strict=False):
            order = np.argsort(sign * cloud[:, up])
            height = (sign * cloud[:, up])[order]
            x, y = cloud[order][:, plane].T
            dots = axis.scatter(x, y, 1.2, height, cmap=_CMAP, vmin=limits[0], vmax=limits[1], **_DOTS)
            _draw_cameras(axis, view, plane)
            axis.set_title(f"{view.name}, from above")
            axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=2)
        figure.colorbar(dots, ax=axes[: len(views)], shrink=0.7, pad=0.01, label=f"height along {'xyz'[up]} (m)")
        if len(views) == 2:
            _draw_difference(axes[2], shown[0], shown[1], plane)
        margin = 0.03 * (high - low).max() + 0.1
        for axis in axes:
            axis.set(xlim=(low[right] - margin, high[right] + margin))
            axis.set(ylim=(low[forward] - margin, high[forward] + margin))
            axis.set(xlabel=f"{'xyz'[right]} (m)", ylabel=f"{'xyz'[forward]} (m)", aspect="equal")


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
    """
    camera = camera.resized(_VIEW_PX, max(1, round(_VIEW_PX * camera.height / camera.width)))
    images = [cloud_depth(view.cloud, camera, T_world_camera) for view in views]
    seen = np.concatenate([image[image > 0.0] for image in images])
    farthest_m = float(np.percentile(seen, 99.0)) if len(seen) else 1.0
    panels = 1 if len(views) == 1 else 3
    with picture(path, 1.0 + 5.4 * panels, 0.8 + 5.0 * camera.height / camera.width) as figure:
        axes = _panels(figure, panels)
        for axis, view, image in zip(axes, views, images, strict=False):
            dots = _show(axis, image, farthest_m)
            pixels = _in_view(view.landmarks, image, camera, T_world_camera)
            axis.plot(*pixels.T, ".", markersize=2.5, color=ORANGE)
            axis.set_title(f"{view.name}: depth, and {len(pixels)} landmarks in view")
        figure.colorbar(dots, ax=axes[: len(views)], shrink=0.8, pad=0.01, extend="max", label="depth (m)")
        if len(views) == 2:
            both = (images[0] > 0.0) & (images[1] > 0.0)
            axes[2].imshow(np.where(both, images[1], np.nan), cmap="Greys", vmin=0.0, vmax=2.0 * farthest_m)
            change = np.where(both, images[1] - images[0], np.nan)
            far = np.where(np.abs(change) > CHANGED_M, change, np.nan)
            moved = axes[2].imshow(far, cmap="RdBu", vmin=-1.0, vmax=1.0)
            axes[2].set_title("after minus before: red is nearer, blue farther")
            figure.colorbar(moved, ax=axes[2], shrink=0.8, pad=0.01, extend="both", label="change of depth (m)")
        for axis in axes:
            axis.grid(False)
            axis.set(xticks=[], yticks=[])


def _panels(figure: Figure, count: int) -> list[Axes]:
    axes: list[Axes] = figure.subplots(1, count, squeeze=False)[0].tolist()
    return axes


def _below_ceiling(view: MapView, up: int, sign: float) -> FloatArray:
    """The view's points without what is far above all cameras."""
    if len(view.poses) == 0:
        return view.cloud
    highest = float((sign * view.poses[:, up, 3]).max()) + _ABOVE_CAMERAS_M
    below = view.cloud[sign * view.cloud[:, up] < highest]
    return below if len(below) else view.cloud


def _draw_cameras(axis: Axes, view: MapView, plane: list[int]) -> None:
    axis.plot(
        *view.landmarks[:, plane].T, ".", color=ORANGE, markersize=2.5, label=f"{len(view.landmarks)} landmarks"
    )
    if len(view.poses):
        label = f"{len(view.poses)} cameras that built it"
        axis.plot(*view.poses[:, plane, 3].T, color=INK, linewidth=2.6)
        axis.plot(*view.poses[:, plane, 3].T, color="white", linewidth=1.3, label="_")
        axis.plot([], [], color=INK, linewidth=1.6, label=label)


def _draw_difference(axis: Axes, before: FloatArray, after: FloatArray, plane: list[int]) -> None:
    went = before[cloud_distances(before, after) > CHANGED_M]
    came = after[cloud_distances(after, before) > CHANGED_M]
    axis.plot(*after[:, plane].T, ".", color=GREY, markersize=0.8, alpha=0.3, rasterized=True)
    axis.plot(*went[:, plane].T, ".", color=VERMILION, markersize=2.0, label=f"went: {len(went)} points")
    axis.plot(*came[:, plane].T, ".", color=BLUE, markersize=2.0, label=f"came: {len(came)} points")
    axis.set_title(f"What differs by more than {100.0 * CHANGED_M:.0f} cm")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.09), ncols=2, markerscale=4.0)


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
