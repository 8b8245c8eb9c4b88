"""Ways in which live pipelines fail in public reports, provoked at the sender, and judged by both firmwares' rules.

docs/how-to/mavlink.md lists all ten, and the tests of the others.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from mavlink_helpers import Wire, result_at, step_at
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.pose_sender import PoseSender
from monoloc.geometry import FloatArray, invert, make_pose, so3_exp
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.mavlink.firmware import Firmware
from monoloc.supervision.state import Reason, State
from monoloc_lab.soak import ardupilot_decoder, px4_decoder

MOUNT = FlightSettings().mount.T_body_camera
FRAMES = AutopilotFrames(MOUNT, [0.0, 0.0, -1.0], np.deg2rad(25.0))


def heading(yaw_deg: float) -> FloatArray:
    """``T_world_camera`` of a vehicle that heads so far east of north."""
    T_ned_body = make_pose(so3_exp([0.0, 0.0, np.deg2rad(yaw_deg)]), [0.2, 0.1, -1.0])
    return invert(FRAMES.T_ned_world) @ T_ned_body @ MOUNT


def sender(firmware: Firmware) -> tuple[PoseSender, Wire]:
    wire = Wire()
    return PoseSender(wire, FRAMES, firmware, FlightSettings(), None, Counter(), False), wire


def test_a_message_for_one_firmware_would_vanish_in_the_other_so_the_firmware_is_asked_for() -> None:
    (px4, to_px4), (ardupilot, to_ardupilot) = sender(Firmware.PX4), sender(Firmware.ARDUPILOT)
    for flight in (px4, ardupilot):
        flight.take(result_at(1.0, step_at(heading(0.0))))
    (for_px4,), (for_ardupilot,) = to_px4.of("ODOMETRY"), to_ardupilot.of("ODOMETRY")
    with pytest.raises(ardupilot_decoder.Refused, match="frames 1 and 12"):
        ardupilot_decoder.ArduPilot().odometry(for_px4)
    assert ardupilot_decoder.ArduPilot(minimum_quality=1).odometry(for_ardupilot).quality == 99
    # PX4 takes both, but aligns its heading with LOCAL_NED alone.
    assert (for_px4.frame_id, px4_decoder.Px4(minimum_quality=1).odometry(for_px4).quality) == (1, 99)


def test_yaw_after_a_gap_is_the_heading_at_once_and_the_jump_is_said() -> None:
    """Lost for two seconds, in which the vehicle turns by 170 degrees: no yaw comes between the two."""
    for firmware in Firmware:
        flight, wire = sender(firmware)
        for index in range(10):
            flight.take(result_at(0.1 * index, step_at(heading(20.0))))
        for index in range(20):
            lost = step_at(heading(20.0 + 8.5 * index), "lost", frozenset({Reason.SEARCHING}), 1.0)
            flight.take(result_at(1.0 + 0.1 * index, lost))
        for index in range(10):
            flight.take(result_at(3.0 + 0.1 * index, step_at(heading(-170.0))))
        yaws, counters = [], []
        for message in wire.of("ODOMETRY"):
            if firmware is Firmware.PX4:
                sample = px4_decoder.Px4().odometry(message)
                yaws.append(np.rad2deg(np.arctan2(sample.R_ned_body[1, 0], sample.R_ned_body[0, 0])))
                counters.append(sample.reset_counter)
            else:
                read = ardupilot_decoder.ArduPilot().odometry(message)
                yaws.append(np.rad2deg(read.euler[2]))
                counters.append(read.reset_counter)
        np.testing.assert_allclose(yaws, [20.0] * 10 + [-170.0] * 10, atol=1e-3)
        assert counters == [counters[0]] * 10 + [counters[0] + 1] * 10


@pytest.mark.parametrize("state", ["lost", "uncertain", "tracking"])
@pytest.mark.parametrize("probability_far", [0.0, 0.5, 0.999, 1.0])
def test_a_pose_is_never_sent_while_lost_nor_with_a_quality_that_arms_or_is_unknown(
    state: State, probability_far: float
) -> None:
    """A quality of -1 is failed, and 0 unknown: both are fused by a firmware whose minimum is 0."""
    flight, wire = sender(Firmware.ARDUPILOT)
    flight.take(result_at(0.5, step_at(heading(0.0))))
    flight.take(result_at(1.0, step_at(heading(0.0), state, frozenset(), probability_far)))
    qualities = [message.quality for message in wire.of("ODOMETRY")[1:]]
    expected = [] if state == "lost" else [max(1, round(100.0 * (1.0 - probability_far)))]
    assert qualities == expected


def test_the_pilot_hears_that_the_position_is_lost_and_why() -> None:
    flight, wire = sender(Firmware.PX4)
    flight.take(result_at(1.0, step_at(heading(0.0))))
    flight.take(result_at(3.0, step_at(heading(0.0), "lost", frozenset({Reason.SEARCHING}), 1.0)))
    assert [(m.severity, m.text) for m in wire.of("STATUSTEXT")][-1] == (4, "monoloc: lost: searching")
