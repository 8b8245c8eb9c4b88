"""Whether views of the board are enough to trust a calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from monoloc.calibration.board_source import BoardViews
from monoloc.calibration.board_views import BoardView
from monoloc.calibration.intrinsics_solver import Calibration
from monoloc.errors import DataError
from monoloc.geometry import FloatArray

LEAST_VIEWS = 10
_CELLS = 6  # along a side of the image
_LEAST_COVERAGE, _GOOD_COVERAGE = 0.35, 0.7  # of the cells that corners lie in
# Relative: a pose is off by as much of its distance. Views at two zooms, 520 and 560 pixels, give 0.008 and fit well.
_MOST_FOCAL_SD, _GOOD_FOCAL_SD = 0.01, 0.005
_MOST_RMS_PX, _GOOD_RMS_PX = 1.5, 0.5
_OTHER_MODEL = "; another --model may fit better"
_HELD_OUT_RATIO = 1.5  # of held-out over used views: the model follows noise


def require_views(source: str, found: BoardViews) -> None:
    """Raise DataError if there are too few views to begin with."""
    if len(found.views) < LEAST_VIEWS:
        problem = f"shows the board in {len(found.views)} of {found.images} images, and {LEAST_VIEWS} are needed"
        fix = "print the board of: monoloc calibrate board; show it sharp, flat and whole"
        if 2 * len(found.views) > found.images:
            fix = "take more pictures of it, from other sides and in other places of the image"
        raise DataError(source, problem, fix)


def coverage_of(views: Sequence[BoardView], size: tuple[int, int]) -> FloatArray:
    """Number of corners in each cell of the image, (6, 6)."""
    pixels = np.concatenate([view.pixels for view in views])
    width, height = size
    counts, *_ = np.histogram2d(pixels[:, 1], pixels[:, 0], bins=_CELLS, range=[[0, height], [0, width]])
    return np.asarray(counts)


def assess(source: str, calibration: Calibration) -> list[str]:
    """Warnings about a calibration.

    Raises:
        DataError: it is not determined by the views, or does not explain them.
    """
    if len(calibration.views) < LEAST_VIEWS:
        problem = f"leaves {len(calibration.views)} views that one camera explains, and {LEAST_VIEWS} are needed"
        raise DataError(source, problem, "keep the board flat, hold still, fix the focus, and take more pictures")
    camera = calibration.camera
    relative_sd = float(calibration.sd[0] / camera.fx)
    cells = coverage_of(calibration.views, (camera.width, camera.height)) > 0
    coverage = float(cells.mean())
    if calibration.rms_px > _MOST_RMS_PX:
        problem = f"fits the calibration only to {calibration.rms_px:.1f} pixels"
        fix = "keep the board flat, hold still, fix the focus, or try --model rational or fisheye"
        raise DataError(source, problem, fix)
    if not relative_sd <= _MOST_FOCAL_SD:  # true for NaN
        problem = f"leaves the focal length open to {100.0 * relative_sd:.0f} %: the views are too flat or too alike"
        fix = "tilt the board by 30 to 45 degrees, to all sides, and come closer"
        raise DataError(source, problem, fix + (_OTHER_MODEL if calibration.rms_px > _GOOD_RMS_PX else ""))
    if coverage < _LEAST_COVERAGE:
        problem = f"shows the board in only {coverage:.0%} of the image"
        raise DataError(source, problem, f"bring the board into all corners, first to the {_emptiest(cells)}")
    warnings = []
    if coverage < _GOOD_COVERAGE:
        problem = f"corners cover {coverage:.0%} of the image, least on the {_emptiest(cells)}"
        warnings.append(f"{problem}; distortion is a guess in the rest")
    if calibration.rms_px > _GOOD_RMS_PX:
        warnings.append(f"corners are off by {calibration.rms_px:.2f} pixels{_OTHER_MODEL}")
    if relative_sd > _GOOD_FOCAL_SD:
        problem = f"views agree on the focal length only to {100.0 * relative_sd:.1f} %"
        warnings.append(f"{problem}; fix focus and zoom, tilt the board more, and take more views")
    if calibration.held_out_rms_px > _HELD_OUT_RATIO * calibration.rms_px:
        warnings.append(
            f"views that were held out fit to {calibration.held_out_rms_px:.2f} pixels, the others to "
            f"{calibration.rms_px:.2f}; take more views"
        )
    return warnings


def _emptiest(cells: NDArray[np.bool_]) -> str:
    """The side of the image where the fewest cells are covered."""
    third = _CELLS // 3
    sides = {"left": cells[:, :third], "right": cells[:, -third:], "top": cells[:third], "bottom": cells[-third:]}
    return min(sides, key=lambda side: sides[side].mean())
