"""What a short flight on the ground says of camera, room and link, before the first arm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from monoloc.bundle_manifest import Provenance
from monoloc.errors import DataError
from monoloc.flight.flight_loop import FlightStep, FlightSummary
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.mount_check import MOST_TILT_DEG, MOST_YAW_DEG, MountErrors
from monoloc.mavlink.firmware import Firmware
from monoloc.recording_check.image_quality import ImageQuality, quality_of
from monoloc.recording_check.inspection import Finding, Level, image_findings, light_findings
from monoloc.supervision.camera_check import tells_focal
from monoloc.supervision.distinct_views import DistinctViews
from monoloc.supervision.state import VOUCHED_FOR, Reason

GOOD_SCALE_SD = 0.05
"""Relative standard deviation of a map's scale up to which its poses are for an autopilot: 5 cm in a metre."""

_LEAST_RATE_HZ, _GOOD_RATE_HZ = 5.0, 15.0  # PX4 stops to fuse below 5 Hz
_LEAST_SHARE = 0.97  # of a camera's stated rate that is measured
_FEW_DROPPED = 0.1  # of the frames: the computer keeps up with the source
_GOOD_LATENCY_S = 0.1  # from capture to result
_MOST_PAUSE_S = 0.3  # after which ArduPilot no longer uses vision; PX4 waits for 0.4 s
_GOOD_TRACKING, _LEAST_TRACKING = 0.9, 0.5  # shares of frames
_GOOD_ROUND_TRIP_S = 0.05  # beyond it, what is sent waits for the port
_LEAST_ATTITUDE_HZ = 9.0  # of nominally 10
_GOOD_LANDMARKS = 20
_LEAST_VIEWS = 3  # whose landmarks tell the focal length, before they speak for it
_POSE_BYTES, _OBSTACLES_BYTES_A_SECOND = 245, 1790  # of ODOMETRY, and of ten OBSTACLE_DISTANCE a second
_MOST_LOAD = 0.8  # of a serial port
_GOOD_TILT_DEG = 3.0  # between the body by mount and by the autopilot
_EVERY = 3  # of the frames whose image is measured


@dataclass(frozen=True)
class LinkReport:
    """What is known of an autopilot.

    Attributes:
        firmware: that the user says it has.
        heard: firmware that its heartbeat says; None of another one.
        is_alive: whether its heartbeat is heard.
        attitude_hz: how often it sends its attitude; 0 if it does not.
        round_trip_s: of a question for the time; None where none was answered.
        parameters: values that it gave, by name.
        settings: of the flight.
        bytes_a_second: that a serial port takes; None of another one.
        mount: by its attitude; None where that was not compared.
        hears_noise: whether a serial port gave bytes, but never a message.
    """

    firmware: Firmware
    heard: Firmware | None
    is_alive: bool
    attitude_hz: float
    round_trip_s: float | None
    parameters: Mapping[str, float]
    settings: FlightSettings
    bytes_a_second: float | None = None
    mount: MountErrors | None = None
    hears_noise: bool = False


class Preflight:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that looks at every frame.

    Args:
        provenance: of the bundle that is flown in, or of the first room of a place.
        tells_gravity: whether the map or the flight's settings tell the direction of gravity.
        scale_sd: relative standard deviation of the map's scale; 0 where a sensor measured it.
        has_landmarks: whether the map has any.
        roll_deg: of the camera's mount, as the user states it; 0 where it is not stated.
        most_age_s: of the flight, beyond which a pose is not sent.
        faster: what would make a step faster.
    """

    def __init__(
        self,
        provenance: Provenance,
        tells_gravity: bool,
        scale_sd: float,
        has_landmarks: bool,
        roll_deg: float,
        most_age_s: float,
        faster: str,
    ) -> None:
        self._faster = faster
        self._provenance, self._tells_gravity, self._scale_sd = provenance, tells_gravity, scale_sd
        self._has_landmarks = has_landmarks
        self._roll_deg, self._most_age_s = roll_deg, most_age_s
        self._brightness = provenance.brightness
        self._count = 0
        self._frame_s: float | None = None  # when the last frame was done
        self._pause_s = 0.0  # the longest time without another
        self._quality: list[tuple[float, float, float, float]] = []
        self._landmarks: list[int] = []
        self._views, self._view_count = DistinctViews(), 0  # that tell the focal length
        self._reasons: Counter[Reason] = Counter()
        self._standing_share = 0.0  # of the image

    def take(self, result: FlightStep) -> None:
        if self._count % _EVERY == 0:
            self._quality.append(quality_of(result.frame.color))
        self._count += 1
        self._frame_s = result.done_s
        pose = result.step.landmark_pose
        self._landmarks.append(0 if pose is None else len(pose.points))
        if pose is not None and tells_focal(pose) and self._views.is_new(result.step.estimate.pose):
            self._view_count += 1
        self._reasons.update(result.step.reasons)
        self._standing_share = result.step.standing_share
        if result.in_place is not None and result.in_place.entered is not None:
            self._brightness = result.in_place.entered.provenance.brightness

    def idle(self, now_s: float) -> None:
        if self._frame_s is not None:
            self._pause_s = max(self._pause_s, now_s - self._frame_s)

    def close(self) -> None:
        """Nothing is held."""

    def findings(
        self, summary: FlightSummary, link: LinkReport | None, failure: DataError | None = None
    ) -> list[Finding]:
        """What was found, in order of the way from the lens to the autopilot.

        Args:
            link: to the autopilot, if one was asked for.
            failure: of the camera, which ended the look.
        """
        if failure is not None:
            problem, _, fix = str(failure).rpartition("; ")
            found = [Finding("camera", "bad", problem, fix)]
        elif summary.frames == 0:
            found = [_without_frames(summary)]
        else:
            images = self._images()
            found = [
                *_of_timing(summary, self._most_age_s, None if link is None else link.firmware, self._faster),
                *self._of_pauses(is_for_autopilot=link is not None),
                *image_findings(images, "expose for a shorter time, add light, clean the lens", "add light"),
                *light_findings(images, self._brightness),
                *self._of_view(),
                *self._of_intrinsics(),
                *self._of_room(summary),
            ]
        found += self._of_map(link is not None)
        return found if link is None else [*found, *_of_link(link), *_of_sending(link, summary.rate_hz)]

    def _of_pauses(self, is_for_autopilot: bool) -> Iterator[Finding]:
        """What the rate, a median, hides: a camera that comes and goes, or is gone at the end."""
        if self._pause_s > _MOST_PAUSE_S:
            remark = "check the cable, its power or the network: after 0.3 s, an autopilot stops using vision"
            level: Level = "bad" if is_for_autopilot else "warning"
            yield Finding("pauses", level, f"{self._pause_s:.1f} s without an image in time", remark)

    def _images(self) -> ImageQuality:
        return ImageQuality(np.arange(len(self._quality)), *np.array(self._quality).T)

    def _of_map(self, is_for_autopilot: bool) -> Iterator[Finding]:
        """What an autopilot needs of the map."""
        level: Level = "bad" if is_for_autopilot else "warning"
        if self._tells_gravity:
            yield Finding("gravity", "good", "known")
        else:
            remark = "write down = [x, y, z] into flight.toml"
            if any(self._provenance.down_world):
                mean = ", ".join(f"{value:.3f}" for value in self._provenance.down_world)
                remark += f"; [{mean}] if the build's camera looked level on average"
            yield Finding("gravity", level, "floor and walls do not show it", remark)
        if self._scale_sd > GOOD_SCALE_SD:
            remark = "give the build a marker or a distance (--scale) before an autopilot uses its poses"
            yield Finding("scale", level, f"known to {self._scale_sd:.0%}", remark)

    def _of_view(self) -> Iterator[Finding]:
        if self._standing_share:
            value = f"{self._standing_share:.0%} of the image stands still while the camera moves, and is not used"
            remark = "clean the lens, or move the camera away from parts of the drone"
            yield Finding("view", "warning", value, remark)

    def _of_intrinsics(self) -> Iterator[Finding]:
        if self._reasons[Reason.CAMERA_TURNED]:
            verb = "correct" if self._roll_deg else "state"
            remark = f"{verb} roll_deg in [mount]; if the build's images lay on their side, build again with down"
            yield Finding("orientation", "bad", "images lie on their side or upside down", remark)
        if self._reasons[Reason.CAMERA_MISMATCH]:
            remark = "calibrate the camera at this resolution, with its focus fixed, and do not stretch its images"
            yield Finding("intrinsics", "bad", "landmarks fit another lens", remark)
        elif self._reasons[Reason.CAMERA_UNCONFIRMED]:
            remark = "carry the camera past things that are near and far, or build with this camera"
            yield Finding("intrinsics", "warning", "the focal length is neither the build's nor confirmed", remark)
        elif np.median(self._landmarks) >= _GOOD_LANDMARKS:
            yield self._of_focal_length()
        elif self._has_landmarks:
            yield Finding("intrinsics", "warning", "not compared", "look where the build recorded corners")
        else:
            yield Finding("intrinsics", "warning", "not compared", "only landmarks tell; calibrate the camera")

    def _of_focal_length(self) -> Finding:
        """Of a camera that no landmarks contradict, though many are in view."""
        if self._view_count < _LEAST_VIEWS:
            remark = "carry the camera past things near and far: one place, or a flat view, tells no focal length"
            return Finding("intrinsics", "warning", "not compared", remark)
        return Finding("intrinsics", "good", "landmarks do not contradict the stated focal length")

    def _of_room(self, summary: FlightSummary) -> Iterator[Finding]:
        seen = int(np.median(self._landmarks))
        remark = "" if seen >= _GOOD_LANDMARKS else "look at a part of the room that the build recorded"
        if not self._has_landmarks:
            remark = "the map has none; build with landmarks, from images with texture"
        yield Finding("landmarks", "warning" if remark else "good", f"{seen} a frame (median)", remark)
        if summary.rooms:
            yield Finding("rooms", "good", f"the camera was in {len(summary.rooms)} of the place")
        share = sum(summary.states[state] for state in VOUCHED_FOR) / summary.frames
        level: Level = "good" if share >= _GOOD_TRACKING else "warning" if share >= _LEAST_TRACKING else "bad"
        why = ", ".join(f"{reason.value} ({count})" for reason, count in self._reasons.most_common(3))
        yield Finding(
            "state",
            level,
            f"{' or '.join(sorted(VOUCHED_FOR, reverse=True))} in {share:.0%} of {summary.frames} frames",
            why,
        )


def _without_frames(summary: FlightSummary) -> Finding:
    """Why not one frame was localised."""
    dropped = summary.dropped
    reason = max(("without start", "old", "future"), key=lambda each: dropped[each])
    if count := dropped[reason]:
        if reason == "without start":
            return Finding("start", "bad", f"no marker in {count} images", "show the camera a marker of flight.toml")
        problem = f"{count} images, too old" if reason == "old" else f"{count} images stamped ahead of the clock"
        return Finding("camera", "bad", problem, "use a faster network, and a source whose time stamps are right")
    return Finding("camera", "bad", "no frame", "check the cable, and the source that was named")


def _of_timing(
    summary: FlightSummary, most_age_s: float, firmware: Firmware | None, faster: str
) -> Iterator[Finding]:
    rate_hz, median_s, p95_s = summary.rate_hz, summary.latency_s(50.0), summary.latency_s(95.0)
    if rate_hz is not None:
        level: Level = "warning" if rate_hz >= _LEAST_RATE_HZ or firmware is None else "bad"
        level = "good" if rate_hz >= _LEAST_SHARE * _GOOD_RATE_HZ else level
        dropped = summary.dropped.total() - summary.dropped["early"]
        is_slow_camera = dropped <= _FEW_DROPPED * summary.frames
        asked = "" if firmware is None else f"; {firmware.title} asks for {firmware.asked_rate}"
        fix = f"the source gives no more{asked}" if is_slow_camera else faster
        remark = "" if level == "good" else fix
        yield Finding("rate", level, f"{rate_hz:.1f} Hz, {dropped} frames dropped", remark)
    if median_s is not None and p95_s is not None:
        level = "good" if p95_s <= _GOOD_LATENCY_S else "warning"
        level = level if p95_s <= most_age_s else "bad"
        too_old = "" if p95_s <= most_age_s else f"; poses older than most_age_s, {most_age_s:g} s, are not sent"
        remark = "" if level == "good" else f"where the computer is slow, {faster}{too_old}"
        yield Finding("latency", level, f"{1e3 * median_s:.0f} ms (95 %: {1e3 * p95_s:.0f} ms)", remark)


def _of_link(link: LinkReport) -> Iterator[Finding]:
    if not link.is_alive:
        yield _of_silence(link)
        return
    if link.heard is not None and (problem := link.firmware.contradiction(link.heard)):
        yield Finding("autopilot", "bad", problem, f"set firmware to {link.heard.value}")
        return
    yield Finding("autopilot", "good", "its heartbeat is heard")
    is_often = link.attitude_hz >= _LEAST_ATTITUDE_HZ
    remark = "" if is_often else "ask the port for ATTITUDE, 10 Hz or more: else gravity and turns are hardly used"
    yield Finding("attitude", "good" if is_often else "warning", f"{link.attitude_hz:.0f} Hz", remark)
    if link.round_trip_s is None:
        remark = "it does not answer TIMESYNC: its clock is not compared, and stamps may count as times of arrival"
        yield Finding("round trip", "warning", "unknown", remark)
    else:
        is_good = link.round_trip_s <= _GOOD_ROUND_TRIP_S
        remark = "" if is_good else "use a faster port, or send fewer messages: they wait for it"
        yield Finding("round trip", "good" if is_good else "warning", f"{1e3 * link.round_trip_s:.0f} ms", remark)
    yield from _of_mount(link.mount)
    yield from _of_parameters(link)


def _of_parameters(link: LinkReport) -> Iterator[Finding]:
    rules = link.firmware.parameters
    if silent := [rule for rule in rules if rule.name not in link.parameters]:
        remark = "let the port pass parameters on, or compare by hand: "
        remark += ", ".join(f"{rule.name} = {rule.value:g}" for rule in silent)
        yield Finding("parameters", "warning", f"{len(silent)} of {len(rules)} not answered", remark)
    for rule in rules:
        if rule.name not in link.parameters:
            continue
        if rule.holds(link.parameters[rule.name]):
            yield Finding(rule.name, "good", f"{link.parameters[rule.name]:g}")
        else:
            yield Finding(
                rule.name, rule.level, f"{link.parameters[rule.name]:g}", f"set it to {rule.value:g}: {rule.why}"
            )


def _of_silence(link: LinkReport) -> Finding:
    if link.hears_noise:
        remark = "set the port's baud rate on both sides, and its protocol to MAVLink"
        return Finding("autopilot", "bad", "no heartbeat, but bytes that are no MAVLink", remark)
    return Finding("autopilot", "bad", "no heartbeat", "check address, cable and the port's protocol")


def _of_sending(link: LinkReport, rate_hz: float | None) -> Iterator[Finding]:
    """Whether a flight will send often enough, and whether a serial port takes it."""
    settings = link.settings
    if settings.rate_hz < min(_GOOD_RATE_HZ, rate_hz or 0.0):
        level: Level = "warning" if settings.rate_hz >= _LEAST_RATE_HZ else "bad"
        remark = f"raise it to {_GOOD_RATE_HZ:g} or more in flight.toml"
        yield Finding("rate_hz", level, f"{settings.rate_hz:g} poses a second at most", remark)
    if link.bytes_a_second is None or rate_hz is None:
        return
    needed = min(rate_hz, settings.rate_hz) * _POSE_BYTES + settings.obstacles * _OBSTACLES_BYTES_A_SECOND
    is_enough = needed <= _MOST_LOAD * link.bytes_a_second
    remark = "" if is_enough else "use 921600 baud, or a lower rate_hz or no obstacles in flight.toml"
    how_much = f"{needed / 1e3:.1f} of {link.bytes_a_second / 1e3:.1f} kB a second"
    yield Finding("serial port", "good" if is_enough else "bad", how_much, remark)


def _of_mount(errors: MountErrors | None) -> Iterator[Finding]:
    """Whether the body's attitude by the mount is the autopilot's."""
    if errors is None:
        return
    level: Level = "good" if errors.tilt_deg <= _GOOD_TILT_DEG else "warning"
    level = "bad" if errors.tilt_deg > MOST_TILT_DEG else level
    found = f"tilt differs from the autopilot's by {errors.tilt_deg:.1f}°"
    turn = f"pitch {errors.pitch_deg:+.0f}°, roll {errors.roll_deg:+.0f}°"
    remark = "" if level == "good" else f"correct pitch_deg and roll_deg of [mount]: the body comes out at {turn}"
    yield Finding("mount", level, found, remark)
    if abs(errors.yaw_deg) > MOST_YAW_DEG:
        problem = f"differs from the autopilot's by {errors.yaw_deg:+.0f}°"
        yield Finding("heading", "warning", problem, "measure north_deg: monoloc fly ... --align")
