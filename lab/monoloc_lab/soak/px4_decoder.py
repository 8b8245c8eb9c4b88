"""What PX4 makes of the messages of a visual odometry: the rules of its receiver and of EKF2, written independently.

Sources: ``mavlink_receiver.cpp`` (handle_message_odometry, handle_message_vision_position_estimate) and ``EKF2.cpp``
(UpdateExtVisionSample) of PX4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

_FRAMES = {1: "NED", 20: "FRD", 4: "ENU", 21: "FLU"}  # LOCAL_NED, LOCAL_FRD, LOCAL_ENU, LOCAL_FLU
_NAIVE = 1
_EVP_NOISE_M, _EVA_NOISE_RAD = 0.1, 0.1  # default floors


@dataclass(frozen=True)
class Sample:
    """What the estimator is given: NED position, attitude, and variances after its floors."""

    position: np.ndarray
    R_ned_body: np.ndarray
    position_variance: np.ndarray
    yaw_variance: float
    reset_counter: int
    quality: int
    time_us: int


class Refused(Exception):
    """The message is dropped; the text says why."""


class Px4:
    """Decodes one vehicle's messages."""

    def __init__(self, minimum_quality: int = 0) -> None:
        self._minimum_quality = minimum_quality

    def odometry(self, message: Any) -> Sample:
        if message.frame_id not in _FRAMES:
            raise Refused(f"frame {message.frame_id}")
        if message.frame_id in (4, 21):
            raise Refused("these tests know no ENU")
        position = np.array([message.x, message.y, message.z])
        if not np.all(np.isfinite(position)):
            raise Refused("position")
        w, x, y, z = message.q
        if abs(math.sqrt(w * w + x * x + y * y + z * z) - 1.0) > 1e-3:
            raise Refused("quaternion")
        if self._minimum_quality > 0 and message.quality < self._minimum_quality:
            raise Refused("quality")
        variances = np.full(6, np.nan)
        if message.estimator_type != _NAIVE:
            variances = np.array([message.pose_covariance[i] for i in (0, 6, 11, 15, 18, 20)])
        noise = np.maximum(np.nan_to_num(variances[:3]), _EVP_NOISE_M**2)
        yaw = max(float(np.nan_to_num(variances[5])), _EVA_NOISE_RAD**2)
        return Sample(
            position, _rotation(w, x, y, z), noise, yaw, message.reset_counter, message.quality, message.time_usec
        )


def _rotation(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
