"""Picture of a reconstruction: cameras and points from above and from the side, and the depth of some frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.io.recording import evenly_spaced
from monoloc.structure_from_motion.reconstruction import Reconstruction
from monoloc.viz.picture import BLUE, GREEN, GREY, VERMILION, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_VIEWS = 40
_FRAMES = 3


def plot_reconstruction(path: str | Path, found: Reconstruction, title: str) -> None:
    """Draw a reconstruction.

    Args:
        path: PNG to write.
        title: of the figure.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written, or an image cannot be read.
    """
    with picture(path, 12.5, 8.6) as figure:
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.8, 1.0])[:, 0]
        top, side = above.subplots(1, 2)
        _draw_from(top, found, (0, 1))
        top.set_title(f"From above: {len(found.model.frames)} cameras, {len(found.model.points)} points")
        _draw_from(side, found, (0, 2))
        side.set_title(f"From the side; scale by {found.scale.how}, ± {100.0 * found.scale.sd:.2g} %")
        side.legend(loc="upper right", markerscale=2.0, frameon=True, framealpha=0.9, edgecolor="none")
        axes = below.subplots(1, 2 * _FRAMES).tolist()
        for number, frame in enumerate(evenly_spaced(len(found.recording), _FRAMES + 2)[1:-1].tolist()):
            _draw_frame(axes[2 * number], axes[2 * number + 1], found, frame)


def _draw_from(axis: Axes, found: Reconstruction, shown: tuple[int, int]) -> None:
    """Points, path and views, along two of the world's axes."""
    first, second = shown
    points, poses = found.model.points, found.model.poses
    positions = poses[:, :3, 3]
    axis.plot(points[:, first], points[:, second], ".", color=GREY, markersize=1.5, alpha=0.7, label="points")
    axis.plot(positions[:, first], positions[:, second], color=BLUE, linewidth=1.5, label="path")
    some = poses[evenly_spaced(len(poses), _VIEWS)]
    axis.quiver(
        some[:, first, 3], some[:, second, 3], some[:, first, 2], some[:, second, 2],
        color=VERMILION, width=0.003, scale=22.0, label="view",
    )  # fmt: skip
    axis.plot(positions[0, first], positions[0, second], "o", color=GREEN, label="start")
    for name, which in (("x", first), ("y", second)):
        axis.set(**{f"{name}lim": _limits(points[:, which], positions[:, which])})
        axis.set(**{f"{name}label": f"{'xyz'[which]} (m)"})
    axis.set_aspect("equal")


def _limits(points: FloatArray, positions: FloatArray) -> tuple[float, float]:
    """Range of an axis that shows all cameras and all but the farthest points."""
    low, high = np.percentile(points, [1.0, 99.0])
    low, high = min(float(low), float(positions.min())), max(float(high), float(positions.max()))
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def _draw_frame(image: Axes, depth: Axes, found: Reconstruction, frame: int) -> None:
    values = found.depths[frame]
    image.imshow(found.recording.color(frame))
    depth.imshow(np.where(values > 0.0, values, np.nan), cmap="viridis")
    image.set_title(found.recording.frame_names[frame])
    known = values[values > 0.0]
    reach = f"{known.min():.1f} to {known.max():.1f} m" if len(known) else "no depth"
    depth.set_title(f"depth, {reach}")
    for axis in (image, depth):
        axis.grid(False)
        axis.set(xticks=[], yticks=[])
