"""What the doctor says of good and bad flights on the ground."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mavlink_helpers import result_at, step_at
from monoloc.bundle_manifest import Provenance
from monoloc.flight.flight_loop import FlightStep, FlightSummary
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.mount_check import MountErrors
from monoloc.flight.preflight import LinkReport, Preflight
from monoloc.geometry import FloatArray, se3_exp
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.mavlink.firmware import Firmware
from monoloc.recording_check.inspection import Finding, Level, worst
from monoloc.step import Step
from monoloc.supervision.state import Reason

SHARP = np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)
PARAMETERS = {rule.name: rule.value for rule in Firmware.PX4.parameters}
FITS = MountErrors(tilt_deg=1.0, pitch_deg=0.5, roll_deg=0.8, yaw_deg=4.0)
HEARD = LinkReport(Firmware.PX4, Firmware.PX4, True, 50.0, 0.004, PARAMETERS, FlightSettings(), 92160.0, FITS)


FASTER = "set threads = 2, then budget_ms"
BUILD = Provenance(
    recording="room", frames={}, tune="all", map_transform=True, lambda_kl=0.1, seed=0, brightness=(128.0, 15.0)
)


def built(**update: object) -> Provenance:
    return BUILD.model_copy(update=update)


def good_step(landmarks: int = 80, log_focal_sd: float = 0.005) -> Step:
    place = LandmarkPose(np.eye(4), np.eye(6), np.zeros((landmarks, 3)), log_focal_sd=log_focal_sd)
    return replace(step_at(np.eye(4)), landmark_pose=place)


def findings_of(
    step: Step,
    color: FloatArray = SHARP,
    rate_hz: float = 30.0,
    age_s: float = 0.04,
    late: int = 0,
    link: LinkReport | None = HEARD,
    build: Provenance = BUILD,
    tells_gravity: bool = True,
    has_landmarks: bool = True,
    roll_deg: float = 0.0,
    most_age_s: float = 0.2,
    speed_m_s: float = 0.3,
) -> dict[str, Finding]:
    """Findings by name after 60 equal frames of a camera that moves, and ``late`` ones that were dropped.

    Another 40 came while the room was being read, which says nothing of the computer.
    """
    preflight = Preflight(build, tells_gravity, build.scale_sd or 0.0, has_landmarks, roll_deg, most_age_s, FASTER)
    summary = FlightSummary()
    for index in range(60):
        result = result_at(index / rate_hz, step, age_s)
        frame = replace(result.frame, color=color)
        pose = se3_exp([speed_m_s * index / rate_hz, 0.0, 0.0, 0.0, 0.0, 0.0])
        moved = replace(step, estimate=replace(step.estimate, pose=pose))
        result = FlightStep(frame, 1.0 / rate_hz, None, moved, result.done_s)
        summary.add(result)
        preflight.take(result)
    summary.dropped += Counter({"late": late, "early": 40})
    findings = preflight.findings(summary, link)
    assert all(finding.level == "good" or finding.remark for finding in findings)
    return {finding.name: finding for finding in findings}


def levels_of(step: Step, **given: object) -> dict[str, Level]:
    return {name: finding.level for name, finding in findings_of(step, **given).items()}  # type: ignore[arg-type]


def test_good_flight_with_every_parameter_right_is_good() -> None:
    levels = levels_of(good_step())
    assert set(levels.values()) == {"good"}
    assert {
        "rate",
        "latency",
        "blur",
        "exposure",
        "light",
        "intrinsics",
        "landmarks",
        "state",
        "attitude",
        "round trip",
        "serial port",
        "mount",
    } < set(levels)
    assert set(PARAMETERS) < set(levels)


@pytest.mark.parametrize(
    ("name", "level", "given"),
    [
        ("rate", "warning", {"rate_hz": 8.0}),
        ("rate", "good", {"rate_hz": 14.9}),
        ("rate", "bad", {"rate_hz": 3.0}),
        ("rate", "warning", {"rate_hz": 3.0, "link": None}),
        ("latency", "warning", {"age_s": 0.15}),
        ("latency", "bad", {"age_s": 0.3}),
        ("latency", "warning", {"age_s": 0.3, "most_age_s": 0.5}),
        ("latency", "bad", {"age_s": 0.04, "most_age_s": 0.03}),
        ("rate_hz", "bad", {"link": replace(HEARD, settings=FlightSettings(rate_hz=2.0))}),
        ("rate_hz", "warning", {"link": replace(HEARD, settings=FlightSettings(rate_hz=10.0))}),
        ("exposure", "warning", {"color": np.zeros((60, 80, 3), np.uint8)}),
        ("exposure", "warning", {"color": np.full((60, 80, 3), 255, np.uint8)}),
        ("blur", "warning", {"color": np.zeros((60, 80, 3), np.uint8)}),
        ("light", "warning", {"color": SHARP // 8}),
        ("light", "good", {"color": SHARP // 2}),
        ("light", "warning", {"build": built(brightness=(35.0, 15.0))}),
        (
            "light",
            "good",
            {"build": built(brightness=(35.0, 50.0))},
        ),  # a build that saw darker and brighter places
        ("gravity", "bad", {"tells_gravity": False}),
        ("gravity", "warning", {"tells_gravity": False, "link": None}),
        ("scale", "bad", {"build": built(scale_sd=0.3)}),
        ("scale", "warning", {"build": built(scale_sd=0.3), "link": None}),
        ("landmarks", "warning", {"step": good_step(3)}),
        ("intrinsics", "warning", {"step": good_step(3)}),
        ("intrinsics", "warning", {"speed_m_s": 0.01}),  # one view tells no focal length
        ("intrinsics", "warning", {"step": good_step(log_focal_sd=0.1)}),  # nor do many flat ones
        ("intrinsics", "bad", {"step": replace(good_step(), reasons=frozenset({Reason.CAMERA_MISMATCH}))}),
        ("intrinsics", "warning", {"step": replace(good_step(), reasons=frozenset({Reason.CAMERA_UNCONFIRMED}))}),
        ("orientation", "bad", {"step": replace(good_step(), reasons=frozenset({Reason.CAMERA_TURNED}))}),
        ("state", "bad", {"step": replace(good_step(), state="lost", reasons=frozenset({Reason.SEARCHING}))}),
        ("autopilot", "bad", {"link": replace(HEARD, is_alive=False)}),
        ("attitude", "warning", {"link": replace(HEARD, attitude_hz=0.0)}),
        ("attitude", "warning", {"link": replace(HEARD, attitude_hz=4.0)}),
        ("attitude", "good", {"link": replace(HEARD, attitude_hz=9.9)}),
        ("state", "good", {"step": replace(good_step(), state="map-changed", reasons={Reason.MAP_CHANGED})}),
        ("round trip", "warning", {"link": replace(HEARD, round_trip_s=0.2)}),
        ("round trip", "warning", {"link": replace(HEARD, round_trip_s=None)}),
        ("autopilot", "bad", {"link": replace(HEARD, heard=Firmware.ARDUPILOT)}),
        ("autopilot", "good", {"link": replace(HEARD, heard=None)}),
        ("serial port", "bad", {"link": replace(HEARD, bytes_a_second=5760.0)}),
        (
            "serial port",
            "good",
            {"link": replace(HEARD, bytes_a_second=5760.0, settings=FlightSettings(rate_hz=10.0, obstacles=False))},
        ),
        ("mount", "bad", {"link": replace(HEARD, mount=replace(FITS, tilt_deg=28.0))}),
        ("mount", "warning", {"link": replace(HEARD, mount=replace(FITS, tilt_deg=4.0))}),
        ("heading", "warning", {"link": replace(HEARD, mount=replace(FITS, yaw_deg=-120.0))}),
        ("EKF2_EV_CTRL", "bad", {"link": replace(HEARD, parameters={**PARAMETERS, "EKF2_EV_CTRL": np.nan})}),
        ("EKF2_EV_DELAY", "good", {"link": replace(HEARD, parameters={**PARAMETERS, "EKF2_EV_DELAY": 15.0})}),
        ("EKF2_EV_DELAY", "warning", {"link": replace(HEARD, parameters={**PARAMETERS, "EKF2_EV_DELAY": 45.0})}),
        ("EKF2_HGT_REF", "bad", {"link": replace(HEARD, parameters={**PARAMETERS, "EKF2_HGT_REF": 1.0})}),
        ("parameters", "warning", {"link": replace(HEARD, parameters={})}),
    ],
)
def test_what_is_wrong_is_named(name: str, level: Level, given: dict[str, object]) -> None:
    assert levels_of(**{"step": good_step(), **given})[name] == level  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("reason", "name", "words"),
    [
        ("without start", "start", "no marker in 40 images"),
        ("old", "camera", "40 images, too old"),
        ("future", "camera", "40 images stamped ahead of the clock"),
        ("skipped", "camera", "no frame"),
    ],
)
def test_why_no_frame_was_localised_is_named(reason: str, name: str, words: str) -> None:
    summary = FlightSummary()
    summary.dropped[reason] += 40
    summary.dropped["old"] += reason == "without start"
    finding = Preflight(BUILD, True, 0.0, True, 0.0, 0.2, FASTER).findings(summary, None)[0]
    assert (finding.name, finding.level, finding.value) == (name, "bad", words)


def test_parameters_of_another_firmware_are_not_asked_for() -> None:
    assert not set(PARAMETERS) & set(levels_of(good_step(), link=replace(HEARD, heard=Firmware.ARDUPILOT)))


@pytest.mark.parametrize(
    ("down_world", "end"),
    [
        ((0.0, 0.6, -0.8), "[0.000, 0.600, -0.800] if the build's camera looked level on average"),
        ((0.0, 0.0, 0.0), "write down = [x, y, z] into flight.toml"),  # of images on their side
    ],
)
def test_proposed_gravity_says_when_it_holds(down_world: tuple[float, float, float], end: str) -> None:
    preflight = Preflight(built(down_world=down_world), False, 0.0, True, 0.0, 0.2, FASTER)
    (gravity,) = (each for each in preflight.findings(FlightSummary(), None) if each.name == "gravity")
    assert gravity.remark.endswith(end)


def test_light_of_a_build_that_does_not_tell_it_is_not_compared() -> None:
    assert "light" not in levels_of(good_step(), build=built(brightness=None))


def test_scale_that_a_sensor_or_a_marker_measured_needs_no_word() -> None:
    for scale_sd in (None, 0.02):
        assert "scale" not in levels_of(good_step(), build=built(scale_sd=scale_sd))


@pytest.mark.parametrize(
    ("late", "firmware", "fix"),
    [
        (0, None, "the source gives no more"),
        (0, Firmware.PX4, "the source gives no more; PX4 asks for 30"),
        (0, Firmware.ARDUPILOT, "the source gives no more; ArduPilot asks for 4 or more"),
        (9, None, FASTER),
    ],
)
def test_slow_source_and_slow_computer_are_told_apart(late: int, firmware: Firmware | None, fix: str) -> None:
    link = None if firmware is None else replace(HEARD, firmware=firmware)
    rate = findings_of(good_step(), rate_hz=8.0, late=late, link=link)["rate"]
    assert (rate.level, rate.value, rate.remark) == ("warning", f"8.0 Hz, {late} frames dropped", fix)


def test_a_low_rate_of_poses_is_answered_with_the_rate_that_is_good() -> None:
    link = replace(HEARD, firmware=Firmware.ARDUPILOT, settings=FlightSettings(rate_hz=5.0))
    assert findings_of(good_step(), link=link)["rate_hz"].remark == "raise it to 15 or more in flight.toml"


def test_latency_is_answered_with_what_shortens_it_and_with_its_limit_only_beyond_it() -> None:
    faster = f"where the computer is slow, {FASTER}"
    assert findings_of(good_step(), age_s=0.15)["latency"].remark == faster
    remark = findings_of(good_step(), age_s=0.3)["latency"].remark
    assert remark == f"{faster}; poses older than most_age_s, 0.2 s, are not sent"


def test_parameters_without_an_answer_share_one_line() -> None:
    answered = {"EKF2_HGT_REF": 3.0, "EKF2_EV_POS_X": 0.0}
    findings = findings_of(good_step(), link=replace(HEARD, parameters=answered))
    assert set(PARAMETERS) & set(findings) == set(answered)
    parameters = findings["parameters"]
    assert parameters.value == f"{len(PARAMETERS) - 2} of {len(PARAMETERS)} not answered"
    assert "by hand: EKF2_EV_CTRL = 11, EKF2_EV_POS_Y = 0, " in parameters.remark


def test_noise_in_place_of_an_autopilot_is_said_to_be_the_baud_rates() -> None:
    silent, noisy = (replace(HEARD, is_alive=False, hears_noise=noise) for noise in (False, True))
    assert findings_of(good_step(), link=silent)["autopilot"].value == "no heartbeat"
    found = findings_of(good_step(), link=noisy)["autopilot"]
    assert found.value == "no heartbeat, but bytes that are no MAVLink" and "baud rate" in found.remark


@pytest.mark.parametrize(("link", "level"), [(None, "warning"), (HEARD, "bad")])
def test_camera_that_went_away_is_named_whatever_its_rate_was(link: LinkReport | None, level: Level) -> None:
    preflight, summary = Preflight(BUILD, True, 0.0, True, 0.0, 0.2, FASTER), FlightSummary()
    preflight.idle(0.0)  # before the first image
    for index in range(60):
        result = result_at(50.0 + index / 30.0, good_step())
        result = replace(result, frame=replace(result.frame, color=SHARP), elapsed_s=1.0 / 30.0)
        summary.add(result)
        preflight.take(result)
        preflight.idle(result.done_s + 0.1)
    assert "pauses" not in {finding.name for finding in preflight.findings(summary, link)}
    preflight.idle(result.done_s + 6.0)
    (pauses,) = (finding for finding in preflight.findings(summary, link) if finding.name == "pauses")
    assert (pauses.level, pauses.value) == (level, "6.0 s without an image in time")


def test_stated_roll_of_a_turned_camera_is_to_be_corrected() -> None:
    step = replace(good_step(), reasons=frozenset({Reason.CAMERA_TURNED}))
    for roll_deg, verb in ((0.0, "state"), (180.0, "correct")):
        assert findings_of(step, roll_deg=roll_deg)["orientation"].remark.startswith(f"{verb} roll_deg in [mount]; ")


def test_what_stands_still_in_the_image_is_named_with_its_share() -> None:
    found = findings_of(replace(good_step(), standing=np.arange(100).reshape(10, 10) < 14))["view"]
    assert (found.level, found.value[:12]) == ("warning", "14% of the i")
    assert "view" not in findings_of(good_step())


def test_map_without_landmarks_is_told_from_a_view_without_them() -> None:
    for has_landmarks, remark in ((True, "look at a part of the room"), (False, "the map has none; build with")):
        landmarks = findings_of(good_step(landmarks=0), has_landmarks=has_landmarks)["landmarks"]
        assert landmarks.level == "warning" and landmarks.remark.startswith(remark)


def test_set_of_bits_may_have_more() -> None:
    more = {**PARAMETERS, "EKF2_EV_CTRL": 15.0}
    assert levels_of(good_step(), link=replace(HEARD, parameters=more))["EKF2_EV_CTRL"] == "good"
    fewer = {**PARAMETERS, "EKF2_EV_CTRL": 3.0}
    assert levels_of(good_step(), link=replace(HEARD, parameters=fewer))["EKF2_EV_CTRL"] == "bad"


def test_no_frame_is_bad() -> None:
    findings = Preflight(BUILD, True, 0.0, True, 0.0, 0.2, FASTER).findings(FlightSummary(states=Counter()), None)
    assert worst(findings) == "bad" and [finding.name for finding in findings] == ["camera", "gravity"]
