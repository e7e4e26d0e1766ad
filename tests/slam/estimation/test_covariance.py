"""Covariances of motions against draws of their errors, and robust ones against theory."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slam.estimation.covariance import (
    clustering,
    covariance_of,
    known_or_none,
    moved_covariance,
    object_covariance,
    sharing,
)
from slam.estimation.kernel import kernel_effect
from slam.geometry import se3


def some_covariance(rng, size=1e-3):
    root = size * rng.normal(size=(6, 6))
    return root @ root.T


def test_the_inverse_of_information_however_its_units_differ():
    scale = np.diag([1e4, 1e4, 1e4, 1.0, 1.0, 1.0])
    information = scale @ np.linalg.inv(some_covariance(np.random.default_rng(0), 1.0)) @ scale
    assert_allclose(covariance_of(information) @ information, np.eye(6), atol=1e-6)


@pytest.mark.parametrize("information", [
    np.zeros((6, 6)), np.diag([1.0, 1, 1, 1, 1, 0]), np.full((6, 6), np.nan),
    np.ones((6, 6)), np.diag([1.0, 1, 1, 1, 1, -1])])
def test_what_leaves_a_direction_unknown_has_no_covariance(information):
    both = covariance_of(np.stack([information, np.eye(6)]))
    assert np.isnan(both[0]).all()
    assert_allclose(both[1], np.eye(6), atol=1e-12)
    of_objects = object_covariance(np.eye(4), np.eye(4), np.eye(6), both)
    assert known_or_none(of_objects[0]) is None
    assert_allclose(known_or_none(of_objects[1]), 2.0 * np.eye(6), atol=1e-12)


def test_an_objects_covariance_is_that_of_draws_of_both_poses():
    rng = np.random.default_rng(1)
    T_camera, T_object = se3.exp(0.2 * rng.normal(size=(2, 6)))
    X = se3.exp(np.array([0.3, -0.2, 0.5, 3.0, -2.0, 5.0]))
    P_camera, P_object = some_covariance(rng), some_covariance(rng)

    def motion(xi_camera, xi_object):
        relative = (T_camera @ se3.exp(xi_camera)) @ se3.inverse(T_object @ se3.exp(xi_object))
        return X @ relative @ se3.inverse(X)

    n = 20_000
    draws = [rng.normal(size=(n, 6)) @ np.linalg.cholesky(P).T for P in (P_camera, P_object)]
    error = se3.log(se3.inverse(motion(np.zeros(6), np.zeros(6))) @ motion(*draws))
    stated = object_covariance(X, T_object, P_camera, P_object)
    whitened = np.linalg.solve(np.linalg.cholesky(stated), error.T)
    assert_allclose(whitened @ whitened.T / n, np.eye(6), atol=0.06)   # 6 deviations of draws


def test_moving_a_covariance_is_moving_the_motion():
    rng = np.random.default_rng(2)
    T, A = se3.exp(rng.normal(size=(2, 6)))
    xi = 1e-6 * rng.normal(size=6)
    moved = se3.log(se3.inverse(T @ A @ se3.inverse(T)) @ T @ A @ se3.exp(xi) @ se3.inverse(T))
    assert_allclose(moved_covariance(T, np.outer(xi, xi)), np.outer(moved, moved), atol=1e-16)


@pytest.mark.parametrize("kernel", ["cauchy", "huber"])
@pytest.mark.parametrize("spread", [1.0, 2.0])
def test_robust_information_is_that_of_the_robust_mean(kernel, spread):
    """The mean of vectors by robust weights: its covariance over draws, against what it claims."""
    rng = np.random.default_rng(3)
    huber, width, n, draws = kernel == "huber", 3.0 if kernel == "cauchy" else 1.0, 60, 800
    r = spread * rng.normal(size=(draws, n, 3))
    mean = np.zeros((draws, 1, 3))
    for _ in range(30):
        chi2 = np.sum((r - mean) ** 2, axis=2)
        w = (np.minimum(1.0, width / np.sqrt(chi2)) if huber else 1.0 / (1.0 + chi2 / width**2))
        mean = np.sum(w[..., None] * r, axis=1, keepdims=True) / w.sum(axis=1)[:, None, None]
    group = np.repeat(np.arange(draws), n)
    factor = kernel_effect(chi2.reshape(-1), np.full(draws * n, 3.0), group, draws, huber,
                           width).efficiency
    claimed = 1.0 / (factor * w.sum(axis=1))
    assert np.mean(mean**2) / np.mean(claimed) == pytest.approx(1.0, abs=0.1)


def test_windows_that_share_pixels_count_for_what_they_cover():
    apart = np.array([[0.0, 0.0], [20.0, 0.0], [0.0, 20.0], [50.0, 50.0]])
    one = np.zeros(4, np.int64)
    assert_allclose(sharing(apart, one, 2, 11.0), [1.0, 1.0])
    assert_allclose(sharing(np.zeros((4, 2)), one, 1, 11.0), [4.0])
    assert_allclose(sharing(np.zeros((4, 2)), np.arange(4), 4, 11.0), np.ones(4))
    halves = np.array([[0.0, 0.0], [5.5, 0.0]])
    assert_allclose(sharing(halves, one[:2], 1, 11.0), [1.5])


def test_the_mean_of_overlapping_windows_errs_as_sharing_says():
    """Pixel noise averaged over windows: the variance of the windows' mean, over many draws."""
    rng = np.random.default_rng(4)
    middles = rng.uniform(8, 52, (40, 2)).round()
    noise = rng.normal(size=(4000, 60, 60))
    windows = np.stack([noise[:, int(v) - 3:int(v) + 4, int(u) - 3:int(u) + 4].mean(axis=(1, 2))
                        for u, v in middles], axis=1)
    single = 1.0 / 49.0
    shared = sharing(middles, np.zeros(40, np.int64), 1, 7.0)[0]
    assert windows.mean(axis=1).var() == pytest.approx(shared * single / 40, rel=0.1)


@pytest.mark.parametrize("common", [0.0, 0.7])
def test_clustering_says_by_how_much_a_fits_variance_grows(common):
    """Least squares on 60 parts of 15 rows with an error in common in each, over many draws."""
    rng = np.random.default_rng(5)
    parts, rows, draws = 60, 15, 800
    J = rng.normal(size=(parts, 1, 6)) + rng.normal(size=(parts, rows, 6))
    H = np.einsum("pri,prj->pij", J, J)
    P = np.linalg.inv(H.sum(axis=0))
    noise = (rng.normal(size=(draws, parts, rows))
             + common * rng.normal(size=(draws, parts, 1))) / np.sqrt(1.0 + common**2)
    error = np.einsum("ij,prj,npr->ni", P, J, noise)
    scores = np.einsum("pri,npr->npi", J, noise - np.einsum("pri,ni->npr", J, error))
    found = [clustering(H, score) for score in scores]
    true = np.mean(np.einsum("ni,ij,nj->n", error, np.linalg.inv(P), error)) / 6.0
    # What all parts have in common moves the fit, and does not show: the more so the fewer parts.
    assert np.mean(found) == pytest.approx(true, rel=0.15 if common else 0.03)


def test_parts_that_cannot_tell_leave_the_information_as_it_is():
    assert clustering(np.eye(6)[None], np.zeros((1, 6))) == 1.0
    assert clustering(np.zeros((12, 6, 6)), np.zeros((12, 6))) == 1.0
    assert clustering(np.full((12, 6, 6), np.nan), np.zeros((12, 6))) == 1.0
