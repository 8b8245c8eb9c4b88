"""Errors of estimated poses.

No alignment is ever applied. Poses are in the map's frame, which is the truth's frame, so an offset between the two
is an error of the localizer and counts as one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import FloatArray, invert, rotation_angle, se3_exp

CHI2_MEDIAN_3 = 2.3659738843753377  # median of the chi-squared distribution with 3 degrees of freedom


@dataclass(frozen=True)
class PoseErrors:
    """Errors of N poses.

    Attributes:
        position_m: (N,) distance between the two camera centres, metres.
        rotation_rad: (N,) angle of the rotation between the two orientations, radians, in [0, pi].
    """

    position_m: FloatArray
    rotation_rad: FloatArray


@dataclass(frozen=True)
class TrajectoryMetrics:
    """Summary of a trajectory's errors, named as in ``monoloc localize --json``.

    Attributes:
        ate_rmse_m, ate_median_m, ate_max_m: absolute position error, metres.
        rot_rmse_deg, rot_median_deg: absolute rotation error, degrees.
        within_5cm_5deg, within_10cm_10deg: share of frames, 0..1, with both errors within the bounds.
    """

    ate_rmse_m: float
    ate_median_m: float
    ate_max_m: float
    rot_rmse_deg: float
    rot_median_deg: float
    within_5cm_5deg: float
    within_10cm_10deg: float


def pose_errors(estimated: ArrayLike, truth: ArrayLike) -> PoseErrors:
    """Position and rotation error of each frame.

    Args:
        estimated: estimated ``T_world_camera``, (N, 4, 4).
        truth: true ``T_world_camera``, (N, 4, 4), same world.

    Raises:
        ValueError: shapes that are not (N, 4, 4) with the same N >= 1, or entries that are not finite.
    """
    T_world_estimated, T_world_truth = checked_pair(estimated, truth)
    offset_m = T_world_estimated[:, :3, 3] - T_world_truth[:, :3, 3]
    R_estimated_truth = np.swapaxes(T_world_estimated[:, :3, :3], -1, -2) @ T_world_truth[:, :3, :3]
    return PoseErrors(np.linalg.norm(offset_m, axis=-1), rotation_angle(R_estimated_truth))


def twist_errors(twists: FloatArray) -> PoseErrors:
    """Pose errors given as twists (N, 6), (rho, phi) in m and rad, in the true camera's frame."""
    difference = se3_exp(twists)
    return PoseErrors(np.linalg.norm(difference[..., :3, 3], axis=-1), rotation_angle(difference[..., :3, :3]))


def axis_sd(errors: PoseErrors) -> tuple[float, float]:
    """Standard deviations per axis, metres and radians, that reproduce the median errors.

    For an error that is Gaussian with equal variance in three axes, the square divided by that variance has a
    chi-squared distribution with three degrees of freedom, whose median is 2.37. The median tolerates outliers in up
    to half of the frames.

    Args:
        errors: errors of at least one pose.
    """
    position, rotation = (
        float(np.median(values)) / np.sqrt(CHI2_MEDIAN_3) for values in (errors.position_m, errors.rotation_rad)
    )
    return float(position), float(rotation)


def relative_pose_errors(estimated: ArrayLike, truth: ArrayLike, step: int) -> PoseErrors:
    """Relative pose error (RPE): the error of the motion from frame i to frame i + step.

    Args:
        estimated: estimated ``T_world_camera``, (N, 4, 4).
        truth: true ``T_world_camera``, (N, 4, 4); its world frame may be a different one.
        step: number of frames between the two poses of a motion, 1 .. N - 1.

    Returns:
        Errors of the N - step overlapping motions.

    Raises:
        ValueError: as :func:`pose_errors`, or a step outside 1 .. N - 1.
    """
    T_world_estimated, T_world_truth = checked_pair(estimated, truth)
    if not 1 <= step < len(T_world_truth):
        raise ValueError(f"step must lie in 1 .. {len(T_world_truth) - 1}, got {step}")
    return pose_errors(
        invert(T_world_estimated[:-step]) @ T_world_estimated[step:],
        invert(T_world_truth[:-step]) @ T_world_truth[step:],
    )


def summarise(estimated: ArrayLike, truth: ArrayLike) -> TrajectoryMetrics:
    """Metrics of a trajectory, without alignment: the map's frame is the truth's frame.

    Args and Raises: as :func:`pose_errors`.
    """
    errors = pose_errors(estimated, truth)
    position_m, rotation_deg = errors.position_m, np.rad2deg(errors.rotation_rad)

    def share_within(bound_m: float, bound_deg: float) -> float:
        return float(np.mean((position_m <= bound_m) & (rotation_deg <= bound_deg)))

    return TrajectoryMetrics(
        ate_rmse_m=float(np.sqrt(np.mean(position_m**2))),
        ate_median_m=float(np.median(position_m)),
        ate_max_m=float(np.max(position_m)),
        rot_rmse_deg=float(np.sqrt(np.mean(rotation_deg**2))),
        rot_median_deg=float(np.median(rotation_deg)),
        within_5cm_5deg=share_within(0.05, 5.0),
        within_10cm_10deg=share_within(0.10, 10.0),
    )


def checked_pair(estimated: ArrayLike, truth: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Estimated and true poses as float64 (N, 4, 4).

    Raises:
        ValueError: shapes that are not (N, 4, 4) with the same N >= 1, or entries that are not finite.
    """
    T_world_truth = checked_array("truth", truth, (None, 4, 4))
    return checked_array("estimated", estimated, T_world_truth.shape), T_world_truth


def checked_array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> FloatArray:
    """Values as float64; None in the shape stands for any length N >= 1.

    Raises:
        ValueError: another shape, or entries that are not finite; the message begins with the name.
    """
    array = np.asarray(values, dtype=np.float64)
    fits = array.ndim == len(shape) and all(
        got >= 1 if expected is None else got == expected for got, expected in zip(array.shape, shape, strict=True)
    )
    if not fits:
        expected_text = ", ".join("N >= 1" if s is None else str(s) for s in shape)
        raise ValueError(f"{name} must have shape ({expected_text}), got {array.shape}")
    finite = np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
    if not finite.all():
        raise ValueError(f"{name} must be finite, got NaN or infinity in frame {int(np.argmin(finite))}")
    return array
