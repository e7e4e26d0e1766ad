import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from numerics import numerical_jacobian
from slam.geometry import line, se3
from slam.geometry.arrays import ShapeError
from slam.geometry.line import DegenerateLine, OrthonormalLines, PluckerLines
from strategies import (
    plucker_lines,
    reals,
    rigid_transforms,
    unit_vectors,
    vectors,
    world_points,
)

X, Y, Z = np.eye(3)


def one_line(point, direction):
    point, direction = np.asarray(point, dtype=float), np.asarray(direction, dtype=float)
    return line.plucker_from_points(point[None], (point + direction)[None])


def points_on(lines, at_m):
    """The points `at_m` metres along each line from the foot of the origin."""
    return line.feet_of_origin(lines) + at_m * lines.direction


def assert_same_lines(got, wanted, atol=1e-12):
    assert_allclose(got.moment, wanted.moment, atol=atol)
    assert_allclose(got.direction, wanted.direction, atol=atol)


def as_vector(lines):
    """(6,) of one line: moment, direction."""
    return np.concatenate([lines.moment[0], lines.direction[0]])


# Plücker coordinates

def test_a_line_by_hand():
    lines = one_line([0.0, 2.0, 5.0], [3.0, 0.0, 0.0])
    assert_allclose(lines.direction, [[1, 0, 0]])
    assert_allclose(lines.moment, [[0, 5, -2]])
    assert_allclose(line.feet_of_origin(lines), [[0, 2, 5]])


@given(world_points(), vectors(5, 3, limit=5.0).filter(lambda d: (abs(d).max(1) > 1e-3).all()))
def test_both_points_lie_on_their_line(A, along):
    lines = line.plucker_from_points(A, A + along)
    assert len(lines) == 5
    assert_allclose(np.linalg.norm(lines.direction, axis=1), 1.0, atol=1e-14)
    assert_allclose(np.sum(lines.direction * lines.moment, axis=1), 0.0, atol=1e-13)
    assert (np.sum(lines.direction * along, axis=1) > 0.0).all()
    assert_allclose(line.point_line_distance(A, lines), 0.0, atol=1e-12)
    assert_allclose(line.point_line_distance(A + along, lines), 0.0, atol=1e-12)


@pytest.mark.parametrize("B", [[1, 2, 3], [1, 2, 3 + 1e-15], [np.nan, 2, 3], [1, np.inf, 3]])
def test_points_without_a_line_are_refused_by_row(B):
    A = np.array([[0, 0, 0], [1, 2, 3], [5, 5, 5]], dtype=float)
    B = np.array([[1, 0, 0], B, [5, 5, 6]], dtype=float)
    with pytest.raises(DegenerateLine, match=r"1 of 3 pairs .* row 1"):
        line.plucker_from_points(A, B)


def test_no_lines_at_all():
    lines = line.plucker_from_points(np.zeros((0, 3)), np.zeros((0, 3)))
    back = line.plucker_from_orthonormal(line.orthonormal_from_plucker(lines))
    assert len(back) == 0
    assert line.line_line_distance(lines, back).shape == (0,)
    assert line.plucker_jacobian(line.orthonormal_from_plucker(lines)).shape == (0, 6, 4)


@given(rigid_transforms(), plucker_lines())
def test_moving_a_line_moves_its_points(T_b_a, lines_a):
    lines_b = line.transform_lines(T_b_a, lines_a)
    A, B = (se3.transform_points(T_b_a, points_on(lines_a, at)) for at in (-1.0, 2.0))
    assert_same_lines(lines_b, line.plucker_from_points(A, B), atol=1e-11)


@given(rigid_transforms(), rigid_transforms(), plucker_lines())
def test_moving_lines_is_a_group_action(T_c_b, T_b_a, lines):
    twice = line.transform_lines(T_c_b, line.transform_lines(T_b_a, lines))
    assert_same_lines(twice, line.transform_lines(T_c_b @ T_b_a, lines), atol=1e-11)


def test_wrong_shapes_are_named():
    lines = one_line([0, 1, 0], X)
    with pytest.raises(ShapeError, match=r"T_b_a: wanted shape \(4, 4\), got \(3, 4\)"):
        line.transform_lines(np.eye(4)[:3], lines)
    with pytest.raises(ShapeError, match=r"points: wanted shape \(1, 3\), got \(3,\)"):
        line.point_line_distance(np.zeros(3), lines)
    with pytest.raises(ShapeError, match=r"delta: wanted shape \(1, 4\), got \(1, 6\)"):
        line.update(line.orthonormal_from_plucker(lines), np.zeros((1, 6)))
    with pytest.raises(ShapeError, match=r"B: wanted shape \(N=2, 3\), got \(1, 3\)"):
        line.plucker_from_points(np.zeros((2, 3)), np.ones((1, 3)))


# The orthonormal representation

@given(plucker_lines(reach_m=100.0))
def test_orthonormal_round_trip(lines):
    there = line.orthonormal_from_plucker(lines)
    R = there.rotation
    assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    assert_allclose(np.linalg.det(R), 1.0, atol=1e-13)
    back = line.plucker_from_orthonormal(there)
    assert_same_lines(back, lines, atol=1e-11)
    assert_allclose(np.linalg.norm(back.direction, axis=1), 1.0, atol=1e-13)


@given(unit_vectors(), st.floats(-18.0, -6.0).map(lambda e: 10.0**e), unit_vectors())
def test_round_trip_of_lines_at_and_near_the_origin(U, offset, aside):
    lines = PluckerLines(moment=np.stack([np.zeros(3), np.cross(offset * aside, U), offset * U]),
                         direction=np.stack([U, U, U]))   # the last: rounding along U
    there = line.orthonormal_from_plucker(lines)
    R = there.rotation
    assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    back = line.plucker_from_orthonormal(there)
    assert_allclose(back.direction, lines.direction, atol=1e-14)
    assert_allclose(back.moment[:2], lines.moment[:2], atol=2e-12)
    assert_allclose(back.moment[2], 0.0, atol=2e-12)
    assert_allclose(there.angle_rad[0], np.pi / 2, atol=1e-15)


@given(unit_vectors(), unit_vectors(), st.floats(3.0, 8.0).map(lambda e: 10.0**e))
def test_round_trip_of_far_lines_keeps_its_digits(U, aside, distance_m):
    lines = one_line(distance_m * aside, U * distance_m)
    back = line.plucker_from_orthonormal(line.orthonormal_from_plucker(lines))
    assert_allclose(back.moment, lines.moment, atol=1e-12 * distance_m)
    assert_allclose(back.direction, lines.direction, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, -0.0, 1e-12, np.pi, -1e-12, np.pi - 1e-14])
def test_a_line_at_infinity_stays_finite(angle):
    """w₂ → 0: the line is put 1e9 m away, with a derivative that has numbers in it."""
    lines = OrthonormalLines(rotation=np.eye(3)[None], angle_rad=np.array([angle]))
    plucker = line.plucker_from_orthonormal(lines)
    assert_allclose(np.linalg.norm(plucker.moment), 1e9, rtol=1e-6)
    assert_allclose(plucker.direction, [Y])
    assert np.isfinite(line.plucker_jacobian(lines)).all()


@given(plucker_lines(), vectors(5, 4, limit=1.0))
def test_an_update_leaves_a_line_a_line(lines, delta):
    moved = line.update(line.orthonormal_from_plucker(lines), delta)
    R = moved.rotation
    assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-13)
    plucker = line.plucker_from_orthonormal(moved)
    size = 1.0 + np.linalg.norm(plucker.moment, axis=1)
    assert_allclose(np.linalg.norm(plucker.direction, axis=1), 1.0, atol=1e-13)
    assert_allclose(np.sum(plucker.moment * plucker.direction, axis=1) / size, 0.0, atol=1e-13)


@given(plucker_lines())
def test_no_update_is_no_motion(lines):
    start = line.orthonormal_from_plucker(lines)
    same = line.update(start, np.zeros((5, 4)))
    assert_allclose(same.rotation, start.rotation, atol=1e-15)
    assert_allclose(same.angle_rad, start.angle_rad)


def numeric_line_jacobian(start, step):
    return numerical_jacobian(
        lambda d: as_vector(line.plucker_from_orthonormal(line.update(start, d[None]))),
        at=4, step=step)


@given(plucker_lines(count=1))
def test_jacobian(lines):
    start = line.orthonormal_from_plucker(lines)
    size = 1.0 + np.sum(lines.moment**2)     # ∂N/∂φ grows with the square of the distance
    assert_allclose(line.plucker_jacobian(start)[0], numeric_line_jacobian(start, 1e-6),
                    atol=1e-7 * size)


@given(unit_vectors())
def test_jacobian_at_the_origin(U):
    start = line.orthonormal_from_plucker(PluckerLines(np.zeros((1, 3)), U[None]))
    J = line.plucker_jacobian(start)[0]
    assert_allclose(J, numeric_line_jacobian(start, 1e-6), atol=1e-9)
    assert np.linalg.matrix_rank(J, tol=1e-9) == 3   # as its docstring says


@given(unit_vectors(), unit_vectors(), st.floats(2.0, 6.0).map(lambda e: 10.0**e))
def test_jacobian_of_far_lines(U, aside, distance_m):
    start = line.orthonormal_from_plucker(one_line(distance_m * aside, distance_m * U))
    distance = 1.0 / np.tan(start.angle_rad[0])
    J = line.plucker_jacobian(start)[0]
    numeric = numeric_line_jacobian(start, 1e-4 / (1.0 + distance))   # far inside the angle
    assert_allclose(J[:3] / (1.0 + distance**2), numeric[:3] / (1.0 + distance**2), atol=1e-6)
    assert_allclose(J[3:], numeric[3:], atol=1e-3)


@given(plucker_lines(count=1).filter(lambda lines: np.linalg.norm(lines.moment) > 0.1))
def test_away_from_the_origin_the_four_parameters_reach_every_line(lines):
    J = line.plucker_jacobian(line.orthonormal_from_plucker(lines))[0]
    assert np.linalg.matrix_rank(J, tol=1e-6) == 4


# Distances

@given(world_points(), plucker_lines())
def test_foot_and_distance_against_the_nearest_of_many_points(points, lines):
    foot = line.closest_points_on_line(points, lines)
    distance = line.point_line_distance(points, lines)
    assert_allclose(line.point_line_distance(foot, lines), 0.0, atol=1e-11)
    assert_allclose(np.linalg.norm(points - foot, axis=1), distance, atol=1e-11)
    along = np.linspace(-40.0, 40.0, 8001)[:, None, None]
    brute = np.linalg.norm(points_on(lines, along) - points, axis=-1).min(axis=0)
    assert (distance <= brute + 1e-11).all()
    assert_allclose(distance, brute, atol=6e-3)   # half a step, taken straight along the line


@given(plucker_lines())
def test_the_moment_is_the_distance_to_the_origin(lines):
    assert_allclose(np.linalg.norm(line.feet_of_origin(lines), axis=1),
                    np.linalg.norm(lines.moment, axis=1), atol=1e-12)


def brute_distance(first, second):
    """Least distance of two lines over both their arc lengths, by a general minimiser."""
    def gap(at):
        return float(np.sum((points_on(first, at[0]) - points_on(second, at[1])) ** 2))
    return float(np.sqrt(minimize(gap, np.zeros(2), method="BFGS", tol=1e-12).fun))


@given(plucker_lines(count=1), plucker_lines(count=1))
def test_line_distance_against_a_minimiser(first, second):
    sine = np.linalg.norm(np.cross(first.direction, second.direction))
    if sine < 0.05:     # there the minimiser is the worse of the two
        return
    assert_allclose(line.line_line_distance(first, second)[0], brute_distance(first, second),
                    atol=1e-5)


@given(unit_vectors(), unit_vectors(), reals(5.0), vectors(3, limit=20.0), st.floats(-7.0, 0.0))
def test_skew_lines_of_known_distance_down_to_the_smallest_angle(U, aside, gap, origin, exponent):
    """Two lines with a common perpendicular of known length, 1e-7 rad apart or more."""
    normal = np.cross(U, aside)
    if np.linalg.norm(normal) < 0.1:
        return
    normal /= np.linalg.norm(normal)
    angle = 10.0**exponent
    turned = np.cos(angle) * U + np.sin(angle) * np.cross(normal, U)
    first = one_line(origin - 3.0 * U, 2.0 * U)
    second = one_line(origin + gap * normal + 5.0 * turned, turned)
    # The two unit vectors are rounded to 1e-16, so their normal is known to 1e-16 / angle.
    bound = 1e-13 + 1e-14 / angle
    assert_allclose(line.line_line_distance(first, second), abs(gap), atol=bound * 50.0)
    assert_allclose(line.line_line_distance(second, first), abs(gap), atol=bound * 50.0)


@given(unit_vectors(), world_points(2), st.sampled_from([1.0, -1.0]))
def test_parallel_lines_either_way(U, points, sign):
    first, second = one_line(points[0], U), one_line(points[1], sign * U)
    between = np.linalg.norm(np.cross(points[1] - points[0], U))
    assert_allclose(line.line_line_distance(first, second), between, atol=1e-11)
    paper = np.cross(first.direction, first.moment - second.moment / sign)
    assert_allclose(np.linalg.norm(paper), between, atol=1e-11)


@given(plucker_lines(), plucker_lines(), rigid_transforms())
def test_distance_does_not_depend_on_the_frame(first, second, T):
    sine = np.linalg.norm(np.cross(first.direction, second.direction), axis=1)
    moved = line.line_line_distance(line.transform_lines(T, first), line.transform_lines(T, second))
    still = line.line_line_distance(first, second)
    assert_allclose(moved[sine > 1e-3], still[sine > 1e-3], atol=1e-9)


@given(plucker_lines(), plucker_lines())
def test_the_papers_form_where_it_holds(first, second):
    sine = np.linalg.norm(np.cross(first.direction, second.direction), axis=1)
    paper = np.abs(np.sum(first.direction * second.moment, axis=1)
                   + np.sum(second.direction * first.moment, axis=1))
    ours = line.line_line_distance(first, second)
    assert_allclose((ours * sine)[sine > 1e-3], paper[sine > 1e-3], atol=1e-11)


@given(plucker_lines())
def test_a_line_is_at_no_distance_from_itself(lines):
    turned_over = PluckerLines(moment=-lines.moment, direction=-lines.direction)
    assert_allclose(line.line_line_distance(lines, lines), 0.0, atol=1e-13)
    assert_allclose(line.line_line_distance(lines, turned_over), 0.0, atol=1e-13)
