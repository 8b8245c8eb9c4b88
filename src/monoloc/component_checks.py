"""Checks of what components and sensors give: a user's own may return anything, whatever the types say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import numpy as np

from monoloc.camera import Camera
from monoloc.components import Components
from monoloc.depth.predictor import DepthPrediction
from monoloc.evaluation.consistency import is_covariance
from monoloc.geometry import FloatArray, is_rigid, made_rigid
from monoloc.landmarks.pnp import LandmarkMeasurement
from monoloc.odometry.motion import Motion, Translation

MOST_ELAPSED_S = 1e12
"""Between two frames. A clock that is set from 1970 jumps by less, and nanoseconds read as seconds mostly do too."""

_MOST_SD = 1e3  # metres or radians, of a motion
_MOST_SPEED_M_S, _LEAST_MOVED_S = 50.0, 0.05  # of a camera, and the time up to which its stamps may be off


def checked_components(made: object) -> Components:
    """What a components function returns.

    Raises:
        TypeError: it is no :class:`Components`.
    """
    if not isinstance(made, Components):
        raise TypeError(f"components must be a function that returns Components, got {type(made).__name__} from it")
    return made


def checked_depth(depth: object, what: str) -> DepthPrediction:
    """Of a depth source, or of a sensor.

    Raises:
        TypeError: it is no :class:`DepthPrediction`.
    """
    if not isinstance(depth, DepthPrediction):
        fix = (
            "make it by DepthPrediction(depth_m, camera), or of a sensor's image by monoloc.sensor_depth.sparse_depth"
        )
        raise TypeError(f"{what} must be a DepthPrediction, got {type(depth).__name__}; {fix}")
    return depth


def checked_motion(motion: object, what: str) -> Motion:
    """Of odometry, or of another sensor, exactly rigid: a flight chains thousands, in which rounding adds up.

    Raises:
        TypeError: it is no :class:`Motion`.
        ValueError: its pose, noise or corners are not as :class:`Motion` says.
    """
    if not isinstance(motion, Motion):
        raise TypeError(f"{what} must be a Motion or None, got {type(motion).__name__}")
    T, covariance = motion.T_previous_current, motion.view_covariance
    if np.shape(T) != (4, 4) or not is_rigid(T):
        raise ValueError(f"{what} must have a rigid T_previous_current, (4, 4)")
    if covariance is not None and not _is_covariance_of_pose(covariance):
        problem = "must have a finite, symmetric and positive semidefinite view_covariance, (6, 6)"
        raise ValueError(f"{what} {problem}")
    if motion.translation not in get_args(Translation):
        raise ValueError(f"{what} has translation {motion.translation!r}; it must be scaled, metric or unknown")
    if np.shape(motion.points) != (len(motion.log_depth_sd), 3):
        shapes = f"{np.shape(motion.points)} and {np.shape(motion.log_depth_sd)}"
        raise ValueError(f"{what} must have points (N, 3) and log_depth_sd (N,), got {shapes}")
    for sd in (motion.translation_sd_m, motion.rotation_sd_rad):
        if sd is not None and not 0.0 < sd <= _MOST_SD:
            raise ValueError(f"{what} must have positive standard deviations, {_MOST_SD:g} at most, got {sd}")
    exact = made_rigid(T)
    return motion if np.array_equal(exact, T) else replace(motion, T_previous_current=exact)


def _is_covariance_of_pose(matrix: FloatArray) -> bool:
    return np.shape(matrix) == (6, 6) and bool(np.isfinite(matrix).all() and is_covariance(matrix))


def check_frame(camera: Camera, color: Any, elapsed_s: Any, measured_depth: object, measured_motion: object) -> None:
    """Check what a localizer is given with a frame; arguments as :meth:`monoloc.localizer.Localizer.step`.

    Raises:
        ValueError, TypeError: as there.
    """
    shape = (camera.height, camera.width, 3)
    if np.shape(color) != shape or not isinstance(color, np.ndarray) or color.dtype != np.uint8:
        given = f"{np.shape(color)} {getattr(color, 'dtype', type(color).__name__)}"
        raise ValueError(f"color must have the camera's shape {shape} as uint8, got {given}")
    if measured_depth is not None:
        checked_depth(measured_depth, "measured_depth")
    time_s = np.asarray(elapsed_s)
    if time_s.ndim or time_s.dtype.kind not in "fiu" or not 0.0 <= float(time_s) <= MOST_ELAPSED_S:
        raise ValueError(f"elapsed_s must be a number from 0 to {MOST_ELAPSED_S:g}, got {elapsed_s!r}")
    if measured_motion is not None:
        check_measured(checked_motion(measured_motion, "measured_motion"), float(time_s))


def check_measured(motion: Motion, elapsed_s: float) -> None:
    """Check the motion of another sensor since the previous frame.

    Raises:
        ValueError: it does not state its noise, or is faster than 50 m/s.
    """
    if motion.rotation_sd_rad is None:
        raise ValueError("measured_motion must state its noise: make it by Motion.rotation or Motion.metric")
    moved_m = float(np.linalg.norm(motion.T_previous_current[:3, 3]))
    if elapsed_s > 0.0 and moved_m > _MOST_SPEED_M_S * max(elapsed_s, _LEAST_MOVED_S):
        raise ValueError(f"measured_motion moves by {moved_m:.3g} m in {elapsed_s:.3g} s; give metres")


def checked_measurement(measurement: object) -> LandmarkMeasurement:
    """Of a landmark localiser.

    Raises:
        TypeError: it is no :class:`LandmarkMeasurement`.
    """
    if not isinstance(measurement, LandmarkMeasurement):
        given = type(measurement).__name__
        raise TypeError(f"what Components.landmarks measures must be a LandmarkMeasurement, got {given}")
    return measurement
