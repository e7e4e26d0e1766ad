"""The Cramér–Rao bound against dense algebra, limits that are known, and perturbed poses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from numerics import numerical_jacobian
from simbench.metrics.bound import (
    TrueCorrespondences,
    motion_information,
    object_motion_covariance,
)
from simbench.metrics.motion import body_motion
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.residuals import point_terms
from slam.types import Intrinsics

CAMERA = Intrinsics(500.0, 510.0, 319.5, 239.5, 640, 480)
T_A_B = se3.exp(np.array([0.02, -0.03, 0.01, 0.05, -0.02, 0.1]))


def seen(count: int = 40, sigma_rho_a: float = 0.002, sigma_rho_b: float = 0.003
         ) -> TrueCorrespondences:
    rng = np.random.default_rng(5)
    return TrueCorrespondences(
        rng.uniform([40, 40], [600, 440], (count, 2)), rng.uniform(0.2, 1.0, count),
        rng.uniform(0.1, 0.5, count), np.full(count, sigma_rho_a), np.full(count, sigma_rho_b))


def rays(uv: Array) -> Array:
    return np.stack([(uv[:, 0] - CAMERA.cx) / CAMERA.fx, (uv[:, 1] - CAMERA.cy) / CAMERA.fy,
                     np.ones(len(uv))], axis=-1)


def dense_information(points: TrueCorrespondences) -> Array:
    """All unknowns at once, 6 + N, by the analytic Jacobians; then the motion's share."""
    n = len(points.rho_a)
    terms = point_terms(T_A_B, rays(points.uv_a), points.rho_a, np.zeros((n, 2)), np.zeros(n),
                        CAMERA)
    J = np.zeros((4 * n, 6 + n))
    weight = np.zeros(4 * n)
    for i in range(n):
        J[4 * i: 4 * i + 3, :6] = terms.J_pose[i]
        J[4 * i: 4 * i + 3, 6 + i] = terms.J_rho[i]
        J[4 * i + 3, 6 + i] = 1.0
        weight[4 * i: 4 * i + 4] = np.array([points.sigma_px[i], points.sigma_px[i],
                                             points.sigma_rho_b[i], points.sigma_rho_a[i]]) ** -2.0
    return np.linalg.inv(np.linalg.inv(J.T @ (weight[:, None] * J))[:6, :6])


@pytest.mark.parametrize("sigma_rho_b", [0.003, np.inf])
def test_eliminating_the_depths_is_what_the_dense_system_says(sigma_rho_b: float):
    points = seen(sigma_rho_b=sigma_rho_b)
    found = motion_information(T_A_B, points, CAMERA)
    assert_allclose(found, dense_information(points), rtol=1e-4, atol=1e-5 * np.abs(found).max())


def test_half_the_noise_is_four_times_the_information():
    points = seen()
    better = TrueCorrespondences(points.uv_a, points.rho_a, points.sigma_px / 2,
                                 points.sigma_rho_a / 2, points.sigma_rho_b / 2)
    assert_allclose(motion_information(T_A_B, better, CAMERA),
                    4 * motion_information(T_A_B, points, CAMERA), rtol=1e-9)


def test_information_of_parts_adds_up():
    points = seen()
    parts = [TrueCorrespondences(points.uv_a[s], points.rho_a[s], points.sigma_px[s],
                                 points.sigma_rho_a[s], points.sigma_rho_b[s])
             for s in (slice(0, 15), slice(15, None))]
    assert_allclose(sum(motion_information(T_A_B, part, CAMERA) for part in parts),
                    motion_information(T_A_B, points, CAMERA), rtol=1e-9)


def test_depth_that_is_known_better_never_tells_less():
    worse = motion_information(T_A_B, seen(sigma_rho_a=0.01, sigma_rho_b=np.inf), CAMERA)
    better = motion_information(T_A_B, seen(sigma_rho_a=0.01, sigma_rho_b=0.01), CAMERA)
    gain = np.linalg.eigvalsh(better - worse)
    assert gain.min() > -1e-6 * gain.max()
    assert gain.max() > 0


def test_a_maximum_likelihood_estimate_of_many_draws_reaches_the_bound():
    points = seen(60)
    rng = np.random.default_rng(1)
    truth = point_terms(T_A_B, rays(points.uv_a), points.rho_a, np.zeros((60, 2)), np.zeros(60),
                        CAMERA)
    bound = np.linalg.inv(motion_information(T_A_B, points, CAMERA))
    S = np.einsum("ni,nj,n->nij", truth.J_rho, truth.J_rho, points.sigma_rho_a**2)
    S += np.stack([points.sigma_px, points.sigma_px, points.sigma_rho_b], -1)[:, :, None]**2 \
        * np.eye(3)
    errors = []
    for _ in range(400):
        rho_a = points.rho_a + points.sigma_rho_a * rng.standard_normal(60)
        uv_b = truth.r[:, :2] + points.sigma_px[:, None] * rng.standard_normal((60, 2))
        rho_b = truth.r[:, 2] + points.sigma_rho_b * rng.standard_normal(60)
        T = T_A_B
        for _ in range(2):
            t = point_terms(T, rays(points.uv_a), rho_a, uv_b, rho_b, CAMERA)
            SJ = np.linalg.solve(S, t.J_pose)
            T = T @ se3.exp(-np.linalg.solve(np.einsum("nij,nik->jk", t.J_pose, SJ),
                                             np.einsum("nij,ni->j", SJ, t.r)))
        errors.append(se3.log(se3.inverse(T_A_B) @ T))
    ratio = np.mean(np.square(errors), axis=0) / np.diag(bound)
    assert np.all((ratio > 0.75) & (ratio < 1.3))


def test_the_covariance_of_an_objects_motion_is_that_of_both_perturbed_poses():
    X_a = se3.exp(np.array([0.1, 0.2, -0.1, 1.0, 0.5, 0.3]))
    X_b = X_a @ T_A_B
    L_a = se3.exp(np.array([0.4, -0.2, 0.3, 0.5, -0.3, 4.0]))
    H = se3.exp(np.array([0.02, 0.05, -0.01, 0.03, 0.0, -0.04]))
    of_camera = motion_information(T_A_B, seen(80), CAMERA)
    T_object = se3.inverse(X_a) @ se3.inverse(H) @ X_b
    of_object = motion_information(T_object, seen(30), CAMERA)

    def error(xi_camera: Array, xi_object: Array) -> Array:
        """Log of the error of L⁻¹ H L, from camera and object poses that are off by ξ."""
        relative = T_A_B @ se3.exp(xi_camera) @ se3.inverse(T_object @ se3.exp(xi_object))
        estimated = body_motion(L_a, X_a @ relative @ se3.inverse(X_a))
        return se3.log(se3.inverse(body_motion(L_a, H)) @ estimated)

    J = numerical_jacobian(lambda xi: error(xi[:6], xi[6:]), 12)
    both = np.zeros((12, 12))
    both[:6, :6], both[6:, 6:] = np.linalg.inv(of_camera), np.linalg.inv(of_object)
    found = object_motion_covariance(se3.inverse(H @ L_a) @ X_b, of_camera, of_object)
    assert_allclose(found, J @ both @ J.T, rtol=1e-5, atol=1e-9 * np.abs(found).max())
