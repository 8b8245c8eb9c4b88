"""Simulated inertial measurement unit and odometer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monoloc.files import write_whole
from monoloc.geometry import FloatArray, invert, se3_exp, so3_log
from monoloc_lab.synth.flights import GRAVITY, Flight

_DIFFERENCE_S = 1e-4  # for the angular velocity, by central differences


@dataclass(frozen=True)
class ImuModel:
    """Noise of an IMU as continuous densities; the defaults are those of the EuRoC drone's ADIS16448.

    Burri et al., *The EuRoC micro aerial vehicle datasets* (2016). White noise has the standard deviation
    ``density * sqrt(rate)`` per sample. The bias is a random walk with steps of ``walk / sqrt(rate)``.

    Attributes:
        rate_hz: samples per second.
        gyro_density, gyro_walk: rad/s/sqrt(Hz) and rad/s^2/sqrt(Hz).
        accel_density, accel_walk: m/s^2/sqrt(Hz) and m/s^3/sqrt(Hz).
        gyro_bias, accel_bias: standard deviation of the initial bias, rad/s and m/s^2.
    """

    rate_hz: float = 200.0
    gyro_density: float = 1.6968e-4
    gyro_walk: float = 1.9393e-5
    accel_density: float = 2.0e-3
    accel_walk: float = 3.0e-3
    gyro_bias: float = 2.0e-3
    accel_bias: float = 2.0e-2


@dataclass(frozen=True)
class ImuData:
    """N samples in the body frame (forward, left, up).

    Attributes:
        times_s: (N,).
        gyro: (N, 3) angular velocity, rad/s.
        accel: (N, 3) specific force, m/s^2; +g upwards at rest.
        gyro_bias, accel_bias: (N, 3) the true biases in them.
    """

    times_s: FloatArray
    gyro: FloatArray
    accel: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray


def simulate_imu(flight: Flight, model: ImuModel, rng: np.random.Generator) -> ImuData:
    """Simulate the samples of an IMU over a flight; a model of zeros gives the truth."""
    times = np.arange(int(flight.config.seconds * model.rate_hz) + 1) / model.rate_hz
    ahead, behind = (flight.body_poses(times + s * _DIFFERENCE_S)[:, :3, :3] for s in (0.5, -0.5))
    omega = so3_log(np.swapaxes(behind, 1, 2) @ ahead) / _DIFFERENCE_S
    force_world = flight.path(times, 2)[:, :3] + np.array([0.0, 0.0, GRAVITY])
    force = np.einsum("nji,nj->ni", flight.body_poses(times)[:, :3, :3], force_world)
    rate = np.sqrt(model.rate_hz)

    def noise(density: float, walk: float, bias: float) -> tuple[FloatArray, FloatArray]:
        steps = walk / rate * rng.standard_normal((len(times), 3))
        steps[0] = bias * rng.standard_normal(3)
        return density * rate * rng.standard_normal((len(times), 3)), np.cumsum(steps, axis=0)

    gyro_noise, gyro_bias = noise(model.gyro_density, model.gyro_walk, model.gyro_bias)
    accel_noise, accel_bias = noise(model.accel_density, model.accel_walk, model.accel_bias)
    return ImuData(times, omega + gyro_bias + gyro_noise, force + accel_bias + accel_noise, gyro_bias, accel_bias)


@dataclass(frozen=True)
class OdometryModel:
    """Errors of the steps of an odometer: independent, and proportional to the motion.

    Attributes:
        shift_share, turn_share: standard deviation of the error of a step, as a share of its length and turn.
        shift_m, turn_rad: standard deviation of the error of a step without motion.
    """

    shift_share: float = 0.03
    turn_share: float = 0.02
    shift_m: float = 5e-4
    turn_rad: float = 3e-4


def simulate_odometry(poses: FloatArray, model: OdometryModel, rng: np.random.Generator) -> FloatArray:
    """Dead reckoning with drift from the first pose: ``T_world_camera`` (N, 4, 4) -> (N, 4, 4)."""
    steps = invert(poses[:-1]) @ poses[1:]
    shift = np.linalg.norm(steps[:, :3, 3], axis=1, keepdims=True)
    turn = np.linalg.norm(so3_log(steps[:, :3, :3]), axis=1, keepdims=True)
    sd = np.column_stack(
        [
            np.repeat(model.shift_m + model.shift_share * shift, 3, 1),
            np.repeat(model.turn_rad + model.turn_share * turn, 3, 1),
        ]
    )
    noisy = steps @ se3_exp(sd * rng.standard_normal((len(steps), 6)))
    drifting = [poses[0]]
    for step in noisy:
        drifting.append(drifting[-1] @ step)
    return np.stack(drifting)


def write_imu(path: Path, data: ImuData) -> None:
    """Samples as a CSV of time (s), angular velocity (rad/s) and specific force (m/s^2), body frame."""
    rows = np.column_stack([data.times_s, data.gyro, data.accel])
    lines = [",".join(f"{value:.9f}" for value in row) for row in rows]
    write_whole(path, "\n".join(["t_s,wx,wy,wz,fx,fy,fz", *lines, ""]).encode())
