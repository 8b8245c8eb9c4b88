"""Picture of a camera calibration: where the board was seen, and what is left of the corners' positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from monoloc.calibration.board import Board
from monoloc.calibration.intrinsics_solver import Calibration, residuals_of
from monoloc.viz.picture import BLUE, GREY, ORANGE, VERMILION, picture

_ARROW = 50.0  # times the residual: a fifth of a pixel becomes ten


def plot_coverage(path: str | Path, calibration: Calibration, board: Board, title: str) -> None:
    """Draw the corners of all views with their magnified residuals (left), and the residuals themselves (right).

    Raises:
        MissingExtraError: matplotlib is not installed.
        DataError: the file cannot be written.
    """
    camera = calibration.camera
    pixels = np.concatenate([view.pixels for view in calibration.views])
    residuals = np.concatenate([residuals_of(view, board, camera) for view in calibration.views])
    with picture(path, 11.0, 5.0) as figure:
        image, spread = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
        for view in calibration.views:
            image.plot(*np.append(view.outline, view.outline[:1], axis=0).T, color=GREY, linewidth=0.5, alpha=0.5)
        image.plot(*pixels.T, ".", color=BLUE, markersize=3.0)
        image.quiver(
            *pixels.T, *(_ARROW * residuals).T, angles="xy", scale_units="xy", scale=1.0, color=ORANGE, width=0.0015
        )
        image.plot(camera.cx, camera.cy, "+", color=VERMILION, markersize=12.0)
        image.set(
            xlim=(0, camera.width),
            ylim=(camera.height, 0),
            aspect="equal",
            title=f"{title}: corners of {len(calibration.views)} views, residuals times {_ARROW:.0f}",
        )
        spread.plot(*residuals.T, ".", color=BLUE, markersize=3.0)
        most = 1.1 * float(np.abs(residuals).max())
        spread.set(
            xlim=(-most, most),
            ylim=(-most, most),
            aspect="equal",
            xlabel="residual in x, pixels",
            ylabel="in y, pixels",
        )
        spread.set_title(f"RMS {calibration.rms_px:.2f} px, held out {calibration.held_out_rms_px:.2f} px")
