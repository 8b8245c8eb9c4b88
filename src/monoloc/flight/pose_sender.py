"""What is sent to the autopilot, and when: never a pose while lost, never a stale one, and every jump is said."""

from __future__ import annotations

from collections import Counter
from typing import Any, Protocol

import numpy as np

from monoloc.flight.flight_loop import MOST_AHEAD_S, FlightStep
from monoloc.flight.flight_settings import FlightSettings
from monoloc.geometry import FloatArray, invert, rotation_angle
from monoloc.mavlink.autopilot_frames import AutopilotFrames, BodyPose
from monoloc.mavlink.firmware import Firmware
from monoloc.mavlink.messages import obstacle_distance, odometry, status_text, vision_position_estimate
from monoloc.mavlink.obstacle_sectors import sector_distances_cm
from monoloc.obstacles import LEAST_M, MOST_M, ObstacleWatch
from monoloc.rate_limiter import RateLimiter
from monoloc.supervision.state import BLIND, VOUCHED_FOR, in_words

_OBSTACLES_HZ = 10.0
_MOST_SPEED_M_S, _JUMP_M = 4.0, 0.2  # a pose that moved or turned farther than a vehicle can, has jumped
_MOST_TURN_RAD_S, _JUMP_RAD = 3.0, 0.15
_NO_IMAGE_S, _NO_FIRST_IMAGE_S = 0.5, 3.0  # a camera that was just opened takes a second or two
_NO_IMAGE = "monoloc: no image in time from the camera"
_NO_START = "monoloc: waits for a first image, or a marker"  # which of both, frames that are dropped do not tell here
# Without a pose that is young enough, after which that is said: PX4 stops using vision then.
_LATE_S, _TOO_LATE = 0.4, "poses come too late"
_TEXT_S = 1.0  # between texts on the same state: one that flickers must not fill the pilot's screen


class MessageSink(Protocol):
    """Takes messages; a :class:`~monoloc.mavlink.autopilot_link.AutopilotLink` is one."""

    def send(self, message: Any) -> None: ...


class PoseSender:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that sends pose, obstacles and texts.

    What is sent depends on the results alone, so that a replay sends the same bytes.

    Args:
        sink: takes the messages.
        frames: of vehicle and map.
        firmware: of the autopilot.
        settings: of the flight.
        watch: finds the obstacles; None sends none. In a place, each room that is entered brings its own.
        poses: counts those of frames that are not *lost*: ``sent``, or why not.
        waits_for_marker: whether no frame is localised before a marker is seen.
    """

    def __init__(
        self,
        sink: MessageSink,
        frames: AutopilotFrames,
        firmware: Firmware,
        settings: FlightSettings,
        watch: ObstacleWatch | None,
        poses: Counter[str],
        waits_for_marker: bool,
    ) -> None:
        self._sink, self._frames, self._firmware, self._settings = sink, frames, firmware, settings
        self._poses, self._waits_for_marker = poses, waits_for_marker
        self._reset_counter = 0
        self._jumped = self._is_confirmed = False
        self._sent: tuple[float, FloatArray] | None = None  # time of capture and T_ned_body of the last pose
        self._watch = watch
        self._pose_rate, self._obstacle_rate = RateLimiter(settings.rate_hz), RateLimiter(_OBSTACLES_HZ)
        self._said: tuple[str, float] = ("", float("-inf"))
        self._began_s: float | None = None  # to wait for a first frame
        self._frame_s: float | None = None
        self._in_time_s: float | None = None  # when a result was last young enough to be sent

    def take(self, result: FlightStep) -> None:
        self._frame_s = result.done_s
        if self._in_time_s is None or self._is_in_time(result):
            self._in_time_s = result.done_s
        self._say_state(result, result.done_s - self._in_time_s > _LATE_S)
        if result.in_place is not None and result.in_place.entered is not None:
            sends_obstacles = self._settings.obstacles and result.in_place.tells_obstacles
            self._watch = ObstacleWatch.entered(result.in_place.entered) if sends_obstacles else None
            self._jump()  # by the error of the door
        if result.step.state == "lost":
            self._jump()  # whatever comes next is elsewhere
            return
        if result.step.restarted:
            self._jump()
        pose = self._frames.body_pose(result.estimate)
        if not self._is_usable(result, pose):
            return
        if self._pose_rate.is_due(result.frame.captured_s):
            self._pose_rate.use(result.frame.captured_s)
            self._send_pose(result, pose)
        else:
            self._poses["beyond rate_hz"] += 1
        self._send_obstacles(result)

    def idle(self, now_s: float) -> None:
        self._began_s = now_s if self._began_s is None else self._began_s
        if self._frame_s is None and now_s - self._began_s > _NO_FIRST_IMAGE_S:
            self._say(_NO_START if self._waits_for_marker else _NO_IMAGE, True, now_s)
        elif self._frame_s is not None and now_s - self._frame_s > _NO_IMAGE_S:
            self._say(_NO_IMAGE, True, now_s)

    def close(self) -> None:
        """Nothing is held."""

    def _jump(self) -> None:
        self._jumped = True
        if self._watch is not None:
            self._watch.clear()

    def _is_usable(self, result: FlightStep, pose: BodyPose) -> bool:
        """Whether the result is of an image that shows something, a number, in time, and not a mere start.

        A start is where someone says that the camera is. After a restart in flight it is the place of the take-off,
        so nothing is sent before a first frame is vouched for.
        """
        self._is_confirmed |= result.step.state in VOUCHED_FOR
        if not self._is_confirmed:
            self._poses["unconfirmed"] += 1
            return False
        if result.step.reasons & BLIND:
            self._poses["without image"] += 1
            return False
        if not pose.is_finite:
            self._poses["not finite"] += 1
            return False
        if not self._is_in_time(result):
            self._poses["old" if result.done_s > result.frame.captured_s else "future"] += 1
            return False
        return True

    def _is_in_time(self, result: FlightStep) -> bool:
        return -MOST_AHEAD_S <= result.done_s - result.frame.captured_s <= self._settings.most_age_s

    def _send_pose(self, result: FlightStep, pose: BodyPose) -> None:
        captured_s = result.frame.captured_s
        if self._sent is None:
            # After a restart of this program, the autopilot must see another count than before; seconds would repeat
            # where the program starts with the computer.
            self._reset_counter = int(1e6 * captured_s) % 256
        else:
            if _moved_too_far(self._sent, (captured_s, pose.T_ned_body)):
                self._jump()
            self._reset_counter = (self._reset_counter + self._jumped) % 256
        self._jumped = False
        self._sent = captured_s, pose.T_ned_body
        quality = max(1, min(100, round(100.0 * (1.0 - result.step.probability_far))))
        if self._settings.message == "odometry":
            message = odometry(captured_s, pose, quality, self._reset_counter, self._firmware)
        else:
            message = vision_position_estimate(captured_s, pose, self._reset_counter)
        self._poses["sent"] += 1
        self._sink.send(message)

    def _send_obstacles(self, result: FlightStep) -> None:
        captured_s = result.frame.captured_s
        if self._watch is None or not self._obstacle_rate.is_due(captured_s):
            return
        around = self._watch.update(captured_s, result.step, self._frames.T_level_camera(result.estimate))
        if around is None:
            return
        self._obstacle_rate.use(captured_s)
        distances_cm = sector_distances_cm(around.distances_m)
        self._sink.send(obstacle_distance(captured_s, distances_cm, LEAST_M, MOST_M))

    def _say_state(self, result: FlightStep, is_late: bool) -> None:
        step = result.step
        unreadable = {} if result.in_place is None else result.in_place.unreadable
        problems = [_TOO_LATE if is_late else "", *(f"cannot enter {room}" for room in unreadable)]
        why = ", ".join(filter(None, [*problems, in_words(step.reasons)]))
        where = "" if result.room is None else f" in {result.room}"
        text = f"monoloc: {step.state}{where}" + (f": {why}" if why else "")
        self._say(text, is_late or bool(unreadable) or step.state != "tracking", result.done_s)

    def _say(self, text: str, is_alarming: bool, now_s: float) -> None:
        """Say a state once, and no sooner than a second after the last."""
        said, said_s = self._said
        if text == said or now_s - said_s < _TEXT_S:
            return
        self._said = text, now_s
        self._sink.send(status_text(text, is_alarming))


def _moved_too_far(before: tuple[float, FloatArray], after: tuple[float, FloatArray]) -> bool:
    """Whether a vehicle cannot have gone from one pose to the other, each a time in seconds and ``T_ned_body``."""
    elapsed_s, motion = after[0] - before[0], invert(before[1]) @ after[1]
    too_far = float(np.linalg.norm(motion[:3, 3])) > _JUMP_M + _MOST_SPEED_M_S * elapsed_s
    return too_far or float(rotation_angle(motion[:3, :3])) > _JUMP_RAD + _MOST_TURN_RAD_S * elapsed_s
