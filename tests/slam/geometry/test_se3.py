import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from numerics import numerical_jacobian
from slam.geometry import se3
from strategies import (
    rigid_transforms,
    rotation_angles,
    rotation_vectors,
    unit_vectors,
    vectors,
    world_points,
)


def tangents(reach_m=5.0):
    return st.tuples(rotation_vectors(), vectors(3, limit=reach_m)).map(np.concatenate)


def hat(xi):
    """The 4×4 matrix of a tangent vector: exp is its matrix exponential, by definition."""
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = se3.skew(xi[:3]), xi[3:]
    return out


@given(vectors(3, limit=5.0), vectors(3, limit=5.0))
def test_skew_is_the_cross_product(a, b):
    assert_allclose(se3.skew(a) @ b, np.cross(a, b), atol=1e-14)


def test_skew_takes_integers_and_keeps_float32():
    assert_allclose(se3.skew([1, 2, 3]) @ np.array([4, 5, 6]), np.cross([1, 2, 3], [4, 5, 6]))
    assert se3.skew(np.ones(3, dtype=np.float32)).dtype == np.float32


@given(tangents())
def test_exp_is_the_matrix_exponential(xi):
    assert_allclose(se3.exp(xi), expm(hat(xi)), atol=1e-12)


@given(rotation_vectors())
def test_rotations_agree_with_scipy(w):
    R = Rotation.from_rotvec(w).as_matrix()
    assert_allclose(se3.exp_so3(w), R, atol=1e-14)
    assert_allclose(se3.exp_so3(se3.log_so3(R)), R, atol=1e-14)


@given(rotation_angles().filter(lambda a: a < np.pi - 1e-7), unit_vectors())
def test_log_so3_inverts_exp_so3(angle, axis):
    assert_allclose(se3.log_so3(se3.exp_so3(angle * axis)), angle * axis, rtol=1e-9, atol=1e-15)


@given(st.floats(0.0, 1e-6), unit_vectors())
def test_near_half_a_turn_log_gives_the_axis_up_to_sign(gap, axis):
    w = se3.log_so3(se3.exp_so3((np.pi - gap) * axis))
    assert_allclose(np.linalg.norm(w), np.pi - gap, atol=1e-9)
    assert_allclose(abs(w @ axis), np.pi - gap, atol=1e-9)


@given(tangents())
def test_exp_of_log_is_the_transform(xi):
    T = se3.exp(xi)
    assert_allclose(se3.exp(se3.log(T)), T, atol=1e-9)


@given(tangents().filter(lambda xi: np.linalg.norm(xi[:3]) < 3.0))
def test_log_of_exp_is_the_tangent(xi):
    assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-12)


@given(st.floats(0.9, 1.1).map(lambda s: 1e-4 * s), unit_vectors(), vectors(3, limit=2.0))
def test_the_series_near_zero_meets_the_closed_form(angle, axis, v):
    """1e-4 rad is where one takes over from the other."""
    xi = np.concatenate([angle * axis, v])
    assert_allclose(se3.exp(xi), expm(hat(xi)), atol=1e-15, rtol=1e-14)
    assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-14)


@given(rigid_transforms(), rigid_transforms(), rigid_transforms())
def test_group_axioms(A, B, C):
    assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-12)
    assert_allclose(A @ se3.inverse(A), np.eye(4), atol=1e-12)
    assert_allclose(se3.inverse(A) @ A, np.eye(4), atol=1e-12)
    assert_allclose(se3.inverse(A @ B), se3.inverse(B) @ se3.inverse(A), atol=1e-12)
    assert_allclose((A @ B)[:3, :3] @ (A @ B)[:3, :3].T, np.eye(3), atol=1e-14)


@given(rigid_transforms(), tangents(2.0))
def test_adjoint_carries_a_tangent_to_the_other_side(T, xi):
    assert_allclose(T @ se3.exp(xi) @ se3.inverse(T), se3.exp(se3.adjoint(T) @ xi), atol=1e-11)


@given(rigid_transforms(), world_points())
def test_moving_points(T_b_a, points):
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    assert_allclose(se3.transform_points(T_b_a, points), (homogeneous @ T_b_a.T)[:, :3], atol=1e-12)
    there_and_back = se3.transform_points(se3.inverse(T_b_a), se3.transform_points(T_b_a, points))
    assert_allclose(there_and_back, points, atol=1e-12)


@given(rigid_transforms(), world_points(1))
def test_a_right_perturbation_turns_a_point_in_its_own_frame(T, points):
    """∂(T Exp(ξ) p)/∂ξ at 0 is R [−[p]×, I]: rotation first, on the right."""
    R, p = T[:3, :3], points[0]
    numeric = numerical_jacobian(lambda xi: se3.transform_points(T @ se3.exp(xi), points)[0])
    assert_allclose(numeric, np.hstack([-R @ se3.skew(p), R]), atol=1e-8)


@given(rotation_angles(), unit_vectors())
def test_rotation_angle_agrees_with_the_angle_turned(angle, axis):
    # asin is flat at π: there the angle is known to half the digits.
    bound = 1e-7 if angle > np.pi - 1e-3 else 1e-12
    assert_allclose(se3.rotation_angle(se3.exp_so3(angle * axis)), angle, atol=bound)


@pytest.mark.parametrize("angle", [1e-2, 1e-5, 1e-9, 1e-12])
def test_rotation_angle_is_exact_near_zero(angle):
    """arccos of the trace gives 0 or 2e-8 for all of the smaller ones."""
    for axis in np.vstack([np.eye(3), np.full(3, 1.0) / np.sqrt(3.0)]):
        assert_allclose(se3.rotation_angle(se3.exp_so3(angle * axis)), angle, rtol=1e-9,
                        atol=1e-16)


@given(rotation_vectors(), st.floats(0.01, 100.0), st.sampled_from([1.0, -1.0]))
def test_quaternions_agree_with_scipy(w, length, sign):
    R = Rotation.from_rotvec(w)
    assert_allclose(se3.rotation_from_quaternion(sign * length * R.as_quat()), R.as_matrix(),
                    atol=1e-14)
    q = se3.quaternion_from_rotation(R.as_matrix())
    assert q[3] >= 0.0
    assert_allclose(np.linalg.norm(q), 1.0, atol=1e-14)
    assert_allclose(se3.rotation_from_quaternion(q), R.as_matrix(), atol=1e-14)
    assert_allclose(abs(q @ R.as_quat()), 1.0, atol=1e-14)


@given(rigid_transforms(), vectors(3, 3, limit=1e-3))
def test_orthonormalised_projects_back_on_the_rotations(T, noise):
    T_noisy = T.copy()
    T_noisy[:3, :3] += noise
    mended = se3.orthonormalised(T_noisy)
    R = mended[:3, :3]
    assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert_allclose(np.linalg.det(R), 1.0, atol=1e-14)
    assert_allclose(mended[:, 3], T[:, 3])
    assert np.linalg.norm(R - T_noisy[:3, :3]) <= np.linalg.norm(noise) + 1e-14   # the nearest
    assert_allclose(se3.orthonormalised(T), T, atol=1e-14)


def test_leading_axes_are_carried_through():
    rng = np.random.default_rng(0)
    xi = rng.normal(size=(2, 5, 6))
    T = se3.exp(xi)
    points = rng.normal(size=(2, 5, 4, 3))
    quats = se3.quaternion_from_rotation(T[..., :3, :3])
    for i in range(2):
        for j in range(5):
            assert_allclose(T[i, j], se3.exp(xi[i, j]), atol=1e-15)
            assert_allclose(se3.log(T)[i, j], se3.log(T[i, j]), atol=1e-14)
            assert_allclose(se3.inverse(T)[i, j], se3.inverse(T[i, j]), atol=1e-15)
            assert_allclose(se3.adjoint(T)[i, j], se3.adjoint(T[i, j]), atol=1e-15)
            assert_allclose(quats[i, j], se3.quaternion_from_rotation(T[i, j, :3, :3]), atol=1e-15)
            assert_allclose(se3.transform_points(T, points)[i, j],
                            se3.transform_points(T[i, j], points[i, j]), atol=1e-14)
            assert_allclose(se3.rotation_angle(T[..., :3, :3])[i, j],
                            np.linalg.norm(se3.log_so3(T[i, j, :3, :3])), atol=1e-12)
