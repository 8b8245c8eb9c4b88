"""Settings of a flight: how the camera sits on the vehicle, how the map lies, what is too old (``flight.toml``)."""

from __future__ import annotations

import math
from typing import Literal, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, angle_between, make_pose, so3_exp
from monoloc.image_turns import turns_on_body

_LEAST_LENGTH = 1e-6  # of a direction
_MOST_APART_DEG = 15.0  # of two directions of gravity; floor and walls tell it to a few degrees
_R_BODY_FORWARD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Axes of a camera that looks forward and stands upright, in the body's axes: forward, right, down."""


class LevelMap(Protocol):
    """A map that may tell its direction of gravity; a :class:`~monoloc.bundle.Bundle` is one."""

    @property
    def down(self) -> FloatArray | None:
        """(3,) unit vector, or None where the map does not tell."""
        ...


class Mount(BaseModel):
    """How the camera sits on the vehicle.

    Attributes:
        forward_m, right_m, down_m: position of the camera, from where the autopilot has its origin.
        yaw_deg, pitch_deg, roll_deg: turn of a camera that looks forward and stands upright, in this order: to the
            right, then up, then clockwise as the camera sees. A camera that looks down has a pitch of -90.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    forward_m: float = Field(0.0, ge=-10.0, le=10.0)
    right_m: float = Field(0.0, ge=-10.0, le=10.0)
    down_m: float = Field(0.0, ge=-10.0, le=10.0)
    yaw_deg: float = Field(0.0, ge=-360.0, le=360.0)
    pitch_deg: float = Field(0.0, ge=-90.0, le=90.0)
    roll_deg: float = Field(0.0, ge=-360.0, le=360.0)

    @property
    def T_body_camera(self) -> FloatArray:
        """Pose of the camera on the body, whose axes are forward, right, down; (4, 4)."""
        turns = np.deg2rad(np.diag([self.roll_deg, self.pitch_deg, self.yaw_deg]))  # about forward, right, down
        rotation = so3_exp(turns[2]) @ so3_exp(turns[1]) @ so3_exp(turns[0]) @ _R_BODY_FORWARD
        return make_pose(rotation, [self.forward_m, self.right_m, self.down_m])

    @property
    def quarter_turns(self) -> int:
        """Turns, 0 to 3, that bring the images upright in level flight; 0 of a camera that looks up or down."""
        return turns_on_body(self.T_body_camera)

    @property
    def upright(self) -> Mount:
        """The mount of the camera whose images are turned upright."""
        roll_deg = self.roll_deg + 90.0 * self.quarter_turns
        return self.model_copy(update={"roll_deg": (roll_deg + 180.0) % 360.0 - 180.0})


class FlightSettings(BaseModel):
    """Settings of a flight.

    Attributes:
        mount: of the camera.
        north_deg: heading of the map's x axis, clockwise from north as seen from above; ``monoloc fly --align``
            measures it. The map of a place is that of its first room.
        down: direction of gravity in the map; None takes that of the recording, or of the map's floor and walls.
        most_age_s: since its capture, beyond which a frame is not localised and a pose is not sent.
        rate_hz: most poses a second that are sent.
        obstacles: whether OBSTACLE_DISTANCE is sent.
        message: that carries the pose; ``vision_position_estimate`` is for firmware that does not know ODOMETRY.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    mount: Mount = Mount()
    north_deg: float = Field(0.0, ge=-360.0, le=360.0)
    down: tuple[float, float, float] | None = None
    most_age_s: float = Field(0.2, gt=0.0, le=10.0)
    rate_hz: float = Field(50.0, gt=0.0, le=500.0)
    obstacles: bool = True
    message: Literal["odometry", "vision_position_estimate"] = "odometry"

    @field_validator("down")
    @classmethod
    def _check_down(cls, down: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if down is not None and not _LEAST_LENGTH <= math.hypot(*down) < np.inf:
            raise ValueError("it has no direction")
        return down


def down_of_map(map_: LevelMap, settings: FlightSettings) -> FloatArray | None:
    """Direction of gravity in the map, (3,), by the settings or else by the map; None where neither tells it.

    Raises:
        SettingError: the two contradict each other.
    """
    if settings.down is None:
        return map_.down
    down: FloatArray = np.array(settings.down) / np.linalg.norm(settings.down)
    if map_.down is not None:
        apart_deg = float(np.rad2deg(angle_between(down, map_.down)))
        if apart_deg > _MOST_APART_DEG:
            known = ", ".join(f"{value:.2f}" for value in map_.down)
            problem = f"is {apart_deg:.0f}° from the direction that the map tells, [{known}]"
            raise SettingError("down", problem, "leave it out of flight.toml, or correct it")
    return down
