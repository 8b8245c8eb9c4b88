"""What a flight with an autopilot needs of map, vehicle and link."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from monoloc.bundle import Bundle
from monoloc.errors import SettingError
from monoloc.flight.flight_loop import FlightOutput, FlightSummary
from monoloc.flight.flight_recording import MESSAGES
from monoloc.flight.flight_settings import FlightSettings, LevelMap, down_of_map
from monoloc.flight.message_log import BackgroundMessageLog, MessageLog
from monoloc.flight.pose_sender import MessageSink, PoseSender
from monoloc.geometry import FloatArray
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.mavlink.firmware import Firmware
from monoloc.obstacles import ObstacleWatch, tells_obstacles
from monoloc.odometry.motion import Motion


def down_world(map_: LevelMap, settings: FlightSettings) -> FloatArray:
    """Direction of gravity in the map, (3,).

    Raises:
        SettingError: neither the map nor the settings tell it, or they contradict each other.
    """
    down = down_of_map(map_, settings)
    if down is None:
        fix = "write down = [x, y, z], its direction in the map, into flight.toml, and give that file"
        problem = "is missing, and floor and walls of this map do not show the direction of gravity"
        raise SettingError("down", problem, fix)
    return down


def tells_gravity(map_: LevelMap, settings: FlightSettings) -> bool:
    """Whether the map or the settings give the direction of gravity; raises where they contradict each other."""
    return down_of_map(map_, settings) is not None


def frames_of(map_: LevelMap, settings: FlightSettings) -> AutopilotFrames:
    """How the camera sits on the vehicle and how the map lies in the world.

    Raises:
        SettingError: as :func:`down_world`.
    """
    north_rad = float(np.deg2rad(settings.north_deg))
    return AutopilotFrames(settings.mount.T_body_camera, down_world(map_, settings), north_rad)


def obstacle_frames(map_: LevelMap, settings: FlightSettings) -> AutopilotFrames | None:
    """:func:`frames_of` to show obstacles by, or None where gravity is not known."""
    return frames_of(map_, settings) if tells_gravity(map_, settings) else None


def senders(
    sink: MessageSink | None,
    folder: Path | None,
    map_: LevelMap,
    room: Bundle | None,
    firmware: Firmware,
    settings: FlightSettings,
    summary: FlightSummary,
    waits_for_marker: bool,
) -> list[FlightOutput]:
    """The outputs that send to an autopilot, in their order.

    Args:
        sink: takes the messages; None only writes them.
        folder: of a recording, where they are written; None writes none.
        map_, firmware, settings: of the flight.
        room: whose obstacles are sent; None in a place, where each room that is entered brings its own.
        summary: counts the poses that are sent, and why others are not, and the messages that were sent but not
            written, since the disk was too slow.
        waits_for_marker: whether no frame is localised before a marker is seen.

    Raises:
        DataError: the recording cannot be written.
        SettingError: as :func:`down_world`.
    """
    frames = frames_of(map_, settings)
    watch = None
    if room is not None and settings.obstacles and tells_obstacles(room):
        watch = ObstacleWatch.of(room)

    def sender(to: MessageSink) -> PoseSender:
        return PoseSender(to, frames, firmware, settings, watch, summary.poses, waits_for_marker)

    if folder is not None:
        path = folder / MESSAGES
        log = MessageLog(path) if sink is None else BackgroundMessageLog(path, sink, summary.unwritten)
        return [log, sender(log)]
    return [] if sink is None else [sender(sink)]


def gravity_of(
    map_: LevelMap, link: AutopilotLink | None, settings: FlightSettings
) -> Callable[[float], FloatArray | None]:
    """Direction of gravity in the camera's frame at a time of capture, (3,), from the autopilot's attitude.

    None where there is no attitude, or where the map does not tell its own direction of gravity.
    """
    if link is None or map_.down is None:
        return lambda captured_s: None
    frames, attitude_at = frames_of(map_, settings), link.attitude_at

    def down_camera(captured_s: float) -> FloatArray | None:
        attitude = attitude_at(captured_s)
        return None if attitude is None else frames.down_camera(attitude.roll_rad, attitude.pitch_rad)

    return down_camera


def link_to(url: str, settings: FlightSettings) -> AutopilotLink:
    """The link to an autopilot on whose vehicle the camera is mounted; raises as :class:`AutopilotLink`."""
    return AutopilotLink(url, R_body_camera=settings.mount.T_body_camera[:3, :3])


def turns_of(link: AutopilotLink | None) -> Callable[[float, float], Motion | None]:
    """The camera's rotation between two times of capture, from the autopilot's attitude; None where there is none."""
    return (lambda start_s, end_s: None) if link is None else link.turn_between
