"""What the two autopilot firmwares accept: frames of a pose, and the parameters that make them fuse it.

Sources: PX4-Autopilot ``mavlink_receiver.cpp``, ``EKF2.cpp`` and ``ev_*_control.cpp``; ArduPilot ``GCS_Common.cpp``,
``AP_VisualOdom`` and ``AP_NavEKF3``; pull requests PX4 19097 and 27031, ArduPilot 26277 and 32084; both guides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Literal

LOCAL_NED, LOCAL_FRD, BODY_FRD = 1, 20, 12
"""Members of MAV_FRAME."""


class Firmware(Enum):
    """The autopilot's firmware."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"

    @property
    def title(self) -> str:
        """Its name for a person."""
        return "PX4" if self is Firmware.PX4 else "ArduPilot"

    @classmethod
    def of_heartbeat(cls, autopilot: int) -> Firmware | None:
        """Of HEARTBEAT's field ``autopilot``, a member of MAV_AUTOPILOT; None of another firmware."""
        return {3: cls.ARDUPILOT, 12: cls.PX4}.get(autopilot)

    def contradiction(self, heard: Firmware | None) -> str | None:
        """What an autopilot is, in words, whose heartbeat says another firmware; None if it says this or neither."""
        if heard in (None, self):
            return None
        return f"is {heard.title}, which expects poses in another frame than {self.title}"

    @property
    def pose_frame(self) -> int:
        """``frame_id`` of ODOMETRY.

        PX4 aligns its heading with a pose in LOCAL_NED, and refuses to arm without a magnetometer on LOCAL_FRD.
        ArduPilot drops every other frame than LOCAL_FRD, without a message, and takes its axes as north, east, down.
        """
        return LOCAL_NED if self is Firmware.PX4 else LOCAL_FRD

    @property
    def asked_rate(self) -> str:
        """Poses a second that its guide asks for."""
        return "30" if self is Firmware.PX4 else "4 or more"

    @property
    def parameters(self) -> tuple[ParameterRule, ...]:
        """Parameters to set on the autopilot."""
        return _PX4 if self is Firmware.PX4 else _ARDUPILOT


@dataclass(frozen=True)
class ParameterRule:
    """A parameter of the autopilot and the value that it needs.

    Attributes:
        name: of the parameter.
        value: that it needs.
        why: what goes wrong otherwise.
        is_mask: whether ``value`` is a set of bits, of which the parameter may have more.
        tolerance: by which the parameter may differ from ``value``.
        level: of the doctor's finding where it differs by more.
    """

    name: str
    value: float
    why: str
    is_mask: bool = False
    tolerance: float = 1e-6
    level: Literal["warning", "bad"] = "bad"

    def holds(self, value: float) -> bool:
        """Whether a parameter's value is as it must be; NaN is not."""
        if not math.isfinite(value):
            return False
        if self.is_mask:
            bits = int(self.value)
            return int(value) & bits == bits
        return abs(value - self.value) <= self.tolerance


_PX4 = (
    ParameterRule("EKF2_EV_CTRL", 11, "without bits 0, 1 and 3 position, height or yaw is not fused", is_mask=True),
    ParameterRule("EKF2_HGT_REF", 3, "another height reference pulls the height away from the map's"),
    ParameterRule("EKF2_EV_POS_X", 0, "monoloc sends the pose of the body, not of the camera"),
    ParameterRule("EKF2_EV_POS_Y", 0, "monoloc sends the pose of the body, not of the camera"),
    ParameterRule("EKF2_EV_POS_Z", 0, "monoloc sends the pose of the body, not of the camera"),
    ParameterRule("EKF2_EV_NOISE_MD", 0, "otherwise the covariance that monoloc sends is ignored"),
    ParameterRule(
        "EKF2_EV_DELAY",
        0,
        "monoloc sends the time of capture; only what the camera's stamps leave out is to be added",
        tolerance=20.0,
        level="warning",
    ),
)

_ARDUPILOT = (
    ParameterRule("VISO_TYPE", 1, "2 and 3 align a jump away, so a relocalisation is lost"),
    ParameterRule("VISO_POS_X", 0, "monoloc sends the pose of the body, not of the camera"),
    ParameterRule("VISO_POS_Y", 0, "monoloc sends the pose of the body, not of the camera"),
    ParameterRule("VISO_POS_Z", 0, "monoloc sends the pose of the body, not of the camera"),
    ParameterRule("VISO_ORIENT", 0, "monoloc sends the pose of the body, not of the camera"),
    ParameterRule("VISO_SCALE", 1, "monoloc's positions are in metres"),
    ParameterRule("EK3_SRC1_POSXY", 6, "otherwise the position is not fused"),
    ParameterRule("EK3_SRC1_POSZ", 6, "otherwise the height is not fused"),
    ParameterRule("EK3_SRC1_YAW", 6, "otherwise the yaw is not fused"),
    ParameterRule("EK3_SRC1_VELXY", 0, "monoloc sends no velocity"),
    ParameterRule("EK3_SRC1_VELZ", 0, "monoloc sends no velocity"),
)
