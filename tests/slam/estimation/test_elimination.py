"""What elimination leaves has the minimum of the whole problem, every variable kept."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from slam.config import MotionConfig
from slam.estimation.kernel import robust
from slam.estimation.motion import NoiseScales, refine_motions
from slam.estimation.point_family import PointFamily
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.matches import no_lines
from slam.residuals import line_terms
from slam.tables import taken
from two_views import (
    CAMERA,
    no_points,
    perturbed,
    random_lines,
    random_points,
    seen_in_b,
    some_motion,
)

# A kernel so wide that the cost is quadratic, and no early end: the minimum itself.
EXACT = MotionConfig(kernel="huber", kernel_width=1e6, rounds=6, iterations=10,
                     step_tolerance=1e-10)
ONE = NoiseScales(np.ones(4))


def dense_points(m, T0, config):
    """Pose and flows that minimise eq. (2), (3) with the flows and inverse depths as variables."""
    n = len(m)
    root = np.linalg.inv(np.linalg.cholesky(m.flow_cov))

    def residual(x):
        T, flow, rho = T0 @ se3.exp(x[:6]), x[6:6 + 2 * n].reshape(n, 2), x[6 + 2 * n:]
        uv, rho_b = seen_in_b(T, m.uv_a, m.rho_a + rho)
        measured = np.einsum("nij,nj->ni", root, flow)
        reprojected = (m.uv_b + flow - uv) / config.reprojection_sigma_px
        known = np.isfinite(m.rho_sigma_b)
        return np.concatenate([measured.ravel(), reprojected.ravel(), rho / m.rho_sigma_a,
                               ((rho_b - m.rho_b) / m.rho_sigma_b)[known]])

    x = least_squares(residual, np.zeros(6 + 3 * n), xtol=1e-14, ftol=1e-14, gtol=1e-12,
                      x_scale="jac").x
    return T0 @ se3.exp(x[:6]), m.uv_b + x[6:6 + 2 * n].reshape(n, 2)


@pytest.mark.parametrize(("seed", "reprojection_sigma_px"), [(0, 0.02), (1, 0.2), (2, 0.5)])
def test_points_have_the_minimum_of_pose_flow_and_depth_together(seed, reprojection_sigma_px):
    rng = np.random.default_rng(seed)
    T_true = some_motion(rng)
    m = random_points(rng, T_true, 25)
    # Every second flow is known better across than along; every third has no second depth.
    tilted = np.array([[0.2, 0.08], [0.08, 0.06]])
    m = replace(m, flow_cov=np.where((np.arange(25) % 2 == 0)[:, None, None], tilted, m.flow_cov),
                rho_sigma_b=np.where(np.arange(25) % 3 == 0, np.inf, m.rho_sigma_b))
    config = replace(EXACT, reprojection_sigma_px=reprojection_sigma_px)
    start = perturbed(T_true, rng)[None]
    found = refine_motions(start, m, no_lines(), CAMERA, config, ONE, adapt=False)
    T, uv_b = dense_points(m, T_true, config)
    sigma = np.sqrt(np.diag(np.linalg.inv(found.information[0])))
    # The covariance is renewed with the state, its derivative left out: a hundredth of a σ.
    assert np.all(np.abs(se3.log(se3.inverse(T) @ found.T_a_b[0])) < 0.02 * sigma)
    assert_allclose(found.refined_uv_b, uv_b, atol=5e-3)
    assert np.abs(found.refined_uv_b - m.uv_b).max() > 0.1       # there was something to recover


@pytest.mark.parametrize("seed", [0, 1])
def test_lines_have_the_minimum_of_pose_flows_and_depths_together(seed):
    rng = np.random.default_rng(seed)
    T_true = some_motion(rng)
    n = 20
    m = random_lines(rng, T_true, n)
    found = refine_motions(perturbed(T_true, rng)[None], no_points(), m, CAMERA, EXACT, ONE,
                           adapt=False)

    def residual(x):
        T = T_true @ se3.exp(x[:6])
        flow, rho = x[6:6 + 4 * n].reshape(n, 2, 2), x[6 + 4 * n:].reshape(n, 2)
        terms = line_terms(T, pinhole.rays(CAMERA, m.endpoints_a), m.rho_a + rho,
                           m.endpoints_b + flow, CAMERA)
        return np.concatenate([(terms.r / EXACT.line_sigma_px).ravel(),
                               (flow / m.flow_sigma[:, None, None]).ravel(),
                               (rho / m.rho_sigma_a).ravel()])

    x = least_squares(residual, np.zeros(6 + 6 * n), xtol=1e-13, ftol=1e-13, gtol=1e-11,
                      x_scale="jac").x
    T = T_true @ se3.exp(x[:6])
    sigma = np.sqrt(np.diag(np.linalg.inv(found.information[0])))
    assert np.all(np.abs(se3.log(se3.inverse(T) @ found.T_a_b[0])) < 0.05 * sigma)
    assert np.any(np.abs(se3.log(se3.inverse(T) @ T_true)) > 0.3 * sigma)   # not where we began
    flow = x[6:6 + 4 * n].reshape(n, 2, 2)
    assert_allclose(found.refined_endpoints_b, m.endpoints_b + flow, atol=5e-3)
    assert np.abs(flow).max() > 0.1                                # there was something to recover


def test_without_flow_optimisation_the_flow_stays_as_measured():
    rng = np.random.default_rng(5)
    T = some_motion(rng)
    m = random_points(rng, T, 60)
    found = refine_motions(T[None], m, no_lines(), CAMERA, replace(EXACT, optimise_flow=False),
                           ONE, adapt=False)
    assert_allclose(found.refined_uv_b, m.uv_b, atol=0)
    lines = random_lines(rng, T, 10)
    found = refine_motions(T[None], m, lines, CAMERA, replace(EXACT, optimise_flow=False), ONE,
                           adapt=False)
    assert_allclose(found.refined_endpoints_b, lines.endpoints_b, atol=0)


def test_without_flow_optimisation_matches_of_a_kind_weigh_alike():
    rng = np.random.default_rng(6)
    m = random_points(rng, some_motion(rng), 40)
    scale = np.where(np.arange(40) < 10, 4.0, 1.0)
    m = replace(m, flow_cov=m.flow_cov * scale[:, None, None], kind=np.repeat([0, 1], 20))
    family = PointFamily(m, CAMERA, replace(EXACT, optimise_flow=False))
    for kind, middle in ((0, 2.5), (1, 1.0)):
        own = family.flow_cov[m.kind == kind]
        assert_allclose(own, np.broadcast_to(0.09 * middle * np.eye(2), own.shape))


@given(st.integers(0, 2**32 - 1), st.sampled_from([True, False]), st.floats(0.5, 5.0))
@settings(max_examples=40)
def test_the_weight_is_the_derivative_of_the_loss(seed, huber, width):
    chi2 = float(np.random.default_rng(seed).gamma(1.0, 10.0))
    h = 1e-4 * chi2
    slope = (robust(chi2 + h, huber, width)[1] - robust(chi2 - h, huber, width)[1]) / (2 * h)
    assert robust(chi2, huber, width)[0] == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize("huber", [True, False])
def test_kernels_are_quadratic_at_zero_and_give_up_what_is_not_finite(huber):
    weight, loss = robust(1e-8, huber, 3.0)
    assert weight == pytest.approx(1.0)
    assert loss == pytest.approx(1e-8)
    assert robust(float("nan"), huber, 3.0)[0] == 0.0
    assert robust(float("inf"), huber, 3.0)[0] == 0.0


def test_a_match_that_is_not_finite_counts_for_nothing():
    rng = np.random.default_rng(8)
    T = some_motion(rng)
    m = random_points(rng, T, 80)
    bad = m.uv_b.copy()
    bad[7] = np.nan
    start = perturbed(T, rng)[None]
    with_nan = refine_motions(start, replace(m, uv_b=bad), no_lines(), CAMERA, EXACT, ONE, False)
    without = refine_motions(start, taken(m, np.arange(80) != 7), no_lines(), CAMERA, EXACT, ONE,
                             False)
    assert_allclose(with_nan.T_a_b, without.T_a_b, atol=1e-6)
    assert not with_nan.point_chi[7] < EXACT.point_gate
