"""Every Jacobian of the back-end against numerical differentiation, degenerate states included."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from numerics import numerical_jacobian
from slam import factors, line_factors
from slam.geometry import camera as pinhole
from slam.geometry import line, se3
from slam.geometry.line import PluckerLines
from slam.geometry.se3_jacobian import right_jacobian, right_jacobian_inverse
from slam.types import Intrinsics
from strategies import plucker_lines, rigid_transforms, vectors, world_points

CAMERA = Intrinsics(500.0, 520.0, 319.5, 239.5, 640, 480)
N = 4
REST = np.zeros(4)


def near(T, sizes, seed):
    """A pose close to T."""
    return T @ se3.exp(np.random.default_rng(seed).normal(size=6) * sizes)


def repeated(T):
    return np.repeat(T[None], N, axis=0)


def by_own(function, size):
    """Derivative of row n by variable n, for a `function` of one vector shared by all rows."""
    return numerical_jacobian(function, size)


@given(vectors(6, limit=2.0))
@settings(max_examples=40, deadline=None)
def test_right_jacobian(xi):
    numeric = numerical_jacobian(lambda d: se3.log(se3.inverse(se3.exp(xi)) @ se3.exp(xi + d)))
    assert_allclose(right_jacobian(xi), numeric, atol=1e-6)
    assert_allclose(right_jacobian_inverse(xi) @ right_jacobian(xi), np.eye(6), atol=1e-9)


@given(rigid_transforms(), vectors(N, 2, limit=1.0), st.floats(0.5, 80.0), st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_landmark_terms(T, slopes, depth, seed):
    p = np.concatenate([slopes, np.ones((N, 1))], axis=1) * depth
    xyz = se3.transform_points(T, p)
    rng = np.random.default_rng(seed)
    uv, rho = rng.uniform(0, 640, (N, 2)), rng.uniform(0.01, 1.0, N)

    def at(T=T, xyz=xyz):
        return factors.landmark_terms(repeated(T), xyz, uv, rho, CAMERA)

    terms = at()
    assert_allclose(terms.r[:, :2], pinhole.project(CAMERA, p) - uv, atol=1e-6)
    assert_allclose(terms.r[:, 2], 1.0 / p[:, 2] - rho, atol=1e-9)
    J = by_own(lambda d: at(T=T @ se3.exp(d)).r, 6)
    assert_allclose(terms.J_pose, J, rtol=1e-5, atol=1e-3)
    V = by_own(lambda d: at(xyz=xyz + d).r, 3)
    assert_allclose(terms.J_point, V, rtol=1e-5, atol=1e-3)


def test_a_point_without_an_image_says_so():
    xyz = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    terms = factors.landmark_terms(np.repeat(np.eye(4)[None], 3, 0), xyz, np.zeros((3, 2)),
                                   np.zeros(3), CAMERA)
    assert np.isnan(terms.r[:2]).all()
    assert np.isfinite(terms.r[2]).all()


@given(rigid_transforms(), world_points(N))
@settings(max_examples=40, deadline=None)
def test_landmark_terms_metric(T, xyz):
    def at(T=T, xyz=xyz):
        return factors.landmark_terms_metric(repeated(T), xyz, np.ones((N, 3)))

    assert_allclose(at().J_pose, by_own(lambda d: at(T=T @ se3.exp(d)).r, 6), atol=1e-6)
    assert_allclose(at().J_point, by_own(lambda d: at(xyz=xyz + d).r, 3), atol=1e-6)


@given(rigid_transforms(), rigid_transforms(), st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_odometry_terms(A, B, seed):
    Z = near(se3.inverse(A) @ B, 0.3, seed)

    def at(A=A, B=B):
        return factors.odometry_terms(A[None], B[None], Z[None])

    assert_allclose(at().J_first, by_own(lambda d: at(A=A @ se3.exp(d)).r, 6), atol=1e-5)
    assert_allclose(at().J_second, by_own(lambda d: at(B=B @ se3.exp(d)).r, 6), atol=1e-5)
    exact = factors.odometry_terms(A[None], B[None], (se3.inverse(A) @ B)[None])
    assert_allclose(exact.r, 0.0, atol=1e-7)


@given(rigid_transforms(), world_points(N), world_points(N))
@settings(max_examples=40, deadline=None)
def test_point_motion_terms(H, before, now):
    def at(H=H, before=before, now=now):
        return factors.point_motion_terms(repeated(H), before, now)

    assert_allclose(at().J_H, by_own(lambda d: at(H=H @ se3.exp(d)).r, 6), atol=1e-6)
    assert_allclose(at().J_before, by_own(lambda d: at(before=before + d).r, 3), atol=1e-6)
    assert_allclose(at().J_now, by_own(lambda d: at(now=now + d).r, 3), atol=1e-6)


@given(rigid_transforms(), vectors(3, limit=100.0), vectors(3, limit=1.0), st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_smooth_motion_terms(H, centroid, step, seed):
    H_now = near(H, 0.3, seed)

    def at(H=H, H_now=H_now):
        return factors.smooth_motion_terms(H[None], H_now[None], centroid[None],
                                           (centroid + step)[None])

    assert_allclose(at().J_first, by_own(lambda d: at(H=H @ se3.exp(d)).r, 6), atol=2e-4)
    assert_allclose(at().J_second, by_own(lambda d: at(H_now=H_now @ se3.exp(d)).r, 6), atol=2e-4)


def test_smooth_motion_does_not_depend_on_where_the_world_begins():
    about = se3.exp(np.array([0.0, 0.0, 0.1, 0.02, 0.0, 0.0]))     # motion about the centroid
    strengths = []
    for origin in (np.zeros(3), np.array([100.0, 0.0, 0.0])):
        D = se3.from_rotation_translation(np.eye(3), origin)
        H = D @ about @ se3.inverse(D)
        r = factors.smooth_motion_terms(np.eye(4)[None], H[None], origin[None], origin[None]).r
        strengths.append(r)
    assert_allclose(strengths[0], strengths[1], atol=1e-10)


line_sets = st.one_of(plucker_lines(N, 5.0), plucker_lines(N, 5.0).map(
    lambda lines: PluckerLines(np.zeros((N, 3)), lines.direction)))      # through the origin


@given(rigid_transforms(5.0), line_sets, vectors(N, 2, 3, limit=5.0))
@settings(max_examples=40, deadline=None)
def test_line_measurement(T, plucker, endpoints):
    lines = line.orthonormal_from_plucker(plucker)
    basis = line_factors.across(line_factors.in_camera(repeated(T), lines)[0].direction)

    def at(T=T, delta=REST):
        return line_factors.line_measurement(
            repeated(T), line.update(lines, np.tile(delta, (N, 1))), endpoints, basis)

    terms = at()
    assert_allclose(terms.J_pose, by_own(lambda d: at(T=T @ se3.exp(d)).r, 6), atol=1e-5)
    assert_allclose(terms.J_line, by_own(lambda d: at(delta=d).r, 4), rtol=1e-5, atol=1e-4)
    paper = line_factors.line_measurement_paper(repeated(T), lines, endpoints)
    assert_allclose(np.linalg.norm(terms.r.reshape(N, 2, 2), axis=2), paper.r, atol=1e-7)


@given(rigid_transforms(5.0), line_sets, vectors(N, 2, 3, limit=5.0))
@settings(max_examples=40, deadline=None)
def test_line_measurement_paper(T, plucker, endpoints):
    lines = line.orthonormal_from_plucker(plucker)

    def at(T=T, delta=REST):
        return line_factors.line_measurement_paper(
            repeated(T), line.update(lines, np.tile(delta, (N, 1))), endpoints)

    terms = at()
    smooth = terms.r[..., None] > 0.05       # a norm has no derivative at 0
    J = by_own(lambda d: at(T=T @ se3.exp(d)).r, 6)
    assert_allclose(np.where(smooth, terms.J_pose, 0), np.where(smooth, J, 0), atol=1e-4)
    J = by_own(lambda d: at(delta=d).r, 4)
    assert_allclose(np.where(smooth, terms.J_line, 0), np.where(smooth, J, 0), rtol=1e-4,
                    atol=1e-3)


def test_line_measurement_at_its_solution_has_a_gradient_where_the_paper_has_none():
    A, B = np.array([[0.3, 0.1, 3.0]]), np.array([[1.3, 0.4, 4.0]])
    lines = line.orthonormal_from_plucker(line.plucker_from_points(A, B))
    T, ends = np.eye(4)[None], np.stack([A, B], axis=1)
    ours = line_factors.line_measurement(T, lines, ends)
    paper = line_factors.line_measurement_paper(T, lines, ends)
    assert_allclose(ours.r, 0.0, atol=1e-12)
    assert np.linalg.matrix_rank(ours.J_line[0], tol=1e-6) == 4
    assert_allclose(paper.J_line, 0.0)


def test_line_measurement_covariance():
    rng = np.random.default_rng(0)
    A, B = rng.normal([0, 0, 4], size=(2, 1, 3))
    lines = line.orthonormal_from_plucker(line.plucker_from_points(A, B))
    root = rng.normal(size=(2, 3, 3)) * 0.01
    noise = np.einsum("eij,sej->sei", root, rng.normal(size=(100_000, 2, 3)))
    direction = line.plucker_from_orthonormal(lines).direction
    basis = line_factors.across(direction)
    many = type(lines)(np.repeat(lines.rotation, len(noise), 0),
                       np.repeat(lines.angle_rad, len(noise), 0))
    r = line_factors.line_measurement(np.broadcast_to(np.eye(4), (len(noise), 4, 4)), many,
                                      np.stack([A, B], 1) + noise,
                                      np.repeat(basis, len(noise), 0)).r.reshape(-1, 2, 2)
    expected = line_factors.line_measurement_covariance(
        direction, basis, (root @ np.swapaxes(root, 1, 2))[None])[0]
    measured = np.einsum("sei,sej->eij", r, r) / len(noise)
    assert_allclose(measured, expected, atol=0.02 * np.abs(expected).max())


@given(rigid_transforms(3.0), line_sets, vectors(N, 2, 3, limit=5.0), st.sampled_from([0.0, 0.2]),
       st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_line_motion(H, plucker, endpoints, change, seed):
    """At the solution (change 0), where the lines are parallel, and away from it."""
    before = line.orthonormal_from_plucker(plucker)
    delta = np.random.default_rng(seed).normal(size=(N, 4)) * change
    now = line.update(line.orthonormal_from_plucker(line.transform_lines(H, plucker)), delta)
    basis = line_factors.across(line.plucker_from_orthonormal(now).direction)

    def at(H=H, first=REST, last=REST):
        return line_factors.line_motion(
            repeated(H), line.update(before, np.tile(first, (N, 1))),
            line.update(now, np.tile(last, (N, 1))), endpoints, basis)

    terms = at()
    if change == 0.0:
        assert_allclose(terms.r, 0.0, atol=1e-9)
    assert_allclose(terms.J_H, by_own(lambda d: at(H=H @ se3.exp(d)).r, 6), rtol=1e-4, atol=1e-4)
    assert_allclose(terms.J_before, by_own(lambda d: at(first=d).r, 4), rtol=1e-4, atol=1e-3)
    J_now = by_own(lambda d: at(last=d).r, 4)
    assert_allclose(terms.J_now, J_now, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_line_motion_paper(seed):
    rng = np.random.default_rng(seed)
    H = se3.exp(rng.normal(size=6) * 0.3)
    A, B = rng.normal(size=(N, 3)) * 2, rng.normal(size=(N, 3)) * 2
    before = line.orthonormal_from_plucker(line.plucker_from_points(A, B))
    now = line.orthonormal_from_plucker(line.plucker_from_points(
        rng.normal(size=(N, 3)) * 2, rng.normal(size=(N, 3)) * 2))

    def at(H=H, first=REST, last=REST):
        return line_factors.line_motion_paper(
            repeated(H), line.update(before, np.tile(first, (N, 1))),
            line.update(now, np.tile(last, (N, 1))))

    terms = at()
    expected = line.line_line_distance(
        line.plucker_from_orthonormal(now),
        line.transform_lines(H, line.plucker_from_orthonormal(before)))
    assert_allclose(terms.r[:, 0], expected, atol=1e-9)
    assert_allclose(terms.J_H, by_own(lambda d: at(H=H @ se3.exp(d)).r, 6), rtol=1e-4, atol=1e-4)
    assert_allclose(terms.J_before, by_own(lambda d: at(first=d).r, 4), rtol=1e-4, atol=1e-3)
    assert_allclose(terms.J_now, by_own(lambda d: at(last=d).r, 4), rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("seed", range(4))
def test_line_motion_paper_between_parallel_lines(sign, seed):
    """The other branch of dist: lines the same way or opposite ways, some distance apart."""
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(2, N, 3)) * 2
    before = line.orthonormal_from_plucker(line.plucker_from_points(A, B))
    H = se3.exp(rng.normal(size=6) * 0.3)
    aside = rng.normal(size=(N, 3))
    ends = se3.transform_points(H, A) + aside, se3.transform_points(H, B) + aside
    now = line.orthonormal_from_plucker(line.plucker_from_points(*ends[::int(sign)]))

    def at(v):
        return line_factors.line_motion_paper(
            repeated(se3.from_rotation_translation(H[:3, :3], H[:3, 3] + v)), before, now).r

    terms = line_factors.line_motion_paper(repeated(H), before, now)
    across = line.plucker_from_orthonormal(now).direction
    wanted = np.linalg.norm(aside - np.sum(aside * across, axis=1)[:, None] * across, axis=1)
    assert_allclose(terms.r[:, 0], wanted, atol=1e-9)
    assert_allclose(terms.r[:, 1], 1.0 - sign, atol=1e-12)
    # Turned, the lines are no longer parallel: only along translations has dist a derivative.
    assert_allclose(terms.J_H[:, :, 3:], by_own(lambda d: at(H[:3, :3] @ d), 3), atol=1e-5)
    assert all(np.isfinite(J).all() for J in terms[1:])


def test_line_motion_paper_has_no_gradient_at_its_solution_and_ours_has():
    A, B = np.array([[0.3, 0.1, 3.0]]), np.array([[1.3, 0.4, 4.0]])
    plucker = line.plucker_from_points(A, B)
    H = se3.exp(np.array([0.1, 0.2, -0.1, 0.3, 0.1, 0.2]))[None]
    before = line.orthonormal_from_plucker(plucker)
    now = line.orthonormal_from_plucker(line.transform_lines(H[0], plucker))
    paper = line_factors.line_motion_paper(H, before, now)
    ours = line_factors.line_motion(H, before, now, np.stack([A, B], axis=1))
    assert_allclose(paper.J_H[0, 1], 0.0, atol=1e-9)
    assert np.isfinite(paper.J_H).all()
    assert np.linalg.matrix_rank(ours.J_H[0], tol=1e-6) == 4
