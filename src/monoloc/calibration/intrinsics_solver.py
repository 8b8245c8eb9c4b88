"""Intrinsics from views of the board, with standard deviations and the reprojection error of views held out.

The standard deviations are those of a sandwich estimator over views (White 1982): corners of one view err together,
by blur, a bent board or a distortion that the model lacks. Counted as independent, they would make the camera seem
better known than it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from monoloc.calibration.board import Board
from monoloc.calibration.board_views import BoardView
from monoloc.calibration.reprojection_fit import BoardFit, Linearisation, fit_from_scratch, linearise, refine
from monoloc.camera import Camera
from monoloc.distortion import DistortionModel
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, so3_exp

HELD_OUT_EVERY = 5
_OUTLIER_SDS = 4.0
_LEAST_OUTLIER_PX = 0.1
_UNOBSERVED = 1e-14  # relative information, rounding, in a direction that no view constrains
# Coefficients that are left out, the first alone first, where the views leave out parts of the image, which the lens
# would fold there.
_DISPENSABLE: dict[DistortionModel, tuple[str, ...]] = {
    "brown": ("k3",),
    "rational": ("k6", "k5", "k3"),
    "fisheye": ("k4", "k3"),
}


@dataclass(frozen=True)
class Calibration:
    """A calibrated camera.

    Attributes:
        camera: intrinsics.
        sd: standard deviations of fx, fy, cx, cy, pixels, and of the distortion coefficients, (4 + D,); 0 for
            coefficients that the views do not determine and that were left out.
        rms_px: root mean square distance of corners to their reprojections.
        held_out_rms_px: the same over views that another calibration, of the other views, did not use.
        views: that were used, without outliers.
        distances_m: (V,) from the camera to the middle of the board.
    """

    camera: Camera
    sd: FloatArray
    rms_px: float
    held_out_rms_px: float
    views: list[BoardView]
    distances_m: FloatArray


def calibrate_camera(
    views: Sequence[BoardView], board: Board, size: tuple[int, int], model: DistortionModel
) -> Calibration:
    """Calibrate a camera.

    Args:
        views: at least ten.
        board: that they show.
        size: width and height of the images.
        model: of the distortion.

    Raises:
        SettingError: no camera of that model explains the views.
    """
    kept, start = _without_outliers(views, board, fit_from_scratch(views, board, size, model))
    fit, camera = _fit(kept, board, start, size)
    training = np.flatnonzero(np.arange(len(kept)) % HELD_OUT_EVERY)
    part = replace(start, poses=start.poses[training])
    _, other = _fit([kept[index] for index in training], board, part, size)
    parts = linearise(fit, kept, board)
    return Calibration(
        camera=camera,
        sd=_standard_deviations(parts, fit.intrinsics),
        rms_px=_rms([part.residual for part in parts]),
        held_out_rms_px=_rms([residuals_of(view, board, other) for view in kept[::HELD_OUT_EVERY]]),
        views=kept,
        distances_m=np.linalg.norm(so3_exp(fit.poses[:, :3]) @ board.outline.mean(axis=0) + fit.poses[:, 3:], axis=1),
    )


def residuals_of(view: BoardView, board: Board, camera: Camera) -> FloatArray:
    """Pixels minus reprojections (N, 2) of a view by a camera, with the board's pose that fits best."""
    points = board.corners[view.ids]
    seen, K, distortion = camera.for_pnp(view.pixels)
    _, rotation, translation = cv2.solvePnP(points, seen, K, distortion)
    R, _ = cv2.Rodrigues(rotation)
    return view.pixels - camera.project(points @ R.T + translation.ravel())


def _without_outliers(views: Sequence[BoardView], board: Board, fit: BoardFit) -> tuple[list[BoardView], BoardFit]:
    """The views, and a fit of them, without corners that are far from their reprojection."""
    distances = [np.linalg.norm(part.residual.reshape(-1, 2), axis=1) for part in linearise(fit, views, board)]
    # The median of a Rayleigh distribution is 1.18 standard deviations of one axis.
    sd = float(np.median(np.concatenate(distances))) / 1.18
    near = [distance < max(_LEAST_OUTLIER_PX, _OUTLIER_SDS * sd) for distance in distances]
    chosen = np.flatnonzero([each.mean() > 0.5 for each in near])
    kept = [
        replace(views[index], ids=views[index].ids[near[index]], pixels=views[index].pixels[near[index]])
        for index in chosen.tolist()
    ]
    return kept, replace(fit, poses=fit.poses[chosen])


def _fit(views: Sequence[BoardView], board: Board, start: BoardFit, size: tuple[int, int]) -> tuple[BoardFit, Camera]:
    """The fit with as many coefficients as make a camera."""
    dispensable = _DISPENSABLE[start.model]
    for left_out in range(len(dispensable) + 1):
        fit = refine(start, views, board, dispensable[:left_out])
        fx, fy, cx, cy, *coefficients = fit.intrinsics.tolist()
        try:
            return fit, Camera(*size, fx, fy, cx, cy, tuple(coefficients), start.model)
        except SettingError as error:
            refused = error
    problem = f"finds no {start.model} camera: {refused.field.removeprefix('camera.')} {refused.problem}"
    is_too_wide = refused.fix.startswith("crop")
    fix = "show the board all over the image, tilted to all sides, or choose another --model"
    raise SettingError("calibration", problem, refused.fix if is_too_wide else fix)


def _standard_deviations(parts: Sequence[Linearisation], intrinsics: FloatArray) -> FloatArray:
    """Of the intrinsics, (4 + D,), with the poses of the board eliminated; 0 for coefficients that were left out.

    The larger of the sandwich and of the usual estimate with independent corners: the former knows nothing of
    directions that no view constrains, where its scores vanish.
    """
    free = intrinsics != 0.0
    count = int(free.sum())
    information, scores = np.zeros((count, count)), []
    for part in parts:
        # What the board's pose cannot explain; the pose's own gradient vanishes at the solution.
        J = part.by_intrinsics[:, free]
        J = J - part.by_pose @ np.linalg.lstsq(part.by_pose, J, rcond=None)[0]
        information += J.T @ J
        scores.append(J.T @ part.residual)
    # In units in which every intrinsic alone is known to one.
    unit = 1.0 / np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information * np.outer(unit, unit))
    bread = (vectors / np.maximum(values, _UNOBSERVED)) @ vectors.T
    scaled = np.stack(scores) * unit
    meat = scaled.T @ scaled * len(parts) / (len(parts) - 1)
    residuals = np.concatenate([part.residual for part in parts])
    variance_px2 = residuals @ residuals / max(1, len(residuals) - count - 6 * len(parts))
    variance = np.maximum(np.diag(bread @ meat @ bread), variance_px2 * np.diag(bread))
    sd = np.zeros(len(intrinsics))
    sd[free] = unit * np.sqrt(variance)
    return sd


def _rms(residuals: Sequence[FloatArray]) -> float:
    """Root mean square length of residuals, (N, 2) or (2 N,) each."""
    return float(np.sqrt(2.0 * np.mean(np.square(np.concatenate([residual.ravel() for residual in residuals])))))
