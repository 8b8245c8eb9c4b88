"""Least squares of the reprojection error over intrinsics and the board's poses.

Zhang, *A flexible new technique for camera calibration* (2000), by Levenberg-Marquardt with the poses eliminated
(Triggs et al., *Bundle Adjustment - A Modern Synthesis*, 2000). OpenCV projects, and gives the derivatives. Its own
solvers are not used: that of fisheye lenses fails on views far from the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.calibration.board import Board
from monoloc.calibration.board_views import BoardView
from monoloc.distortion import COEFFICIENTS, DistortionModel, Lens
from monoloc.geometry import FloatArray

_STARTS = (0.3, 0.45, 0.7, 1.0, 1.5, 2.2)  # focal lengths over the longer side of the image
_ITERATIONS = 100
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e6
_CONVERGED = 1e-9  # relative decrease of the cost


@dataclass(frozen=True)
class BoardFit:
    """Intrinsics, and where the board is in each of V views.

    Attributes:
        model: of the distortion.
        intrinsics: fx, fy, cx, cy, pixels, and the model's coefficients, (4 + D,).
        poses: (V, 6) rotation vector and translation, m: ``T_camera_board``.
    """

    model: DistortionModel
    intrinsics: FloatArray
    poses: FloatArray


@dataclass(frozen=True)
class Linearisation:
    """Of one view of N corners: pixels minus reprojections (2 N,), and the reprojections' derivatives."""

    residual: FloatArray
    by_intrinsics: FloatArray
    by_pose: FloatArray


def fit_from_scratch(
    views: Sequence[BoardView], board: Board, size: tuple[int, int], model: DistortionModel
) -> BoardFit:
    """The best of the fits that start from several focal lengths, without distortion.

    Args:
        views: of the board.
        size: width and height of the images.
        model: of the distortion.
    """
    starts = (_start(views, board, size, model, share * max(size)) for share in _STARTS)
    fits = [refine(start, views, board) for start in starts]
    return min(fits, key=lambda fit: cost_of(linearise(fit, views, board)))


def refine(
    start: BoardFit,
    views: Sequence[BoardView],
    board: Board,
    frozen: Sequence[str] = (),
    iterations: int = _ITERATIONS,
) -> BoardFit:
    """Minimise the reprojection error from a start; coefficients of the names ``frozen`` become zero."""
    names = ("fx", "fy", "cx", "cy", *COEFFICIENTS[start.model])
    free = np.array([name not in frozen for name in names])
    fit = BoardFit(start.model, np.where(free, start.intrinsics, 0.0), start.poses)
    parts = linearise(fit, views, board)
    cost, damping = cost_of(parts), _FIRST_DAMPING
    for _ in range(iterations):
        moved = _moved(fit, parts, free, damping)
        moved_parts = linearise(moved, views, board)
        moved_cost = cost_of(moved_parts)
        if not moved_cost < cost:  # true for NaN
            damping *= 10.0
            if damping > _MOST_DAMPING:
                break
            continue
        is_converged = cost - moved_cost < _CONVERGED * cost
        fit, parts, cost, damping = moved, moved_parts, moved_cost, max(_LEAST_DAMPING, damping / 10.0)
        if is_converged:
            break
    return fit


def cost_of(parts: Sequence[Linearisation]) -> float:
    """Sum of squared residuals, px^2; infinite where one is not finite."""
    cost = float(sum(part.residual @ part.residual for part in parts))
    return cost if np.isfinite(cost) else np.inf


def linearise(fit: BoardFit, views: Sequence[BoardView], board: Board) -> list[Linearisation]:
    """Residuals and derivatives of every view."""
    fx, fy, cx, cy, *coefficients = fit.intrinsics
    K, count = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), len(fit.intrinsics)
    parts = []
    for view, pose in zip(views, fit.poses, strict=True):
        arguments = board.corners[view.ids][:, None], pose[:3], pose[3:], K, np.array(coefficients)
        if fit.model == "fisheye":
            pixels, J = cv2.fisheye.projectPoints(*arguments)
            columns, of_pose = slice(0, count), slice(count, count + 6)
        else:
            pixels, J = cv2.projectPoints(*arguments)
            columns, of_pose = slice(6, 6 + count), slice(0, 6)
        jacobian = np.asarray(J, dtype=np.float64)
        residual = (view.pixels - np.reshape(pixels, (-1, 2))).ravel()
        parts.append(Linearisation(residual, jacobian[:, columns], jacobian[:, of_pose]))
    return parts


def _moved(fit: BoardFit, parts: Sequence[Linearisation], free: NDArray[np.bool_], damping: float) -> BoardFit:
    """One damped Gauss-Newton step."""
    count = int(free.sum())
    # Per view: the normal equations of intrinsics, pose and residual, (V, count + 7, count + 7).
    stacked = (np.column_stack([part.by_intrinsics[:, free], part.by_pose, part.residual]) for part in parts)
    normal = np.stack([columns.T @ columns for columns in stacked])
    intrinsic, of_pose, right = slice(0, count), slice(count, count + 6), [*range(count), -1]
    damped = normal[:, of_pose, of_pose] * (1.0 + damping * np.eye(6)) + 1e-12 * np.eye(6)
    eliminated = np.linalg.solve(damped, normal[:, of_pose, right])
    reduced = (normal[:, intrinsic, right] - normal[:, intrinsic, of_pose] @ eliminated).sum(axis=0)
    H, gradient = reduced[:, :-1], reduced[:, -1]
    # Coefficients that the views do not determine move little.
    step = np.linalg.lstsq(H + damping * np.diag(np.diag(H)), gradient, rcond=None)[0]
    intrinsics = fit.intrinsics.copy()
    intrinsics[free] += step
    poses = fit.poses + eliminated[:, :, -1] - eliminated[:, :, :-1] @ step
    return BoardFit(fit.model, intrinsics, poses)


def _start(
    views: Sequence[BoardView], board: Board, size: tuple[int, int], model: DistortionModel, focal_px: float
) -> BoardFit:
    """A camera without distortion, and the board's poses in it."""
    lens = Lens(model, (0.0,) * len(COEFFICIENTS[model]))
    centre = (np.array(size) - 1.0) / 2.0
    poses = []
    for view in views:
        rays = lens.undistort((view.pixels - centre) / focal_px)
        _, rotation, translation = cv2.solvePnP(
            board.corners[view.ids], rays, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
        )
        poses.append(np.concatenate([np.ravel(rotation), np.ravel(translation)]))
    intrinsics = np.array([focal_px, focal_px, *centre, *lens.coefficients])
    return BoardFit(model, intrinsics, np.stack(poses).astype(np.float64))
