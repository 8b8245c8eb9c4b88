"""Flights: within their limits, clear of everything, repeatable; and the IMU and odometer that go with them."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.errors import SettingError
from monoloc.geometry import is_rigid, so3_exp, so3_log
from monoloc_lab.synth.flights import CAMERA_RATE_HZ, GRAVITY, Flight, FlightConfig, plan_flight
from monoloc_lab.synth.furniture import table
from monoloc_lab.synth.inertial import ImuModel, OdometryModel, simulate_imu, simulate_odometry, write_imu
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.materials import BLACK_PLASTIC
from monoloc_lab.synth.minimum_snap import minimum_snap
from monoloc_lab.synth.rooms import Object, Room

CONFIG = FlightConfig(seconds=8.0)
PERFECT = ImuModel(gyro_density=0.0, gyro_walk=0.0, accel_density=0.0, accel_walk=0.0, gyro_bias=0.0, accel_bias=0.0)


@pytest.fixture(scope="module")
def room() -> Room:
    return generate_room(1)


@pytest.fixture(scope="module")
def flight(room) -> Flight:
    return plan_flight(room, CONFIG, 0)


@pytest.fixture
def times() -> np.ndarray:
    return np.arange(0.0, CONFIG.seconds, 0.002)


# --- minimum snap ---


def test_spline_meets_its_waypoints_at_rest_and_is_smooth():
    rng = np.random.default_rng(0)
    points, durations = rng.uniform(-2.0, 2.0, (6, 4)), rng.uniform(1.0, 4.0, 5)
    spline = minimum_snap(points, durations)
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    np.testing.assert_allclose(spline(knots), points, atol=1e-9)
    for derivative in (1, 2, 3):
        np.testing.assert_allclose(spline(knots[[0, -1]], derivative), 0.0, atol=1e-8)
    for derivative in range(1, 7):
        before, after = spline(knots[1:-1] - 1e-9, derivative), spline(knots[1:-1] + 1e-9, derivative)
        np.testing.assert_allclose(before, after, atol=1e-5 * (1.0 + np.abs(before).max()))


def test_derivatives_are_those_of_the_values():
    spline = minimum_snap([[0.0], [1.0], [-1.0]], [1.0, 2.0])
    t, h = np.linspace(0.1, 2.9, 40), 1e-5
    for derivative in (0, 1, 2):
        numeric = (spline(t + h, derivative) - spline(t - h, derivative)) / (2.0 * h)
        np.testing.assert_allclose(numeric, spline(t, derivative + 1), atol=1e-4)


def test_no_other_smooth_way_has_less_snap():
    points, durations = np.array([[0.0], [1.0], [0.5], [2.0]]), np.array([1.0, 1.5, 1.0])
    best = minimum_snap(points, durations)
    t = np.linspace(0.0, best.duration_s, 4001)
    snap = np.sum(best(t, 4) ** 2)
    rng = np.random.default_rng(0)
    for _ in range(10):
        # A way through the same waypoints with another one between them is a competitor.
        extra = rng.uniform(0.2, 3.3)
        knots = np.sort(np.append(np.concatenate([[0.0], np.cumsum(durations)]), extra))
        values = best(knots) + 0.05 * (knots == extra)[:, None]
        other = minimum_snap(values, np.diff(knots))
        assert np.sum(other(t, 4) ** 2) > snap


def test_slower_is_the_same_way():
    spline = minimum_snap([[0.0, 0.0], [1.0, 2.0]], [2.0])
    slow, t = spline.slowed(2.0), np.linspace(0.0, 2.0, 9)
    np.testing.assert_allclose(slow(2.0 * t), spline(t), atol=1e-12)
    np.testing.assert_allclose(slow(2.0 * t, 2), spline(t, 2) / 4.0, atol=1e-12)


def test_waypoints_of_a_wrong_shape():
    with pytest.raises(ValueError, match=r"waypoints must have shape \(3, D\), got \(2, 1\)"):
        minimum_snap([[0.0], [1.0]], [1.0, 1.0])


# --- flights ---


def test_flight_stays_within_its_limits(flight, times):
    velocity, acceleration = flight.path(times, 1), flight.path(times, 2)[:, :3]
    slack = 1.001  # between the times at which the planner looks
    assert np.linalg.norm(velocity[:, :3], axis=1).max() <= CONFIG.speed * slack
    assert np.linalg.norm(acceleration, axis=1).max() <= CONFIG.acceleration * slack
    assert np.abs(velocity[:, 3]).max() <= np.deg2rad(CONFIG.yaw_rate_deg) * slack
    assert flight.tilt_rad(times).max() <= np.deg2rad(CONFIG.tilt_deg) * slack


def test_limits_bind(room):
    slow = plan_flight(room, CONFIG.model_copy(update={"speed": 0.3}), 0)
    fast = plan_flight(room, CONFIG.model_copy(update={"speed": 1.2, "yaw_rate_deg": 120.0}), 0)
    speeds = [np.linalg.norm(f.path(f.times_s, 1)[:, :3], axis=1).max() for f in (slow, fast)]
    assert speeds[0] <= 0.3 < 0.5 < speeds[1]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_flight_is_clear_of_everything(room, seed, times):
    flight = plan_flight(room, CONFIG, seed)
    assert room.clearance_m(flight.path(times)[:, :3]).min() > CONFIG.clearance_m - 0.005


@pytest.mark.slow
def test_a_long_flight_is_like_a_short_one(room):
    config = FlightConfig(seconds=90.0)
    flight, times = plan_flight(room, config, 0), np.arange(0.0, 90.0, 0.005)
    assert len(flight.times_s) == 2700 and flight.path.duration_s >= 90.0
    state, velocity, acceleration = (flight.path(times, derivative) for derivative in range(3))
    assert room.clearance_m(state[::4, :3]).min() > config.clearance_m - 0.005
    assert np.linalg.norm(velocity[:, :3], axis=1).max() <= config.speed * 1.001
    assert np.linalg.norm(acceleration[:, :3], axis=1).max() <= config.acceleration * 1.001
    # Nowhere a jump, of place, yaw, or how fast either changes.
    np.testing.assert_allclose(np.diff(state, axis=0) / 0.005, velocity[:-1], atol=0.03)
    np.testing.assert_allclose(np.diff(velocity, axis=0) / 0.005, acceleration[:-1], atol=0.15)
    still = np.linalg.norm(velocity[:, :3], axis=1) < 0.01
    assert 0.0 < still.mean() < 0.15


def test_same_seed_same_bytes(room, flight):
    again = plan_flight(generate_room(1), CONFIG, 0)
    assert again.camera_poses().tobytes() == flight.camera_poses().tobytes()
    assert plan_flight(room, CONFIG, 7).camera_poses().tobytes() != flight.camera_poses().tobytes()


def test_camera_looks_along_the_yaw_and_a_little_down(flight):
    poses = flight.camera_poses()
    assert poses.shape == (int(CONFIG.seconds * CAMERA_RATE_HZ), 4, 4) and np.all(is_rigid(poses))
    np.testing.assert_allclose(poses[:, :3, 3], flight.path(flight.times_s)[:, :3], atol=1e-12)
    forward, down = poses[:, :3, 2], poses[:, :3, 1]
    yaw = flight.path(flight.times_s)[:, 3]
    horizontal = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    assert np.all(np.sum(forward[:, :2] * horizontal, axis=1) > 0.9)
    assert np.all(down[:, 2] < -0.9)
    pitch = np.rad2deg(np.arcsin(-forward[:, 2]))
    assert np.abs(pitch - CONFIG.look_down_deg).max() < CONFIG.tilt_deg


def test_room_too_full_to_fly():
    block = Object("block", table(3.6, 3.6, 2.3, BLACK_PLASTIC, BLACK_PLASTIC), (2.0, 2.0, 0.0))
    room = Room((4.0, 4.0, 2.5)).add(block)
    with pytest.raises(SettingError, match="clearance_m: leaves no way through this room; choose a smaller one"):
        plan_flight(room, FlightConfig(low_m=2.0, high_m=2.4, seconds=2.0), 0)


# --- inertial measurements ---


def test_imu_integrates_back_to_the_flight(flight):
    data = simulate_imu(flight, PERFECT, np.random.default_rng(0))
    T = flight.body_poses(data.times_s[:1])[0]
    R, position, velocity = T[:3, :3], T[:3, 3].copy(), flight.path(data.times_s[:1], 1)[0, :3]
    gravity = np.array([0.0, 0.0, -GRAVITY])
    for k, dt in enumerate(np.diff(data.times_s)):
        # Midpoint of two samples, as preintegration does.
        gyro, force = (data.gyro[k] + data.gyro[k + 1]) / 2.0, (data.accel[k] + data.accel[k + 1]) / 2.0
        acceleration = R @ so3_exp(gyro * dt / 2.0) @ force + gravity
        position = position + velocity * dt + acceleration * dt**2 / 2.0
        velocity = velocity + acceleration * dt
        R = R @ so3_exp(gyro * dt)
    end = flight.body_poses(data.times_s[-1:])[0]
    assert np.linalg.norm(position - end[:3, 3]) < 2e-3
    assert np.linalg.norm(so3_log(R.T @ end[:3, :3])) < 1e-4


def test_imu_noise_has_its_densities(flight):
    model = ImuModel(gyro_bias=0.01, accel_bias=0.1)
    truth = simulate_imu(flight, PERFECT, np.random.default_rng(0))
    data = simulate_imu(flight, model, np.random.default_rng(1))
    rate = np.sqrt(model.rate_hz)
    white = data.gyro - data.gyro_bias - truth.gyro, data.accel - data.accel_bias - truth.accel
    # 1600 samples of three axes: the standard deviation is known to about one percent.
    assert white[0].std() == pytest.approx(model.gyro_density * rate, rel=0.05)
    assert white[1].std() == pytest.approx(model.accel_density * rate, rel=0.05)
    assert np.diff(data.gyro_bias, axis=0).std() == pytest.approx(model.gyro_walk / rate, rel=0.05)
    assert np.diff(data.accel_bias, axis=0).std() == pytest.approx(model.accel_walk / rate, rel=0.05)
    starts = [simulate_imu(flight, model, np.random.default_rng(s)).gyro_bias[0] for s in range(60)]
    assert np.std(starts) == pytest.approx(model.gyro_bias, rel=0.25)


def test_imu_file(flight, tmp_path):
    data = simulate_imu(flight, ImuModel(), np.random.default_rng(0))
    write_imu(tmp_path / "imu.csv", data)
    table_ = np.loadtxt(tmp_path / "imu.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table_, np.column_stack([data.times_s, data.gyro, data.accel]), atol=1e-9)


def test_odometry_errs_as_its_model_says_and_drifts(flight):
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
