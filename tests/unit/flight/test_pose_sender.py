"""What reaches an autopilot, and what must not."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mavlink_helpers import Wire, result_at, step_at
from monoloc.flight.flight_loop import MOST_AHEAD_S
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.in_place import InPlace
from monoloc.flight.pose_sender import PoseSender
from monoloc.geometry import FloatArray, invert, make_pose, so3_exp
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.mavlink.firmware import Firmware
from monoloc.obstacles import DepthError, ObstacleWatch
from monoloc.supervision.state import Reason
from monoloc_lab.soak.ardupilot_decoder import ArduPilot
from monoloc_lab.soak.px4_decoder import Px4

FRAMES = AutopilotFrames(FlightSettings().mount.T_body_camera, [0.0, 0.0, -1.0], 0.0)
ERROR = DepthError(0.05, 0.0, True)
# A camera that looks along the map's x axis.
R_WORLD_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def at(x_m: float) -> FloatArray:
    return make_pose(R_WORLD_CAMERA, [x_m, 0.0, 1.0])


def sender(
    firmware: Firmware = Firmware.PX4,
    poses: Counter[str] | None = None,
    waits_for_marker: bool = False,
    **settings: object,
) -> tuple[PoseSender, Wire]:
    wire, flown = Wire(), FlightSettings.model_validate(settings)
    watch = ObstacleWatch(ERROR, None) if flown.obstacles else None
    counted = Counter[str]() if poses is None else poses
    return PoseSender(wire, FRAMES, firmware, flown, watch, counted, waits_for_marker), wire


def resets(wire: Wire) -> list[int]:
    """Number of resets before each pose, since the first."""
    counters = [message.reset_counter for message in wire.of("ODOMETRY")]
    return [(counter - counters[0]) % 256 for counter in counters]


def test_pose_has_the_time_of_capture_and_all_that_the_firmware_needs() -> None:
    for firmware, frame in ((Firmware.PX4, 1), (Firmware.ARDUPILOT, 20)):
        flight, wire = sender(firmware)
        flight.take(result_at(12.5, step_at(at(0.3), probability_far=0.2)))
        (message,) = wire.of("ODOMETRY")
        assert (message.time_usec, message.frame_id, message.child_frame_id) == (12_500_000, frame, 12)
        assert (message.estimator_type, message.quality, message.reset_counter) == (2, 80, 12_500_000 % 256)
        assert np.all(np.isnan([message.vx, message.vy, message.vz])) and np.all(np.isfinite(message.pose_covariance))
        assert message.x == pytest.approx(0.3) and message.z == pytest.approx(-1.0)


def test_nothing_is_sent_while_lost_and_the_jump_after_it_is_said() -> None:
    flight, wire = sender()
    flight.take(result_at(1.0, step_at(at(0.0))))
    for index in range(5):
        lost = step_at(at(0.0), "lost", frozenset({Reason.SEARCHING}), probability_far=1.0)
        flight.take(result_at(1.1 + 0.05 * index, lost))
    assert len(wire.of("ODOMETRY")) == 1 and len(wire.of("OBSTACLE_DISTANCE")) == 1
    flight.take(result_at(1.5, step_at(at(0.0))))
    flight.take(result_at(1.6, step_at(at(0.01))))
    assert resets(wire) == [0, 1, 1]


def test_jump_and_restart_are_said_and_a_fast_vehicle_is_none() -> None:
    flight, wire = sender()
    places = [(0.0, False), (0.2, False), (1.5, False), (1.5, True), (1.5, False)]
    for index, (x_m, restarted) in enumerate(places):
        flight.take(result_at(1.0 + 0.1 * index, step_at(at(x_m), restarted=restarted)))
    assert resets(wire) == [0, 0, 1, 2, 2]


def test_turn_in_place_that_no_vehicle_makes_is_a_jump() -> None:
    flight, wire = sender()
    for index, turn_rad in enumerate((0.0, 0.3, 1.2, 1.2)):
        flight.take(
            result_at(1.0 + 0.1 * index, step_at(make_pose(so3_exp([0.0, 0.0, turn_rad]), np.zeros(3)) @ at(0.0)))
        )
    assert resets(wire) == [0, 0, 1, 1]


@pytest.mark.parametrize("reason", [Reason.IMAGE_REPEATED, Reason.IMAGE_EMPTY])
def test_nothing_is_sent_of_an_image_that_says_nothing(reason: Reason) -> None:
    flight, wire = sender()
    flight.take(result_at(0.5, step_at(at(0.0))))
    flight.take(result_at(1.0, step_at(at(0.0), "uncertain", frozenset({reason}), 0.1)))
    flight.take(result_at(2.5, step_at(at(0.0), "uncertain", frozenset({Reason.NO_ODOMETRY}), 0.1)))
    assert len(wire.of("ODOMETRY")) == len(wire.of("OBSTACLE_DISTANCE")) == 2


def test_reset_counter_goes_on_from_zero_after_255() -> None:
    flight, wire = sender(obstacles=False)
    for index in range(258):
        flight.take(result_at(0.1 * index, step_at(at(0.0), restarted=True)))
    counters = [message.reset_counter for message in wire.of("ODOMETRY")]
    assert counters[0] == 0 and counters[255:] == [255, 0, 1]


def test_nothing_is_sent_of_a_start_that_nothing_has_confirmed() -> None:
    """After a restart in flight, the stated start is the place of the take-off."""
    poses = Counter[str]()
    flight, wire = sender(poses=poses)
    for index in range(5):
        flight.take(result_at(0.1 * index, step_at(at(0.0), "uncertain", frozenset({Reason.BELIEF_DOUBTFUL}), 0.1)))
    assert wire.of("ODOMETRY") == wire.of("OBSTACLE_DISTANCE") == [] and poses == {"unconfirmed": 5}
    flight.take(result_at(1.0, step_at(at(2.0))))
    flight.take(result_at(1.1, step_at(at(2.0), "uncertain", frozenset({Reason.BELIEF_DOUBTFUL}), 0.1)))
    assert len(wire.of("ODOMETRY")) == 2


def test_two_programs_that_start_with_the_computer_begin_at_different_counts() -> None:
    counts = set()
    for captured_s in (24.2001, 24.2377, 24.9005):
        flight, wire = sender()
        flight.take(result_at(captured_s, step_at(at(0.0))))
        counts.add(wire.of("ODOMETRY")[0].reset_counter)
    assert len(counts) == 3


def test_stale_future_and_infinite_poses_are_not_sent_but_counted() -> None:
    poses = Counter[str]()
    flight, wire = sender(poses=poses, most_age_s=0.2)
    flight.take(result_at(1.0, step_at(at(0.0)), age_s=0.3))
    flight.take(result_at(1.1, step_at(at(0.0)), age_s=-0.1))
    flight.take(result_at(1.2, step_at(at(0.0), covariance=np.full((6, 6), np.nan))))
    assert wire.of("ODOMETRY") == [] and wire.of("OBSTACLE_DISTANCE") == []
    assert poses == {"old": 1, "future": 1, "not finite": 1}
    flight.take(result_at(1.3, step_at(at(0.0))))
    assert len(wire.of("ODOMETRY")) == poses["sent"] == 1


def test_pilot_hears_that_poses_come_too_late() -> None:
    """The state is *tracking*, and the autopilot gets nothing."""
    flight, wire = sender(most_age_s=0.2)
    ages_s = {**dict.fromkeys(range(2, 30), 0.3), 12: 0.1}  # a single pose in time changes nothing for long
    for index in range(60):
        flight.take(result_at(0.1 * index, step_at(at(0.0)), age_s=ages_s.get(index, 0.05)))
    said = [(message.severity, message.text) for message in wire.of("STATUSTEXT")]
    assert said[0] == (5, "monoloc: tracking") and said[1] == (4, "monoloc: tracking: poses come too late")
    assert said[-1] == said[0] and len(said) <= 5


def test_a_stamp_that_the_flight_takes_though_it_is_ahead_is_sent() -> None:
    """Of a camera whose stamps are a little off, on a computer whose step takes less than that."""
    flight, wire = sender()
    flight.take(result_at(1.0, step_at(at(0.0)), age_s=-0.5 * MOST_AHEAD_S))
    assert len(wire.of("ODOMETRY")) == 1


def test_rate_is_bounded() -> None:
    poses = Counter[str]()
    flight, wire = sender(rate_hz=10.0, poses=poses)
    for index in range(60):
        flight.take(result_at(index / 30.0, step_at(at(0.0))))
    assert poses == {"sent": 20, "beyond rate_hz": 40}
    assert len(wire.of("ODOMETRY")) == 20 and 18 <= len(wire.of("OBSTACLE_DISTANCE")) <= 20


def test_small_variances_are_under_the_firmwares_floor_and_large_ones_pass() -> None:
    flight, wire = sender()
    flight.take(result_at(1.0, step_at(at(0.0), covariance=np.eye(6) * 1e-6)))
    flight.take(result_at(1.1, step_at(at(0.0), covariance=np.diag([0.25, 0.25, 0.25, 0.09, 0.09, 0.09]))))
    sure, vague = (Px4().odometry(message) for message in wire.of("ODOMETRY"))
    np.testing.assert_allclose(sure.position_variance, 0.1**2)
    np.testing.assert_allclose(vague.position_variance, 0.25, rtol=1e-5)
    assert vague.yaw_variance == pytest.approx(0.09)


def test_pilot_hears_every_state_once_within_fifty_bytes() -> None:
    flight, wire = sender()
    reasons = frozenset({Reason.NO_ODOMETRY, Reason.IMAGE_EMPTY, Reason.BELIEF_DOUBTFUL})
    for index in range(40):
        flight.take(result_at(0.1 * index, step_at(at(0.0))))
    for index in range(40):
        flight.take(result_at(4.0 + 0.1 * index, step_at(at(0.0), "uncertain", reasons, 0.1)))
    assert [(m.severity, m.text) for m in wire.of("STATUSTEXT")] == [
        (5, "monoloc: tracking"),
        (4, "monoloc: uncertain: image empty, no odometry"),
    ]


def test_flickering_state_does_not_fill_the_screen_and_the_last_is_said() -> None:
    flight, wire = sender()
    for index in range(100):
        state = "tracking" if index % 2 and index < 95 else "uncertain"
        flight.take(result_at(0.05 * index, step_at(at(0.0), state)))
    assert len(wire.of("STATUSTEXT")) <= 6
    for index in range(30):
        flight.take(result_at(5.0 + 0.05 * index, step_at(at(0.0), "uncertain")))
    assert wire.of("STATUSTEXT")[-1].text == "monoloc: uncertain"


def test_pilot_hears_that_the_camera_gives_no_image() -> None:
    flight, wire = sender()
    flight.idle(0.0)
    assert wire.received == []
    flight.take(result_at(1.0, step_at(at(0.0))))
    for index in range(30):
        flight.idle(1.1 + 0.1 * index)
    texts = [message.text for message in wire.of("STATUSTEXT")]
    assert texts == ["monoloc: tracking", "monoloc: no image in time from the camera"]


@pytest.mark.parametrize(
    ("waits_for_marker", "text"),
    [(False, "no image in time from the camera"), (True, "waits for a first image, or a marker")],
)
def test_pilot_hears_that_a_first_image_is_missing(waits_for_marker: bool, text: str) -> None:
    """As after a restart in flight, with a camera that can be opened and hangs."""
    flight, wire = sender(waits_for_marker=waits_for_marker)
    for index in range(30):
        flight.idle(100.0 + 0.1 * index)
    assert wire.received == []  # a camera takes a while to begin
    flight.idle(103.1)
    flight.take(result_at(105.0, step_at(at(0.0))))
    texts = [message.text for message in wire.of("STATUSTEXT")]
    assert texts == [f"monoloc: {text}", "monoloc: tracking"]


def test_pilot_hears_that_a_room_cannot_be_entered() -> None:
    flight, wire = sender()
    step = step_at(at(0.0))
    in_place = InPlace("kitchen", None, step.estimate, False, {"hall": "it is gone"})
    flight.take(replace(result_at(1.0, step), in_place=in_place))
    (message,) = wire.of("STATUSTEXT")
    assert (message.text, message.severity) == ("monoloc: tracking in kitchen: cannot enter hall", 4)


@pytest.mark.parametrize(
    ("mount", "yaw_deg", "log_scale", "expected_m"),
    [
        ({}, 0.0, 0.0, 2.0),
        ({}, 0.0, float(np.log(1.5)), 3.0),  # the belief knows that the depth is too small
        ({"forward_m": 0.4}, 0.0, 0.0, 2.4),  # a camera at the nose
        ({"forward_m": -0.4}, 130.0, 0.0, 1.6),
        ({"forward_m": 0.4, "pitch_deg": -10.0}, 40.0, float(np.log(0.5)), 1.4 / np.cos(np.deg2rad(10.0))),
    ],
)
def test_obstacles_are_as_far_from_the_vehicle_as_the_belief_says(
    mount: dict[str, float], yaw_deg: float, log_scale: float, expected_m: float
) -> None:
    settings = FlightSettings.model_validate({"mount": mount})
    T_body_camera = settings.mount.T_body_camera
    frames = AutopilotFrames(T_body_camera, [0.0, 0.0, -1.0], 0.0)
    wire = Wire()
    T_ned_body = make_pose(so3_exp([0.0, 0.0, np.deg2rad(yaw_deg)]), [0.3, -0.8, 1.0])
    pose = invert(frames.T_ned_world) @ T_ned_body @ T_body_camera
    step = step_at(pose, depth_m=2.0)
    step = replace(step, estimate=replace(step.estimate, log_scale=log_scale))
    PoseSender(wire, frames, Firmware.ARDUPILOT, settings, ObstacleWatch(ERROR, None), Counter(), False).take(
        result_at(1.0, step)
    )
    (message,) = wire.of("OBSTACLE_DISTANCE")
    assert ArduPilot.obstacles(message)[0.0] == pytest.approx(expected_m, rel=0.03)


def test_old_firmware_gets_euler_angles() -> None:
    flight, wire = sender(message="vision_position_estimate")
    flight.take(result_at(1.0, step_at(at(0.3))))
    (message,) = wire.of("VISION_POSITION_ESTIMATE")
    assert wire.of("ODOMETRY") == [] and message.usec == 1_000_000
    assert (message.x, message.z) == (pytest.approx(0.3), pytest.approx(-1.0))
    assert (message.roll, message.pitch, message.yaw) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_a_frame_without_depth_says_nothing_of_obstacles() -> None:
    flight, wire = sender()
    for index in range(4):
        step = step_at(at(0.0))
        flight.take(result_at(1.0 + index, step if index % 2 else replace(step, depth=None)))
    assert len(wire.of("ODOMETRY")) == 4 and len(wire.of("OBSTACLE_DISTANCE")) == 2


@pytest.mark.parametrize("jump", ["restarted", "lost", "moved"])
def test_obstacles_are_remembered_but_not_over_a_jump(jump: str) -> None:
    """Nor where the pose moves farther than a vehicle can: what was 1 m ahead is not 2.5 m ahead by that."""
    flight, wire = sender()
    flight.take(result_at(1.0, step_at(at(0.0), depth_m=1.0)))
    flight.take(result_at(1.1, step_at(at(0.0), depth_m=4.0)))
    if jump == "lost":
        flight.take(result_at(1.2, step_at(at(0.0), "lost", frozenset({Reason.SEARCHING}))))
    there = at(-1.5 if jump == "moved" else 0.0)
    flight.take(result_at(1.3, step_at(there, depth_m=4.0, restarted=jump == "restarted")))
    sent = [ArduPilot.obstacles(message)[0.0] for message in wire.of("OBSTACLE_DISTANCE")]
    assert sent == [pytest.approx(1.0, rel=0.03), pytest.approx(1.0, abs=0.06), pytest.approx(4.0, rel=0.03)]
