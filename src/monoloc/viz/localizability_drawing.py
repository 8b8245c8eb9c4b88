"""Picture of where a lost camera would be found: a wedge for each direction from each place, from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.localizability import Localizability
from monoloc.viz.map_view import ABOVE_CAMERAS_M
from monoloc.viz.picture import GREY, INK, picture

_CMAP = "viridis"
_WEDGE_CORNERS = 4  # of the arc of a wedge
_RADIUS = 0.46  # of a wedge, in cells


def plot_localizability(
    path: str | Path, views: Localizability, cloud: FloatArray, cameras: FloatArray, name: str
) -> None:
    """Draw the probability that one image finds the camera, of every view, over the room from above.

    Args:
        path: PNG to write.
        views: to draw.
        cloud: points of the room's surface, (N, 3), metres, in ROS's frame ``map``.
        cameras: positions of the build's cameras, (V, 3), the same.
        name: of the bundle.

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
    """
    cloud = cloud[cloud[:, 2] < max(views.height_m, float(cameras[:, 2].max())) + ABOVE_CAMERAS_M]
    every = np.concatenate([np.percentile(cloud[:, :2], [0.5, 99.5], axis=0), views.positions[:, :2]])
    low, high = every.min(axis=0) - views.cell_m, every.max(axis=0) + views.cell_m
    height_in = 6.0 * float(np.clip((high - low)[1] / (high - low)[0], 0.5, 1.6))
    with picture(path, 7.6, height_in + 1.6) as figure:
        from matplotlib.collections import PolyCollection

        axis = figure.subplots()
        axis.plot(*cloud[:, :2].T, ".", color=GREY, markersize=0.8, alpha=0.25, rasterized=True)
        wedges = PolyCollection(list(_wedges(views)), cmap=_CMAP, edgecolors="none")
        wedges.set_array(views.probability.ravel())
        wedges.set_clim(0.0, 1.0)
        axis.add_collection(wedges)
        axis.plot(*cameras[:, :2].T, color=INK, linewidth=1.4, label=f"{len(cameras)} cameras that built it")
        axis.set(
            xlim=(low[0], high[0]),
            ylim=(low[1], high[1]),
            xlabel="x of frame map (m)",
            ylabel="y of frame map (m)",
            aspect="equal",
        )
        axis.set_title(f"{name}: where a lost camera is found, by the direction in which it looks")
        flown = f"height {views.height_m:.2f} m, pitch {np.degrees(views.pitch_rad):.0f}°"
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=4.5, title=flown)
        figure.colorbar(wedges, ax=axis, shrink=0.7, pad=0.01, label="probability that one image finds it")


def _wedges(views: Localizability) -> FloatArray:
    """Corners of a wedge for each view, (N H, C, 2), metres."""
    half = np.pi / len(views.headings_rad)
    arc = np.linspace(-half, half, _WEDGE_CORNERS)
    angles = views.headings_rad[:, None] + arc
    radius_m = _RADIUS * views.cell_m
    rim = radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=2)
    shape = np.concatenate([np.zeros((len(rim), 1, 2)), rim], axis=1)
    return np.asarray((views.positions[:, None, None, :2] + shape).reshape(-1, _WEDGE_CORNERS + 1, 2))
