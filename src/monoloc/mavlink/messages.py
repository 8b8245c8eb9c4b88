"""The messages that monoloc sends to an autopilot, by each firmware's rules.

Sources: the MAVLink common dialect (ODOMETRY 331, VISION_POSITION_ESTIMATE 102, OBSTACLE_DISTANCE 330, STATUSTEXT
253, HEARTBEAT 0); for what is accepted, see :mod:`monoloc.mavlink.firmware`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import rotation_to_quaternion
from monoloc.mavlink.autopilot_frames import BodyPose
from monoloc.mavlink.firmware import BODY_FRD, Firmware

COMPONENT = 197
"""MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY."""

UNKNOWN_CM = 65535
"""Of a sector of OBSTACLE_DISTANCE of which nothing is known."""

AUTOPILOT_COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1: the autopilot itself, among the parts of a vehicle."""

_ONBOARD_CONTROLLER, _INVALID_AUTOPILOT, _ACTIVE = 18, 8, 4  # of HEARTBEAT: type, autopilot, system_status
_VISION = 2  # MAV_ESTIMATOR_TYPE_VISION; PX4 ignores the covariance of a NAIVE one
_UNKNOWN_SENSOR = 4  # MAV_DISTANCE_SENSOR_UNKNOWN
_MOST_TEXT = 50  # bytes of STATUSTEXT
_UPPER = np.triu_indices(6)


def dialect() -> Any:
    """pymavlink's common dialect, which is imported only where a link is opened."""
    from pymavlink.dialects.v20 import common

    return common


def odometry(captured_s: float, pose: BodyPose, quality: int, reset_counter: int, firmware: Firmware) -> Any:
    """ODOMETRY: the pose of the body, without velocity.

    Args:
        captured_s: time of the image by the clock that answers TIMESYNC.
        pose: finite.
        quality: 1 to 100 per cent.
        reset_counter: 0 to 255, changed where the pose jumped.
        firmware: that receives it.
    """
    x, y, z = pose.T_ned_body[:3, 3].tolist()
    nan = float("nan")
    return dialect().MAVLink_odometry_message(
        time_usec=microseconds(captured_s),
        frame_id=firmware.pose_frame,
        child_frame_id=BODY_FRD,
        x=x,
        y=y,
        z=z,
        q=_quaternion_wxyz(pose),
        vx=nan,  # unknown; zero would say that the vehicle stands still
        vy=nan,
        vz=nan,
        rollspeed=nan,
        pitchspeed=nan,
        yawspeed=nan,
        pose_covariance=pose.covariance[_UPPER].tolist(),
        velocity_covariance=[nan] * 21,
        reset_counter=reset_counter,
        estimator_type=_VISION,
        quality=quality,
    )


def vision_position_estimate(captured_s: float, pose: BodyPose, reset_counter: int) -> Any:
    """VISION_POSITION_ESTIMATE, for firmware that does not know ODOMETRY; arguments as :func:`odometry`."""
    x, y, z = pose.T_ned_body[:3, 3].tolist()
    roll, pitch, yaw = pose.euler_rad.tolist()
    return dialect().MAVLink_vision_position_estimate_message(
        usec=microseconds(captured_s),
        x=x,
        y=y,
        z=z,
        roll=roll,
        pitch=pitch,
        yaw=yaw,
        covariance=pose.covariance[_UPPER].tolist(),
        reset_counter=reset_counter,
    )


def obstacle_distance(captured_s: float, distances_cm: NDArray[np.uint16], least_m: float, most_m: float) -> Any:
    """OBSTACLE_DISTANCE of 72 sectors.

    Args:
        captured_s: as :func:`odometry`.
        distances_cm: (72,) as :func:`monoloc.mavlink.obstacle_sectors.sector_distances_cm` gives them.
        least_m, most_m: range of what is measured.
    """
    return dialect().MAVLink_obstacle_distance_message(
        time_usec=microseconds(captured_s),
        sensor_type=_UNKNOWN_SENSOR,
        distances=distances_cm.tolist(),
        increment=360 // len(distances_cm),
        min_distance=round(100.0 * least_m),
        max_distance=round(100.0 * most_m),
        increment_f=360.0 / len(distances_cm),
        angle_offset=0.0,
        frame=BODY_FRD,
    )


def status_text(text: str, is_alarming: bool) -> Any:
    """STATUSTEXT, at most 50 bytes of ASCII, as a warning or a notice; a longer text ends at its last whole item."""
    severity = 4 if is_alarming else 5  # MAV_SEVERITY_WARNING, MAV_SEVERITY_NOTICE
    if len(text) > _MOST_TEXT:
        text = text[: _MOST_TEXT + len(", ")].rpartition(", ")[0] or text[:_MOST_TEXT]
    return dialect().MAVLink_statustext_message(severity, text.encode("ascii", "replace"))


def heartbeat() -> Any:
    """HEARTBEAT of a component that is no autopilot."""
    return dialect().MAVLink_heartbeat_message(_ONBOARD_CONTROLLER, _INVALID_AUTOPILOT, 0, 0, _ACTIVE, 3)


def timesync(own_ns: int, asked_ns: int) -> Any:
    """TIMESYNC: an answer has the own clock and the asker's stamp as it came; a question has 0 and the own stamp."""
    return dialect().MAVLink_timesync_message(own_ns, asked_ns)


def parameter_request(name: str, system: int) -> Any:
    """PARAM_REQUEST_READ of a parameter of the autopilot of a vehicle."""
    return dialect().MAVLink_param_request_read_message(system, AUTOPILOT_COMPONENT, name.encode("ascii"), -1)


def microseconds(time_s: float) -> int:
    """Of a time stamp in seconds; messages know none before 0, which a recording may have."""
    return max(0, round(time_s * 1e6))


def _quaternion_wxyz(pose: BodyPose) -> list[float]:
    x, y, z, w = rotation_to_quaternion(pose.T_ned_body[:3, :3]).tolist()
    return [w, x, y, z]
