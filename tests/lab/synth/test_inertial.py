"""Simulated IMU and odometer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.cli.motion_options import measured_motions
from monoloc.geometry import invert, so3_exp, so3_log
from monoloc.io.tum_trajectory import write_tum
from monoloc_lab.synth.flights import GRAVITY, Flight, FlightConfig, plan_flight
from monoloc_lab.synth.inertial import ImuModel, OdometryModel, simulate_imu, simulate_odometry, write_imu
from monoloc_lab.synth.layout import generate_room

PERFECT = ImuModel(gyro_density=0.0, gyro_walk=0.0, accel_density=0.0, accel_walk=0.0, gyro_bias=0.0, accel_bias=0.0)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return plan_flight(generate_room(1), FlightConfig(seconds=8.0), 0)


def test_imu_integrates_back_to_the_flight(flight: Flight) -> None:
    data = simulate_imu(flight, PERFECT, np.random.default_rng(0))
    T = flight.body_poses(data.times_s[:1])[0]
    R, position, velocity = T[:3, :3], T[:3, 3].copy(), flight.path(data.times_s[:1], 1)[0, :3]
    gravity = np.array([0.0, 0.0, -GRAVITY])
    for k, dt in enumerate(np.diff(data.times_s)):
        # Midpoint of two samples, as in preintegration.
        gyro, force = (data.gyro[k] + data.gyro[k + 1]) / 2.0, (data.accel[k] + data.accel[k + 1]) / 2.0
        acceleration = R @ so3_exp(gyro * dt / 2.0) @ force + gravity
        position = position + velocity * dt + acceleration * dt**2 / 2.0
        velocity = velocity + acceleration * dt
        R = R @ so3_exp(gyro * dt)
    end = flight.body_poses(data.times_s[-1:])[0]
    assert np.linalg.norm(position - end[:3, 3]) < 2e-3
    assert np.linalg.norm(so3_log(R.T @ end[:3, :3])) < 1e-4


def test_imu_noise_has_its_densities(flight: Flight) -> None:
    model = ImuModel(gyro_bias=0.01, accel_bias=0.1)
    truth = simulate_imu(flight, PERFECT, np.random.default_rng(0))
    data = simulate_imu(flight, model, np.random.default_rng(1))
    rate = np.sqrt(model.rate_hz)
    white = data.gyro - data.gyro_bias - truth.gyro, data.accel - data.accel_bias - truth.accel
    # 1600 samples of three axes give the standard deviation to about one percent.
    assert white[0].std() == pytest.approx(model.gyro_density * rate, rel=0.05)
    assert white[1].std() == pytest.approx(model.accel_density * rate, rel=0.05)
    assert np.diff(data.gyro_bias, axis=0).std() == pytest.approx(model.gyro_walk / rate, rel=0.05)
    assert np.diff(data.accel_bias, axis=0).std() == pytest.approx(model.accel_walk / rate, rel=0.05)
    starts = [simulate_imu(flight, model, np.random.default_rng(s)).gyro_bias[0] for s in range(60)]
    assert np.std(starts) == pytest.approx(model.gyro_bias, rel=0.25)


def test_imu_file_has_the_samples(flight: Flight, tmp_path: Path) -> None:
    data = simulate_imu(flight, ImuModel(), np.random.default_rng(0))
    write_imu(tmp_path / "imu.csv", data)
    table_ = np.loadtxt(tmp_path / "imu.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table_, np.column_stack([data.times_s, data.gyro, data.accel]), atol=1e-9)


def test_localizer_reads_the_files_as_the_camera_moved(tmp_path: Path, flight: Flight) -> None:
    """The camera looks down by 12 degrees, as its mount says."""
    poses, rng = flight.camera_poses(), np.random.default_rng(0)
    write_imu(tmp_path / "imu.csv", simulate_imu(flight, PERFECT, rng))
    write_tum(tmp_path / "body.txt", flight.times_s, flight.body_poses(flight.times_s))
    (tmp_path / "flight.toml").write_text(f"[mount]\npitch_deg = {-flight.config.look_down_deg}\n")
    truth = invert(poses[:-1]) @ poses[1:]
    turning = measured_motions(flight.times_s, tmp_path / "imu.csv", None, 0.0, tmp_path / "flight.toml")
    moving = measured_motions(flight.times_s, None, tmp_path / "body.txt", 0.0, tmp_path / "flight.toml")
    assert turning is not None and moving is not None
    for turn, motion, true in zip(turning[1:], moving[1:], truth, strict=True):
        assert turn is not None and motion is not None
        np.testing.assert_allclose(turn.T_previous_current[:3, :3], true[:3, :3], atol=1e-5)
        np.testing.assert_allclose(motion.T_previous_current, true, atol=1e-7)


def test_odometry_drifts(flight: Flight) -> None:
    poses, model = flight.camera_poses(), OdometryModel()
    exact = OdometryModel(0.0, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(simulate_odometry(poses, exact, np.random.default_rng(0)), poses, atol=1e-9)
    middle, end = [], []
    for seed in range(30):
        drifting = simulate_odometry(poses, model, np.random.default_rng(seed))
        np.testing.assert_allclose(drifting[0], poses[0])
        errors = np.linalg.norm(drifting[:, :3, 3] - poses[:, :3, 3], axis=1)
        middle.append(errors[len(errors) // 4])
        end.append(errors[-1])
    assert np.median(end) > np.median(middle) > 0.0
    assert np.median(end) < 0.2
