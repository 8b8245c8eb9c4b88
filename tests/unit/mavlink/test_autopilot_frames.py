"""Hand-held motions, by name, through what both firmwares make of them; and covariances by sampling."""

from __future__ import annotations

import numpy as np
import pytest

from mavlink_helpers import over_the_wire
from monoloc.errors import SettingError
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, so3_exp
from monoloc.mavlink.autopilot_frames import AutopilotFrames, euler_of, north_from_heading
from monoloc.mavlink.firmware import Firmware
from monoloc.mavlink.messages import odometry
from monoloc.particle_filter.estimate import Estimate
from monoloc_lab.soak.ardupilot_decoder import ArduPilot
from monoloc_lab.soak.px4_decoder import Px4

DOWN = np.array([0.0, 0.0, -1.0])  # the map's z points up
FORWARD = Mount(forward_m=0.1, right_m=-0.05, down_m=0.02)
DOWNWARD = Mount(forward_m=0.0, pitch_deg=-90.0)
TILTED = Mount(forward_m=0.2, yaw_deg=30.0, pitch_deg=-20.0, roll_deg=10.0)
STEP_M, TURN_RAD = 0.4, 0.3

# Motion of the body, as a person who holds it says it: the change of position (forward, right, down) and the rotation
# vector about forward, right and down.
MOTIONS = {
    "forward": ((STEP_M, 0, 0), (0, 0, 0)),
    "right": ((0, STEP_M, 0), (0, 0, 0)),
    "up": ((0, 0, -STEP_M), (0, 0, 0)),
    "yaw right": ((0, 0, 0), (0, 0, TURN_RAD)),
    "pitch up": ((0, 0, 0), (0, TURN_RAD, 0)),
    "roll right": ((0, 0, 0), (TURN_RAD, 0, 0)),
}


def camera_pose(mount: Mount, north_deg: float, T_ned_body: FloatArray) -> FloatArray:
    """``T_world_camera`` in a map whose z points up and whose x axis heads ``north_deg`` from north."""
    # Of the map's axes in NED: x heads north_deg, z is up, y completes a right-handed frame.
    angle = np.deg2rad(north_deg)
    x = [np.cos(angle), np.sin(angle), 0.0]
    z = [0.0, 0.0, -1.0]
    R_ned_world = np.stack([x, np.cross(z, x), z], axis=1)
    return invert(make_pose(R_ned_world, np.zeros(3))) @ T_ned_body @ mount.T_body_camera


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("north_deg", [0.0, 37.0, -160.0])
@pytest.mark.parametrize("mount", [FORWARD, DOWNWARD, TILTED], ids=["forward", "downward", "tilted"])
def test_hand_held_motion_comes_out_on_its_axis(name: str, north_deg: float, mount: Mount) -> None:
    """The vehicle heads 20 degrees east of north; both firmwares take the same position and attitude."""
    heading = np.deg2rad(20.0)
    shift, turn = (np.array(part, dtype=np.float64) for part in MOTIONS[name])
    T_ned_before = make_pose(so3_exp([0, 0, heading]), [1.0, 2.0, -1.5])
    T_ned_after = T_ned_before @ make_pose(so3_exp(turn), shift)
    frames = AutopilotFrames(mount.T_body_camera, DOWN, np.deg2rad(north_deg))
    estimate = Estimate(camera_pose(mount, north_deg, T_ned_after), np.eye(6) * 1e-4, 0.0)
    pose = frames.body_pose(estimate)

    px4 = Px4().odometry(over_the_wire(odometry(5.0, pose, 90, 3, Firmware.PX4)))
    ardupilot = ArduPilot().odometry(over_the_wire(odometry(5.0, pose, 90, 3, Firmware.ARDUPILOT)))
    for position in (px4.position, ardupilot.position):
        moved = so3_exp([0, 0, -heading]) @ (position - [1.0, 2.0, -1.5])
        np.testing.assert_allclose(moved, shift, atol=1e-5)
    np.testing.assert_allclose(ardupilot.euler, turn + np.array([0, 0, heading]), atol=1e-5)
    np.testing.assert_allclose(px4.R_ned_body, T_ned_after[:3, :3], atol=1e-5)
    assert (px4.reset_counter, px4.quality, px4.time_us) == (ardupilot.reset_counter, 90, 5_000_000)


def test_covariance_is_that_of_sampled_poses() -> None:
    """With a lever arm, a tilted camera and a banked vehicle."""
    rng = np.random.default_rng(0)
    T_ned_body = make_pose(so3_exp([0, 0, 1.0]) @ so3_exp([0, 0.4, 0]) @ so3_exp([0.5, 0, 0]), [1.0, 2.0, 3.0])
    root = 0.01 * rng.standard_normal((6, 6))
    covariance = root @ root.T
    frames = AutopilotFrames(TILTED.T_body_camera, DOWN, 0.6)
    truth = camera_pose(TILTED, np.rad2deg(0.6), T_ned_body)
    stated = frames.body_pose(Estimate(truth, covariance, 0.0))
    sampled = []
    for twist in rng.multivariate_normal(np.zeros(6), covariance, 6_000):
        pose = frames.T_ned_world @ truth @ se3_exp(twist) @ invert(TILTED.T_body_camera)
        sampled.append([*pose[:3, 3], *euler_of(pose[:3, :3])])
    expected = np.cov(np.array(sampled).T)
    sds = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(stated.covariance / np.outer(sds, sds), expected / np.outer(sds, sds), atol=0.06)
    np.testing.assert_allclose(stated.T_ned_body, T_ned_body, atol=1e-9)


@pytest.mark.parametrize("mount", [FORWARD, DOWNWARD, TILTED])
def test_gravity_of_an_attitude_is_that_of_the_pose(mount: Mount) -> None:
    attitude = so3_exp([0, 0, 2.0]) @ so3_exp([0, 0.3, 0]) @ so3_exp([-0.2, 0, 0])
    pose = camera_pose(mount, 37.0, make_pose(attitude, np.zeros(3)))
    frames = AutopilotFrames(mount.T_body_camera, DOWN, 0.0)
    np.testing.assert_allclose(frames.down_camera(-0.2, 0.3), pose[:3, :3].T @ DOWN, atol=1e-9)


def test_north_is_what_makes_the_heading_right() -> None:
    T_ned_body = make_pose(so3_exp([0, 0, 1.2]) @ so3_exp([0, 0.1, 0]), np.zeros(3))
    pose = camera_pose(TILTED, -140.0, T_ned_body)
    north_rad = north_from_heading(pose, TILTED.T_body_camera, DOWN, 1.2)
    assert np.rad2deg(north_rad) == pytest.approx(-140.0)
    frames = AutopilotFrames(TILTED.T_body_camera, DOWN, north_rad)
    assert frames.body_pose(Estimate(pose, np.eye(6), 0.0)).euler_rad[2] == pytest.approx(1.2)


def test_pose_straight_up_and_one_that_is_no_number_are_told_apart() -> None:
    frames = AutopilotFrames(np.eye(4), DOWN, 0.0)
    up = invert(frames.T_ned_world) @ make_pose(so3_exp([0, np.pi / 2, 0]), np.zeros(3))
    assert frames.body_pose(Estimate(up, np.eye(6) * 1e-4, 0.0)).is_finite
    assert not frames.body_pose(Estimate(up, np.full((6, 6), np.nan), 0.0)).is_finite


@pytest.mark.parametrize(
    ("T_body_camera", "down", "north", "match"),
    [
        (np.zeros((4, 4)), DOWN, 0.0, "no rigid pose"),
        (np.eye(4), DOWN, np.nan, "north"),
        (np.eye(4), np.zeros(3), 0.0, "direction of gravity"),
        (np.eye(4), [1.0, 0.0, 0.0], 0.0, "no heading"),
    ],
)
def test_frames_that_say_nothing_are_refused(
    T_body_camera: FloatArray, down: FloatArray, north: float, match: str
) -> None:
    with pytest.raises(SettingError, match=match):
        AutopilotFrames(T_body_camera, down, north)
