"""Frames of ROS: axes by motions of a hand-held camera, and a covariance that samples agree with."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from monoloc.flight.flight_settings import Mount
from monoloc.geometry import invert, make_pose, rotation_to_quaternion, se3_exp, so3_exp
from monoloc.particle_filter.estimate import Estimate
from monoloc.ros.ros_frames import RosFrames, down_camera, pose_of

MOUNT = Mount(forward_m=0.3, right_m=-0.1, down_m=0.05, yaw_deg=30.0, pitch_deg=-20.0, roll_deg=10.0)
# A camera that looks along the room's x axis, in rooms whose z is up, whose y is down, and one that is tilted.
LOOKS_ALONG_X = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
TILT = so3_exp([0.3, 0.2, 0.0])
ROOMS = {
    "z up": (np.eye(3), (0.0, 0.0, -1.0)),
    "y down": (np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), (0.0, 2.0, 0.0)),
    "tilted": (TILT, tuple(TILT @ [0.0, 0.0, -1.0])),
}
MOTIONS = {  # in the camera's axes, and what base_link does in those of REP 103
    "forward": ([0, 0, 0.1, 0, 0, 0], [0.1, 0, 0, 0, 0, 0]),
    "right": ([0.1, 0, 0, 0, 0, 0], [0, -0.1, 0, 0, 0, 0]),
    "up": ([0, -0.1, 0, 0, 0, 0], [0, 0, 0.1, 0, 0, 0]),
    "yaw right": ([0, 0, 0, 0, 0.1, 0], [0, 0, 0, 0, 0, -0.1]),
    "pitch up": ([0, 0, 0, 0.1, 0, 0], [0, 0, 0, 0, -0.1, 0]),
    "roll right": ([0, 0, 0, 0, 0, 0.1], [0, 0, 0, 0.1, 0, 0]),
}


def at(pose: np.ndarray, covariance: np.ndarray | None = None) -> Estimate:
    return Estimate(pose, np.zeros((6, 6)) if covariance is None else covariance, 0.0)


@pytest.mark.parametrize("room", ROOMS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_motions_come_out_on_the_axes_of_rep_103(room: str, motion: str) -> None:
    R_room_level, down = ROOMS[room]
    frames = RosFrames(Mount().T_body_camera, down)
    twist, expected = MOTIONS[motion]
    first = make_pose(R_room_level @ LOOKS_ALONG_X, R_room_level @ [1.0, 2.0, 3.0])
    T_map_before, T_map_after = (frames.base_pose(at(pose))[0] for pose in (first, first @ se3_exp(twist)))
    if room != "tilted":  # whose x axis is not level, so that its heading is another
        np.testing.assert_allclose(T_map_before, make_pose(np.eye(3), [1.0, 2.0, 3.0]), atol=1e-12)
    np.testing.assert_allclose(T_map_before[2, :3], [0.0, 0.0, 1.0], atol=1e-12)  # level, and z up
    moved = invert(T_map_before) @ T_map_after
    np.testing.assert_allclose(moved[:3, 3], expected[:3], atol=1e-12)
    np.testing.assert_allclose(moved[:3, :3], so3_exp(expected[3:]), atol=1e-12)


def test_a_room_that_is_nearly_level_or_of_unknown_gravity_is_the_map() -> None:
    for down in (None, (0.05, 0.02, -1.0)):
        np.testing.assert_array_equal(RosFrames(MOUNT.T_body_camera, down).T_map_room, np.eye(4))
    assert not np.allclose(RosFrames(MOUNT.T_body_camera, (0.15, 0.0, -1.0)).T_map_room, np.eye(4), atol=0.01)


def test_the_covariance_is_that_of_samples_about_the_maps_fixed_axes() -> None:
    """True poses are drawn; their errors, as fixed-axis X, Y, Z angles by SciPy, have the stated covariance."""
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6)) * np.array([0.02, 0.02, 0.02, 0.008, 0.008, 0.008])[:, None]
    covariance = root @ root.T
    pose = se3_exp([1.0, -2.0, 0.5, 0.9, -0.4, 2.0])
    frames = RosFrames(MOUNT.T_body_camera, ROOMS["tilted"][1])
    T_map_base, stated = frames.base_pose(at(pose, covariance))
    twists = rng.standard_normal((200_000, 6)) @ root.T
    truth = frames.T_map_room @ (pose @ se3_exp(twists)) @ invert(frames.T_base_camera)
    turns = truth[:, :3, :3] @ T_map_base[:3, :3].T
    errors = np.hstack([truth[:, :3, 3] - T_map_base[:3, 3], Rotation.from_matrix(turns).as_euler("xyz")])
    sampled = errors.T @ errors / len(errors)
    sd = np.sqrt(np.diag(sampled))
    assert np.abs((stated - sampled) / np.outer(sd, sd)).max() < 0.02


def test_a_start_is_the_pose_and_the_size_of_the_error_that_were_published() -> None:
    frames = RosFrames(MOUNT.T_body_camera, ROOMS["y down"][1])
    pose = se3_exp([1.0, -2.0, 0.5, 0.9, -0.4, 2.0])
    covariance = np.diag([0.01, 0.02, 0.03, 0.001, 0.002, 0.003])
    start = frames.start(*frames.base_pose(at(pose, covariance)))
    np.testing.assert_allclose(start.pose, pose, atol=1e-12)
    assert start.error_m == pytest.approx(np.sqrt(0.06)) and start.error_rad == pytest.approx(np.sqrt(0.006))
    assert frames.start(np.eye(4), np.zeros((6, 6))).error_m == 0.10
    for pose_, covariance_ in (
        (np.eye(4), np.full((6, 6), np.nan)),
        (np.eye(4), -np.eye(6)),
        (np.ones((4, 4)), None),
    ):
        with pytest.raises(ValueError, match="must be"):
            frames.start(pose_, np.eye(6) if covariance_ is None else covariance_)


def quaternion(*xyzw: float) -> SimpleNamespace:
    return SimpleNamespace(**dict(zip("xyzw", xyzw, strict=True)))


def test_gravity_is_that_of_an_imu() -> None:
    """A vehicle that is rolled to the right by 0.2 rad, with a camera that looks forward."""
    frames = RosFrames(Mount().T_body_camera, None)
    down = down_camera(quaternion(*rotation_to_quaternion(so3_exp([0.2, 0.0, 0.0]))), frames.T_base_camera)
    np.testing.assert_allclose(down, [np.sin(0.2), np.cos(0.2), 0.0], atol=1e-12)


def test_poses_of_messages() -> None:
    place = SimpleNamespace(x=1.0, y=2.0, z=3.0)
    for turn in (quaternion(0.0, 0.0, 2.0, 0.0), quaternion(0.0, 0.0, -1.0, 0.0)):
        pose = SimpleNamespace(pose=SimpleNamespace(position=place, orientation=turn))
        transform = SimpleNamespace(transform=SimpleNamespace(translation=place, rotation=turn))
        for message in (pose, transform):
            expected = make_pose(np.diag([-1.0, -1.0, 1.0]), [1.0, 2.0, 3.0])
            np.testing.assert_allclose(pose_of(message), expected, atol=1e-12)
    with pytest.raises(ValueError, match="quaternion"):
        pose_of(SimpleNamespace(position=place, orientation=quaternion(0.0, 0.0, 0.0, 0.0)))
