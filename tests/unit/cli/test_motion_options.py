"""Files of sensors beside the camera: how they are mounted, which one counts, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.cli.motion_options import measured_motions
from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, so3_exp, so3_log
from monoloc.io.tum_trajectory import write_tum
from refusals import refuses_data, refuses_setting

FRAMES_S = np.arange(5) / 7.5
MOUNT = "[mount]\nforward_m = 0.1\npitch_deg = -30.0\n"
# Of a camera on a body with axes forward, left, up: 30 degrees down, 10 cm ahead.
_FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_BODY_CAMERA = np.eye(4)
T_BODY_CAMERA[:3, :3] = so3_exp([0.0, np.deg2rad(30.0), 0.0]) @ _FORWARD
T_BODY_CAMERA[0, 3] = 0.1
TWIST = np.array([0.3, 0.1, -0.2, 0.2, 0.4, -0.6])


def write_gyroscope(path: Path, rate: FloatArray, seconds: float = 1.0) -> Path:
    rows = [f"{t:.4f},{rate[0]},{rate[1]},{rate[2]}" for t in np.arange(0.0, seconds, 0.01)]
    path.write_text("\n".join(["t_s,wx,wy,wz", *rows, ""]))
    return path


def write_poses(path: Path, late_s: float = 0.0) -> Path:
    times_s = np.arange(0.0, 1.0, 0.05)
    write_tum(path, times_s + late_s, se3_exp(times_s[:, None] * TWIST))
    return path


def test_gyroscope_turns_the_camera_that_looks_forward_or_is_mounted(tmp_path: Path) -> None:
    """Yaw to the left is a turn about the axis up, which is the camera's minus y."""
    path = write_gyroscope(tmp_path / "imu.csv", np.array([0.0, 0.0, 0.6]))
    (tmp_path / "flight.toml").write_text(MOUNT)
    for mount, axis in ((None, [0.0, -1.0, 0.0]), (tmp_path / "flight.toml", T_BODY_CAMERA[2, :3])):
        motions = measured_motions(FRAMES_S, path, None, 0.0, mount)
        assert motions is not None and len(motions) == 5 and motions[0] is None
        for motion in motions[1:]:
            assert motion is not None and motion.translation == "unknown"
            rotation = so3_log(motion.T_previous_current[:3, :3])
            np.testing.assert_allclose(rotation, 0.6 / 7.5 * np.array(axis), atol=1e-9)


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
def test_motions_are_those_of_the_camera_whose_images_were_turned(tmp_path: Path, quarter_turns: int) -> None:
    """The trajectory and the mount are of the camera as it is held, in the order of the turns."""
    poses = write_poses(tmp_path / "camera.txt")
    spins = write_gyroscope(tmp_path / "imu.csv", np.array([0.0, 0.0, 0.6]))
    roll_deg = {1: -90, 2: 180, 3: 90}[quarter_turns]
    (tmp_path / "flight.toml").write_text(f"[mount]\nroll_deg = {roll_deg}\n")
    T_held_upright = make_pose(so3_exp([0.0, 0.0, 0.5 * np.pi * quarter_turns]), np.zeros(3))
    motions = measured_motions(FRAMES_S, None, poses, 0.0, None, quarter_turns)
    assert motions is not None and motions[1] is not None
    step = invert(T_held_upright) @ se3_exp(TWIST / 7.5) @ T_held_upright
    np.testing.assert_allclose(motions[1].T_previous_current, step, atol=1e-7)
    for mount in (None, tmp_path / "flight.toml"):
        motions = measured_motions(FRAMES_S, spins, None, 0.0, mount, quarter_turns)
        assert motions is not None and motions[1] is not None
        rotation = so3_log(motions[1].T_previous_current[:3, :3])
        np.testing.assert_allclose(rotation, [0.0, -0.6 / 7.5, 0.0], atol=1e-9)


@pytest.mark.parametrize("late_s", [0.0, 0.08])
def test_odometry_is_of_the_camera_or_with_a_mount_of_the_body(tmp_path: Path, late_s: float) -> None:
    path = write_poses(tmp_path / "wheels.txt", late_s)
    (tmp_path / "flight.toml").write_text(MOUNT)
    for mount, T_body_camera in ((None, np.eye(4)), (tmp_path / "flight.toml", T_BODY_CAMERA)):
        motions = measured_motions(FRAMES_S, None, path, late_s, mount)
        assert motions is not None
        step = invert(T_body_camera) @ se3_exp(TWIST / 7.5) @ T_body_camera
        for motion in motions[1:]:
            assert motion is not None and motion.translation == "metric"
            np.testing.assert_allclose(motion.T_previous_current, step, atol=1e-7)


def test_gyroscope_stands_in_where_odometry_ends(tmp_path: Path) -> None:
    poses, rates = write_poses(tmp_path / "wheels.txt"), write_gyroscope(tmp_path / "imu.csv", TWIST[3:], 2.0)
    motions = measured_motions(np.arange(13) / 7.5, rates, poses, 0.0, None)
    assert motions is not None
    kinds = [None if motion is None else motion.translation for motion in motions]
    assert kinds == [None, *["metric"] * 8, *["unknown"] * 4]  # the last sample is extrapolated over an eighth
    assert measured_motions(FRAMES_S, None, None, 0.0, None) is None


def test_sensor_that_tells_nothing_of_the_frames_is_refused(tmp_path: Path) -> None:
    poses, rates = write_poses(tmp_path / "wheels.txt"), write_gyroscope(tmp_path / "imu.csv", TWIST[3:])
    problem, fix = r"gives no motion between frames of 1000\.000 to 1000\.533 s", "clock of the frames"
    refuses_data(lambda: measured_motions(1000.0 + FRAMES_S, rates, None, 0.0, None), rates, problem, fix)
    refuses_data(lambda: measured_motions(1000.0 + FRAMES_S, None, poses, 0.0, None), poses, problem, fix)
    assert measured_motions(FRAMES_S[:1], rates, None, 0.0, None) == [None]


def test_options_without_the_sensor_that_they_are_about_are_refused(tmp_path: Path) -> None:
    mount, rates = tmp_path / "flight.toml", write_gyroscope(tmp_path / "imu.csv", TWIST[3:])
    refuses_setting(
        lambda: measured_motions(FRAMES_S, None, None, 0.0, mount), "--mount", "without a sensor", "add --gyroscope"
    )
    refuses_setting(
        lambda: measured_motions(FRAMES_S, rates, None, 0.1, None), "--odometry-delay", "without", "leave it out"
    )
    refuses_setting(
        lambda: measured_motions(FRAMES_S, None, write_poses(tmp_path / "a.txt"), np.nan, None),
        "--odometry-delay",
        "is nan",
        "give seconds",
    )
