"""Lines as the camera measures them: values, derivatives, degenerate views."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from numerics import numerical_jacobian
from slam import line_factors
from slam import line_sightings as ls
from slam.geometry import camera as pinhole
from slam.geometry import line, se3
from slam.types import Intrinsics
from strategies import plucker_lines, rigid_transforms, vectors

CAMERA = Intrinsics(500.0, 520.0, 319.5, 239.5, 640, 480)
N = 4


def seen(A, B):
    """Lines through points A, B (N, 3) in the camera, and the ends as they are seen exactly."""
    ends = np.stack([pinhole.project(CAMERA, A), pinhole.project(CAMERA, B)], axis=1)
    return line.plucker_from_points(A, B), ends, 1.0 / np.stack([A[:, 2], B[:, 2]], axis=1)


def in_body(T, lines):
    return ls.packed(line.orthonormal_from_plucker(line.transform_lines(T, lines)))


@given(rigid_transforms(reach_m=3.0), vectors(N, 2, limit=0.6), vectors(N, 2, limit=0.6),
       st.floats(0.5, 10.0), st.integers(0, 999))
@settings(max_examples=40, deadline=None)
def test_terms_and_their_jacobians(T, start, along, depth, seed):
    rng = np.random.default_rng(seed)
    A = np.concatenate([start, np.ones((N, 1))], axis=1) * depth
    # 10 px long at least, nowhere near end on.
    turn = np.where(np.linalg.norm(along, axis=1, keepdims=True) > 0.05, along, [0.1, 0.05])
    B = A + np.concatenate([turn, rng.uniform(-0.02, 0.02, (N, 1))], axis=1) * depth
    lines, ends, rho = seen(A, B)
    poses, packed = np.repeat(T[None], N, 0), in_body(T, lines)
    exact = ls.line_sighting_terms(poses, packed, ends, rho, CAMERA)
    assert_allclose(exact.r[:, :2], 0.0, atol=1e-6)
    assert_allclose(exact.r[:, 2:], 0.0, atol=1e-8)
    # Observed a little beside it.
    ends, rho = ends + rng.normal(size=ends.shape) * 0.5, rho * rng.uniform(0.9, 1.1, rho.shape)

    def at(T=T, packed=packed):
        return ls.line_sighting_terms(np.repeat(T[None], N, 0), packed, ends, rho, CAMERA)

    terms = at()
    # The whole differences' own rounding is of the size of the values over the step.
    J = numerical_jacobian(lambda d: at(T=T @ se3.exp(d)).r, 6)
    assert_allclose(terms.J_pose, J, rtol=1e-4, atol=1e-4 * np.abs(J).max())
    V = numerical_jacobian(lambda d: at(packed=ls.moved_lines(packed, np.tile(d, (N, 1)))).r, 4)
    assert_allclose(terms.J_line, V, rtol=1e-4, atol=1e-4 * np.abs(V).max())


def test_distance_is_that_of_the_observed_ends_and_depth_that_of_the_line():
    A, B = np.array([[-1.0, 0.5, 4.0]]), np.array([[1.0, 0.2, 6.0]])
    lines, ends, rho = seen(A, B)
    along = ends[:, 1] - ends[:, 0]
    normal = np.array([[-along[0, 1], along[0, 0]]]) / np.linalg.norm(along)
    moved = ends + normal[:, None] * [[[2.0], [3.0]]]
    slid = moved + 0.2 * along[:, None]          # sliding along the line is no error
    packed = in_body(np.eye(4), lines)
    r = ls.line_sighting_terms(np.eye(4)[None], packed, moved, rho, CAMERA).r[0]
    assert_allclose(np.abs(r[:2]), [2.0, 3.0], rtol=1e-9)
    # Across the observed line, which is turned by a pixel: nearly the same place.
    assert_allclose(r[2:], 0.0, atol=1e-4)
    r = ls.line_sighting_terms(np.eye(4)[None], packed, slid, rho, CAMERA).r[0]
    assert_allclose(np.abs(r[:2]), [2.0, 3.0], rtol=1e-9)


@pytest.mark.parametrize("case", ["end on", "behind", "no length", "at infinity"])
def test_what_cannot_be_seen_says_so_and_stays_finite(case):
    A, B = np.array([[0.3, 0.2, 2.0]]), np.array([[0.6, 0.1, 2.5]])
    lines, ends, rho = seen(A, B)
    packed = in_body(np.eye(4), lines)
    if case == "end on":                          # through the camera's centre
        packed = in_body(np.eye(4), line.plucker_from_points(A, 2.0 * A))
    elif case == "behind":
        packed = in_body(np.eye(4), line.plucker_from_points(A * [1, 1, -1], B * [1, 1, -1]))
    elif case == "no length":
        ends = np.repeat(ends[:, :1], 2, axis=1)
    elif case == "at infinity":
        packed[:, 9] = 0.0
    terms = ls.line_sighting_terms(np.eye(4)[None], packed, ends, rho, CAMERA)
    if case == "at infinity":                     # still a line in the image
        assert np.isfinite(terms.r).all()
    else:
        assert np.isnan(terms.r).all()
    assert np.isfinite(terms.J_pose).all()
    assert np.isfinite(terms.J_line).all()


@given(rigid_transforms(3.0), st.booleans(), plucker_lines(N), vectors(N, 2, 3, limit=5.0))
@settings(max_examples=30, deadline=None)
def test_the_printed_form_in_loops_is_that_in_arrays(T, at_solution, plucker, ends):
    """Through the origin, too, and where the lengths are 0 and have no derivative."""
    plucker = line.PluckerLines(np.where(np.arange(N)[:, None] % 2, 0.0, plucker.moment),
                                plucker.direction)
    if at_solution:
        seen = line.transform_lines(se3.inverse(T), plucker)
        ends = np.stack([line.feet_of_origin(seen), line.feet_of_origin(seen)], axis=1)
        ends[:, 1] += seen.direction
    lines, by = line.orthonormal_from_plucker(plucker), np.empty((6, 11))
    wanted = line_factors.line_measurement_paper(np.repeat(T[None], N, 0), lines, ends)
    for i, packed in enumerate(ls.packed(lines)):
        r, J, V = np.ones(2), np.ones((2, 6)), np.ones((2, 4))
        ls.line_distance_row(T, packed, ends[i], r, J, V, by)
        assert_allclose(r, wanted.r[i], atol=1e-9)
        there = (wanted.r[i] > 1e-6)[:, None]            # of shorter ones the direction is rounding
        assert_allclose(np.where(there, J, 0), np.where(there, wanted.J_pose[i], 0), atol=1e-8)
        assert_allclose(np.where(there, V, 0), np.where(there, wanted.J_line[i], 0), atol=1e-6)
        assert np.isfinite([*J.flat, *V.flat]).all()


def test_ends_in_metres_are_as_far_off_as_their_noise():
    rng, n = np.random.default_rng(0), 20_000
    A, B = np.array([[-0.4, 0.1, 2.0]]), np.array([[0.4, 0.1, 2.0]])    # across the view
    lines, ends, rho = seen(A, B)
    normal = np.array([0.0, 1.0])
    noisy = ends + 0.5 * rng.normal(size=(n, 2, 1)) * normal
    metres, sigma = ls.ends_in_metres(noisy, np.broadcast_to(0.25 * np.eye(2), (n, 2, 2)),
                                      rho + 1e-3 * rng.normal(size=(n, 2)), np.full((n, 2), 1e-3),
                                      CAMERA)
    for end in range(2):
        every = line.PluckerLines(np.repeat(lines.moment, n, 0), np.repeat(lines.direction, n, 0))
        off = line.point_line_distance(metres[:, end], every)
        assert_allclose(np.sqrt(np.mean(off**2)), sigma[:, end].mean(), rtol=0.05)
    unknown = ls.ends_in_metres(ends, 0.25 * np.eye(2)[None], 0.0 * rho, np.full((1, 2), np.inf),
                                CAMERA)
    assert np.isinf(unknown[1]).all()
    assert np.isfinite(unknown[0]).all()


def test_a_line_reaches_from_one_observed_end_to_the_other():
    A = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 3.0], [0.0, 1.0, 4.0]])
    B = A + np.diag([1.0, 2.0, 3.0])
    lines = ls.packed(line.orthonormal_from_plucker(line.plucker_from_points(A, B)))
    landmark = np.array([0, 0, 0, 1, 1])
    ends = np.stack([A, B], axis=1)[landmark]
    ends[0] += [0.0, 0.3, 0.0]               # beside the line
    ends[1, 0] = [-9.0, 0.0, 2.0]            # slid far along it: of three, the middle one counts
    ends[4] = np.nan                         # without depth
    found = ls.seen_stretches(lines, landmark, ends)
    assert_allclose(found[:2], np.stack([A, B], axis=1)[:2], atol=1e-12)
    assert np.isnan(found[2]).all()


@given(plucker_lines(N), vectors(N, 4, limit=0.5))
@settings(max_examples=40, deadline=None)
def test_moved_lines_are_updated_lines_and_back(lines, delta):
    orthonormal = line.orthonormal_from_plucker(lines)
    packed = ls.packed(orthonormal)
    moved = ls.moved_lines(packed, delta)
    wanted = line.update(orthonormal, delta)
    assert_allclose(ls.unpacked(moved).rotation, wanted.rotation, atol=1e-12)
    assert_allclose(ls.unpacked(moved).angle_rad, wanted.angle_rad, atol=1e-12)
    assert_allclose(ls.change_of_lines(packed, moved), delta, atol=1e-9)
