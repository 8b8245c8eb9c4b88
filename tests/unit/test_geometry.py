"""SE(3): properties, and SciPy's Rotation as the oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from monoloc import geometry, geometry_numpy_twins

finite = st.floats(-10.0, 10.0, allow_nan=False, width=64)
vectors = arrays(np.float64, 3, elements=finite)
# Angles of all sizes, with those near zero and near pi as likely as the rest.
angles = st.one_of(
    st.floats(0.0, np.pi),
    st.floats(0.0, 1e-3),
    st.floats(np.pi - 1e-3, np.pi),
)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
rotation_vectors = st.builds(lambda axis, angle: axis * angle, directions, angles)
poses = st.builds(
    lambda phi, t: geometry.make_pose(Rotation.from_rotvec(phi).as_matrix(), t), rotation_vectors, vectors
)


@given(vectors, vectors)
def test_hat_is_the_cross_product(a, b):
    np.testing.assert_allclose(geometry.hat(a) @ b, np.cross(a, b), atol=1e-12)


@given(rotation_vectors)
def test_so3_exp_agrees_with_scipy(phi):
    np.testing.assert_allclose(geometry.so3_exp(phi), Rotation.from_rotvec(phi).as_matrix(), atol=1e-12)


@given(rotation_vectors)
@example(np.zeros(3))
@example(np.array([np.pi, 0.0, 0.0]))
@example(np.array([1e-4, 0.0, 0.0]))  # where the series takes over
def test_so3_log_inverts_exp(phi):
    result = geometry.so3_log(geometry.so3_exp(phi))
    # At pi both signs of the axis are the same rotation, so rotations are compared as well as vectors.
    np.testing.assert_allclose(geometry.so3_exp(result), geometry.so3_exp(phi), atol=1e-11)
    assert np.linalg.norm(result) <= np.pi + 1e-12
    if np.linalg.norm(phi) < np.pi - 1e-6:
        np.testing.assert_allclose(result, phi, atol=1e-11)


@pytest.mark.filterwarnings("error")
def test_so3_log_of_half_turns_is_exact_and_silent():
    half_turns = np.stack([np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.eye(3)])
    np.testing.assert_allclose(np.abs(geometry.so3_log(half_turns)), np.pi * np.diag([1.0, 1.0, 0.0]), atol=1e-12)


@given(rotation_vectors, vectors)
def test_se3_exp_is_the_matrix_exponential(phi, rho):
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = geometry.hat(phi), rho
    np.testing.assert_allclose(geometry.se3_exp(np.concatenate([rho, phi])), expm(generator), atol=1e-11)


@given(poses)
def test_se3_exp_inverts_log(pose):
    np.testing.assert_allclose(geometry.se3_exp(geometry.se3_log(pose)), pose, atol=1e-9)


@given(st.floats(0.0, np.pi - 1e-6), directions, vectors)
def test_se3_log_inverts_exp(angle, axis, rho):
    twist = np.concatenate([rho, angle * axis])
    np.testing.assert_allclose(geometry.se3_log(geometry.se3_exp(twist)), twist, atol=1e-8)


@given(poses, st.lists(poses, max_size=4))
def test_native_kernels_equal_their_numpy_twins(pose, others):
    batch = np.reshape([pose, *others], (-1, 4, 4))
    twists = geometry_numpy_twins.se3_log(batch)
    np.testing.assert_allclose(geometry.se3_exp(twists), geometry_numpy_twins.se3_exp(twists), atol=1e-12)
    is_half_turn = np.linalg.norm(twists[:, 3:], axis=1) > np.pi - 1e-6  # where both signs of the axis are right
    np.testing.assert_allclose(geometry.se3_log(batch)[~is_half_turn], twists[~is_half_turn], atol=1e-9)
    expected = geometry_numpy_twins.pose_distance_m(pose, batch)
    np.testing.assert_allclose(geometry.pose_distance_m(pose, batch), expected, atol=1e-12)


@pytest.mark.parametrize("shape", [(6,), (0, 6), (2, 3, 6)])
def test_native_kernels_take_any_batch_order_and_precision(shape):
    twists = np.random.default_rng(0).normal(size=shape)
    batch = geometry.se3_exp(twists)
    assert batch.shape == (*shape[:-1], 4, 4)
    np.testing.assert_allclose(geometry.se3_log(np.asfortranarray(batch)), twists, atol=1e-9)
    flat = batch.reshape(-1, 4, 4)
    expected = geometry_numpy_twins.pose_distance_m(np.eye(4), flat)
    every_second = np.repeat(flat, 2, axis=0)[::2].astype(np.float32)
    np.testing.assert_allclose(geometry.pose_distance_m(np.eye(4), every_second), expected, atol=1e-5)


@given(poses, poses, vectors)
def test_invert_compose_transform(T_a_b, T_b_c, point_c):
    np.testing.assert_allclose(geometry.invert(T_a_b) @ T_a_b, np.eye(4), atol=1e-12)
    step_by_step = geometry.transform(T_a_b, geometry.transform(T_b_c, point_c[None]))
    np.testing.assert_allclose(geometry.transform(T_a_b @ T_b_c, point_c[None]), step_by_step, atol=1e-10)


@given(rotation_vectors)
def test_quaternions_agree_with_scipy(phi):
    rotation = Rotation.from_rotvec(phi)
    quaternion = geometry.rotation_to_quaternion(rotation.as_matrix())
    assert quaternion[3] >= 0.0
    expected = rotation.as_quat(canonical=True)
    # At a half turn w = 0 and both signs are canonical.
    sign = 1.0 if expected[3] > 1e-9 else np.sign(expected @ quaternion)
    np.testing.assert_allclose(quaternion, sign * expected, atol=1e-11)
    np.testing.assert_allclose(geometry.quaternion_to_rotation(3.0 * expected), rotation.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("quaternion", [[0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0]])
def test_invalid_quaternion_is_refused(quaternion):
    with pytest.raises(ValueError, match="finite and not zero"):
        geometry.quaternion_to_rotation(quaternion)


@given(rotation_vectors)
def test_rotation_angle(phi):
    angle = geometry.rotation_angle(geometry.so3_exp(phi))
    assert angle == pytest.approx(np.linalg.norm(phi), abs=1e-10)


@given(poses)
def test_is_rigid(pose):
    assert geometry.is_rigid(pose)
    for row, column, value in ((0, 0, pose[0, 0] + 0.1), (1, 2, np.nan), (3, 3, 2.0), (2, 3, np.inf)):
        spoilt = pose.copy()
        spoilt[row, column] = value
        assert not geometry.is_rigid(spoilt)
    mirrored = pose.copy()
    mirrored[:3, 0] *= -1.0
    assert not geometry.is_rigid(mirrored)


@given(rotation_vectors, arrays(np.float64, (3, 3), elements=st.floats(-1e-3, 1e-3)))
def test_nearest_rotation(phi, noise):
    rotation = geometry.so3_exp(phi)
    np.testing.assert_allclose(geometry.nearest_rotation(2.0 * rotation), rotation, atol=1e-12)
    cleaned = geometry.nearest_rotation(rotation + noise)
    np.testing.assert_allclose(cleaned.T @ cleaned, np.eye(3), atol=1e-12)
    assert np.linalg.det(cleaned) == pytest.approx(1.0)
    assert np.linalg.norm(cleaned - rotation - noise) <= np.linalg.norm(noise) + 1e-12


def test_every_function_takes_batch_axes():
    rng = np.random.default_rng(0)
    twists = rng.normal(size=(2, 5, 6))
    batch = geometry.se3_exp(twists)
    assert batch.shape == (2, 5, 4, 4)
    for function in (
        geometry.se3_log,
        geometry.invert,
        lambda T: geometry.rotation_angle(T[..., :3, :3]),
        lambda T: geometry.rotation_to_quaternion(T[..., :3, :3]),
        lambda T: geometry.nearest_rotation(T[..., :3, :3]),
        geometry.is_rigid,
    ):
        np.testing.assert_allclose(function(batch)[1, 3], function(batch[1, 3]), atol=1e-12)
    points = rng.normal(size=(2, 5, 7, 3))
    moved = geometry.transform(batch, points)
    np.testing.assert_allclose(moved[1, 3], geometry.transform(batch[1, 3], points[1, 3]), atol=1e-12)


@given(poses, arrays(np.float64, 6, elements=st.floats(-1.0, 1.0)))
def test_adjoint_moves_a_twist_to_the_other_side_of_a_pose(
    pose: geometry.FloatArray, twist: geometry.FloatArray
) -> None:
    moved = geometry.se3_exp(geometry.adjoint(pose) @ twist) @ pose
    np.testing.assert_allclose(moved, pose @ geometry.se3_exp(twist), atol=1e-8)


def test_pose_distance_is_metres_plus_radians() -> None:
    relative = geometry.se3_exp(np.array([[0.3, 0.4, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.2, 0.0]]))
    pose = geometry.se3_exp(np.array([1.0, 2.0, 3.0, 0.3, 0.2, 0.1]))
    np.testing.assert_allclose(geometry.pose_distance_m(pose, pose @ relative), [0.5, 0.2], atol=1e-9)


def test_angle_between_unit_vectors():
    x, y = np.eye(3)[:2]
    assert geometry.angle_between(x, y) == pytest.approx(np.pi / 2.0)
    assert geometry.angle_between(x, geometry.so3_exp([0.0, 0.0, 0.3]) @ x) == pytest.approx(0.3)
    almost = np.nextafter(1.0, 2.0) * x  # whose product with itself is above one
    assert geometry.angle_between(almost, almost) == 0.0
