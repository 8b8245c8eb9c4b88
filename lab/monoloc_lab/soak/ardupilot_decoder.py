"""What ArduPilot makes of the messages of a visual odometry: the rules of its receiver, written independently.

Sources: ``GCS_Common.cpp`` (handle_odometry), ``AP_VisualOdom_MAV.cpp`` and ``AP_Proximity_MAV.cpp`` of ArduPilot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

_LOCAL_FRD, _BODY_FRD = 20, 12
_POSITION_NOISE_M, _YAW_NOISE_RAD = 0.2, math.radians(5.0)  # VISO_POS_M_NSE, and the least of VISO_YAW_M_NSE


@dataclass(frozen=True)
class Sample:
    """What the estimator is given: NED position, roll, pitch and yaw, and its two errors after their floors."""

    position: np.ndarray
    euler: np.ndarray
    position_error_m: float
    angle_error_rad: float
    reset_counter: int
    quality: int


class Refused(Exception):
    """The message is dropped without a word; the text says why."""


class ArduPilot:
    """Decodes one vehicle's messages."""

    def __init__(self, minimum_quality: int = 0) -> None:
        self._minimum_quality = minimum_quality

    def odometry(self, message: Any) -> Sample:
        if (message.frame_id, message.child_frame_id) != (_LOCAL_FRD, _BODY_FRD):
            raise Refused(f"frames {message.frame_id} and {message.child_frame_id}")
        if message.quality < self._minimum_quality:
            raise Refused("quality")
        covariance = message.pose_covariance
        position_error = angle_error = 0.0
        if not math.isnan(covariance[0]):
            position_error = math.sqrt(covariance[0] + covariance[6] + covariance[11])
            angle_error = math.sqrt(covariance[15] + covariance[18] + covariance[20])
        q1, q2, q3, q4 = message.q
        euler = np.array(
            [
                math.atan2(2 * (q1 * q2 + q3 * q4), 1 - 2 * (q2 * q2 + q3 * q3)),
                math.asin(max(-1.0, min(1.0, 2 * (q1 * q3 - q4 * q2)))),
                math.atan2(2 * (q1 * q4 + q2 * q3), 1 - 2 * (q3 * q3 + q4 * q4)),
            ]
        )
        return Sample(
            np.array([message.x, message.y, message.z]),
            euler,
            max(position_error, _POSITION_NOISE_M),
            max(angle_error, _YAW_NOISE_RAD),
            message.reset_counter,
            message.quality,
        )

    @staticmethod
    def obstacles(message: Any) -> dict[float, float]:
        """Distance, metres, by bearing in degrees clockwise from forward; what is out of range is dropped."""
        increment = message.increment_f if message.increment_f > 0 else float(message.increment)
        count = min(int(360.0 / increment), 72)
        found = {}
        for index in range(count):
            value = message.distances[index]
            if value in (0, 65535) or not message.min_distance <= value <= message.max_distance:
                continue
            found[(message.angle_offset + index * increment) % 360.0] = value / 100.0
        return found
