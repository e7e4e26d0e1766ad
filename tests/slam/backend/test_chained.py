"""The paper's own formulation: against a dense system, on worlds whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import chi2

from point_world import CAMERA, RHO_SIGMA, UV_SIGMA
from slam.backend.chained import ChainedProblem, refine_chained, solve
from slam.backend.chains import chain_steps, reduce_chains
from slam.backend.config import BundleConfig, ChainConfig
from slam.backend.descend import levenberg_marquardt
from slam.backend.refine_run import refine_run
from slam.geometry import camera as pinhole
from slam.geometry import line, se3
from slam.line_sightings import packed
from slam.map import STATIC, LineObservations, MapRecord, PointObservations
from slam.types import ObjectTrack, SlamResult, Status

INTERVAL_S = 0.1
UNTIED = ChainConfig(angular_acceleration_rad_s2=1e4, acceleration_m_s2=1e4)  # motions apart
BUNDLE = BundleConfig(iterations=25, tolerance=1e-12, rounds=0)


@pytest.mark.parametrize("d", [3, 4])
def test_elimination_along_chains_is_the_schur_complement(d):
    rng = np.random.default_rng(d)
    chain, V = np.array([0, 4, 5, 8]), 6
    node = np.sort(rng.integers(0, 8, 14))
    variable, B = rng.integers(0, V, 14), rng.normal(size=(14, d, 6))
    A = np.zeros((8 * d, 8 * d))
    D, off = np.zeros((8, d, d)), np.zeros((8, d, d))
    for a in range(8):
        half = rng.normal(size=(d, d))
        D[a] = half @ half.T + 8.0 * np.eye(d)
        A[d * a:d * a + d, d * a:d * a + d] = D[a]
        if a not in chain:
            off[a] = rng.normal(size=(d, d))
            A[d * a:d * a + d, d * a - d:d * a] = off[a]
            A[d * a - d:d * a, d * a:d * a + d] = off[a].T
    W = np.zeros((8 * d, 6 * V))
    for n, v, b in zip(node, variable, B, strict=True):
        W[d * n:d * n + d, 6 * v:6 * v + 6] += b
    c = rng.normal(size=(8, d))
    S, g = np.zeros((6 * V, 6 * V)), np.zeros(6 * V)
    system = chain, D, off, c, np.searchsorted(node, chain), node, variable, B
    reduce_chains(*system, S, g)
    assert_allclose(S, -W.T @ np.linalg.solve(A, W), atol=1e-12)
    assert_allclose(g, -W.T @ np.linalg.solve(A, c.reshape(-1)), atol=1e-12)
    step = rng.normal(size=(V, 6))
    assert_allclose(chain_steps(*system, step).reshape(-1),
                    -np.linalg.solve(A, c.reshape(-1) + W @ step.reshape(-1)), atol=1e-12)


def path_of(rng, frames, step, jitter):
    T = [np.eye(4)]
    for xi in np.asarray(step) + jitter * rng.normal(size=(frames - 1, 6)):
        T.append(T[-1] @ se3.exp(xi))
    return np.array(T)


def dynamic_world(seed, frames=7, points=20, lines=8, noise=0.0, drift=0.0, missed=0.0):
    """A record of a camera and a moving body, both with points and lines; the true poses.

    Args:
        noise: in standard deviations; drift: of the poses where the batch starts, rad and m.
    """
    rng = np.random.default_rng(seed)
    X = path_of(rng, frames, [0, 0.01, 0, 0.05, 0, 0.01], 0.002)
    L = se3.from_rotation_translation(np.eye(3), np.array([0.2, 0.1, 4.0])) @ path_of(
        rng, frames, [0, 0.03, 0, -0.02, 0, 0.03], 0.002)
    record = MapRecord()
    record.indices.extend(range(frames))
    object_number = record.new_body(1)
    for number, Y in ((STATIC, X), (object_number, se3.inverse(L) @ X)):
        steps = se3.inverse(Y[:-1]) @ Y[1:] @ se3.exp(drift * rng.normal(size=(frames - 1, 6)))
        body = record.bodies[number]
        body.begin(0, Y[0])
        for k, step in enumerate(steps, start=1):
            body.add(k, step, np.eye(6) * 1e4)
        spread = np.array([2.0, 1.5, 1.5]) if number == STATIC else np.array([0.4, 0.4, 0.4])
        centre = np.array([0, 0, 5.0]) if number == STATIC else np.zeros(3)
        add_points(record, rng, number, Y, centre + spread * rng.uniform(-1, 1, (points, 3)),
                   noise, missed)
        ends = centre + spread * rng.uniform(-1, 1, (lines, 2, 3))
        add_lines(record, rng, number, Y, ends, noise)
    return record, X, L


def seen(Y, xyz):
    """Pixels and inverse depths of (N, 3) by poses (N, 4, 4)."""
    p = np.einsum("nij,nj->ni", se3.inverse(Y)[:, :3, :3], xyz) + se3.inverse(Y)[:, :3, 3]
    return pinhole.project(CAMERA, p), 1.0 / p[:, 2]


def add_points(record, rng, number, Y, xyz, noise, missed):
    F, P = len(Y), len(xyz)
    ids = record.points.add_landmarks(np.full(P, number), xyz)
    for k in range(F):
        here = rng.random(P) >= missed
        uv, rho = seen(np.repeat(Y[k][None], P, 0), xyz)
        uv = uv + noise * UV_SIGMA * rng.normal(size=uv.shape)
        rho = rho + noise * RHO_SIGMA * rng.normal(size=rho.shape)
        record.points.add_observations(PointObservations(
            ids[here], np.full(here.sum(), k), uv[here],
            np.broadcast_to(np.eye(2) * UV_SIGMA**2, (here.sum(), 2, 2)), rho[here],
            np.full(here.sum(), RHO_SIGMA)))


def add_lines(record, rng, number, Y, ends, noise):
    P = len(ends)
    lines = packed(line.orthonormal_from_plucker(
        line.plucker_from_points(ends[:, 0], ends[:, 1])))
    ids = record.lines.add_landmarks(np.full(P, number), lines)
    for k in range(len(Y)):
        uv, rho = seen(np.repeat(Y[k][None], 2 * P, 0), ends.reshape(-1, 3))
        uv = uv + noise * UV_SIGMA * rng.normal(size=uv.shape)
        rho = rho + noise * RHO_SIGMA * rng.normal(size=rho.shape)
        record.lines.add_observations(LineObservations(
            ids, np.full(P, k), uv.reshape(P, 2, 2),
            np.broadcast_to(np.eye(2) * UV_SIGMA**2, (P, 2, 2)), rho.reshape(P, 2),
            np.full((P, 2), RHO_SIGMA)))


def motion_errors(state, problem, L):
    H = state.H[1][1:]
    error = se3.log(se3.inverse(H) @ L[1:] @ se3.inverse(L[:-1]))
    return np.abs(error).max()


@pytest.mark.parametrize("unit", ["pixels", "metres"])
def test_without_noise_the_truth_comes_back(unit):
    record, X, L = dynamic_world(0, drift=3e-3)
    config = replace(UNTIED, measured_in=unit)
    for body in record.bodies.values():                    # the drifted steps are not believed
        body.information[1:] = [np.eye(6) * 1e-6] * (len(body.frames) - 1)
    problem = ChainedProblem(record, CAMERA, BUNDLE, config, INTERVAL_S)
    state, before, after = solve(problem, BUNDLE)
    assert after < 1e-6 * before
    assert_allclose(state.X, X, atol=1e-5)
    assert motion_errors(state, problem, L) < 1e-4


FORMS = [ChainConfig(line_form=form, measured_in=unit)
         for form in ("well_conditioned", "paper") for unit in ("pixels", "metres")]


@pytest.mark.parametrize("form", FORMS)
def test_drift_is_taken_away(form):
    before, after = [], []
    for seed in range(3):
        record, X, _ = dynamic_world(seed, noise=1.0, drift=2e-3)
        start = np.array(record.bodies[STATIC].poses)
        problem = ChainedProblem(record, CAMERA, BUNDLE, form, INTERVAL_S)
        state, cost_before, cost = solve(problem, BundleConfig())
        assert cost < cost_before
        before.append(np.abs(start[:, :3, 3] - X[:, :3, 3]).mean())
        after.append(np.abs(state.X[:, :3, 3] - X[:, :3, 3]).mean())
    assert np.mean(after) < 0.5 * np.mean(before)


@given(st.integers(0, 1000), st.sampled_from(["two points", "no lines", "parallel", "missed",
                                              "no depth", "nothing"]))
@settings(max_examples=8, deadline=None)
def test_never_worse_and_never_nan(seed, case):
    sizes = {"two points": (2, 0), "no lines": (12, 0), "nothing": (0, 0)}.get(case, (12, 4))
    record, _, _ = dynamic_world(seed, frames=5, points=sizes[0], lines=sizes[1], noise=1.0,
                                 drift=3e-3, missed=0.4 if case == "missed" else 0.0)
    if case == "parallel":
        parts = record.lines._landmarks
        record.lines._landmarks = [replace(p, line_body=np.repeat(p.line_body[:1], len(p), 0))
                                   for p in parts]
    if case == "no depth":
        record.points._observations = [replace(o, rho_sigma=np.full(len(o), np.inf))
                                       for o in record.points._observations]
    for form in FORMS:
        problem = ChainedProblem(record, CAMERA, BUNDLE, form, INTERVAL_S)
        state, before, after = solve(problem, BundleConfig(iterations=3))
        assert after <= before
        assert all(np.isfinite(part).all() for part in (state.X, *state.H))
        assert all(np.isfinite(part).all() for place in state.place for part in place)
        assert_allclose(state.X[0], record.bodies[STATIC].poses[0], atol=1e-12)


def test_both_units_weigh_a_sighting_alike():
    record, _, _ = dynamic_world(3, points=6, lines=6, noise=1.0, drift=1e-4)
    bodies = [ChainedProblem(record, CAMERA, BUNDLE, ChainConfig(measured_in=unit),
                             INTERVAL_S).bodies[0]
              for unit in ("pixels", "metres")]
    X = np.array(record.bodies[STATIC].poses)
    for pixels, metres, place in zip(*(b.families for b in bodies), bodies[0].place, strict=True):
        cost = [np.sum(f._measure(X[bodies[0].at], place).r ** 2, axis=1)
                for f in (pixels, metres)]
        assert_allclose(cost[1], cost[0], rtol=0.2, atol=0.5)   # what is not linear in 1/z differs


def test_errors_are_as_large_as_the_covariances_say():
    """NEES of steps and of motions, seen from the camera before, where all noise is as assumed."""
    drift = 0.01                                                  # of steps: 1e4 of information
    config = replace(UNTIED, kernel_width=1e3)
    bundle = replace(BUNDLE, kernel_width=1e3)
    of_steps, of_motions = [], []
    for seed in range(14):
        record, X, L = dynamic_world(seed, frames=4, points=16, lines=4, noise=1.0, drift=drift)
        problem = ChainedProblem(record, CAMERA, bundle, config, INTERVAL_S)
        state, _, _ = solve(problem, bundle)
        found = problem.covariances(state)
        (motions,) = found.motions.values()
        assert np.isnan(found.steps[0]).all()
        assert np.isnan(motions[0]).all()
        k = 1 + seed % 3                          # motions and steps of one run hang together
        step = se3.inverse(state.X[k - 1]) @ state.X[k]
        e = se3.log(se3.inverse(step) @ se3.inverse(X[k - 1]) @ X[k])
        of_steps.append(e @ np.linalg.solve(found.steps[k], e))
        S = X[k - 1] @ se3.inverse(state.X[k - 1])
        H = S @ state.H[1][k] @ se3.inverse(S)
        e = se3.log(se3.inverse(H) @ L[k] @ se3.inverse(L[k - 1]))
        of_motions.append(e @ np.linalg.solve(motions[k], e))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 6 * len(of_steps))
    assert low < np.sum(of_steps) < high
    assert low < np.sum(of_motions) < high


def test_without_covariances_to_be_had_there_are_none():
    record, _, _ = dynamic_world(0, frames=4, points=0, lines=0)
    for body in record.bodies.values():
        body.information[1:] = [np.zeros((6, 6))] * 3
    problem = ChainedProblem(record, CAMERA, BUNDLE, UNTIED, INTERVAL_S)
    found = problem.covariances(problem.begin)
    # Steps that nothing is known of are held by 0.5 rad and 1 m; of motions nothing is known.
    assert np.all(np.diagonal(found.steps[1:], axis1=1, axis2=2) >= 0.24)
    assert np.all(np.diagonal(found.motions[1][1:], axis1=1, axis2=2) > 1e5)


def run_of(record):
    """The run as tracked, made of the record's start."""
    X0 = np.array(record.bodies[STATIC].poses)
    L0 = X0 @ se3.inverse(np.array(record.bodies[1].poses))
    frames = np.arange(1, len(X0))
    return SlamResult(np.arange(len(X0)) / 10, X0, {1: ObjectTrack(
        frames, L0[1:] @ se3.inverse(L0[:-1]), L0[:-1, :3, 3])},
        (Status.FIRST, *[Status.TRACKED] * (len(X0) - 1)))


# The paper's form leaves the tracked motions of objects aside; depth this noisy misses them.
@pytest.mark.parametrize(("batch", "of_objects"), [("object-centric", 0.8), ("paper", 1.5)])
def test_the_run_is_made_of_all_bodies(batch, of_objects):
    errors = []
    for seed in range(3):
        record, X, L = dynamic_world(seed, noise=1.0, drift=5e-3)
        tracked = run_of(record)
        config = BundleConfig(covariances=True)
        made = (refine_run(record, tracked, CAMERA, config) if batch == "object-centric"
                else refine_chained(record, tracked, CAMERA, config, ChainConfig()))
        for run in (tracked, made):
            S = X[:-1] @ se3.inverse(run.T_world_camera[:-1])
            H = S @ run.objects[1].H_world @ se3.inverse(S)
            off = se3.inverse(H) @ L[1:] @ se3.inverse(L[:-1])
            errors.append([np.abs((run.T_world_camera - X)[:, :3, 3]).mean(),
                           np.linalg.norm(off[:, :3, 3], axis=1).mean()])
        assert np.isnan(made.step_covariance[0]).all()
        for P in (made.step_covariance[1:], made.objects[1].covariance):
            assert np.all(np.linalg.eigvalsh(P) > 0)
        assert np.isfinite(made.points_world).all()
        assert made.lines_world.shape == (8, 2, 3)
        s = record.lines.observations()
        last = s.ends_px[(s.frame == 6) & (s.landmark < 8)].reshape(-1, 2)     # the static ones
        poses = np.repeat(made.T_world_camera[6][None], 16, 0)
        uv, _ = seen(poses, made.lines_world.reshape(-1, 3))
        assert np.median(np.abs(uv - last)) < 1.0
        assert made.timings_ms["global batch"] > 0
    before, after = np.array(errors[::2]).mean(axis=0), np.array(errors[1::2]).mean(axis=0)
    assert np.all(after < [0.5, of_objects] * before)


@pytest.mark.parametrize(("rigidity", "times"), [(1.0, 1.0), (0.5, 4.0), (0.0, 100.0)])
def test_what_bends_is_tied_loosely(rigidity, times):
    costs = []
    for share in (1.0, rigidity):
        record, _, _ = dynamic_world(0, lines=0)
        record.bodies[1].rigidity = [share] * 7
        problem = ChainedProblem(record, CAMERA, BUNDLE, ChainConfig(kernel_width=1e6), INTERVAL_S)
        body = problem.bodies[1]
        place = body.place[0] + 1e-4 * (np.arange(len(body.place[0])) % 2)[:, None]
        costs.append(np.sum(body.families[0]._move(body.H, place).r ** 2))
    assert costs[1] == pytest.approx(costs[0] / times**2)


def test_equal_runs_give_equal_bytes():
    states = []
    for _ in range(2):
        problem = ChainedProblem(dynamic_world(5, noise=1.0, drift=1e-3)[0], CAMERA, BUNDLE,
                                 ChainConfig(), INTERVAL_S)
        states.append(levenberg_marquardt(problem, problem.begin, BundleConfig(iterations=2)))
    assert states[0].X.tobytes() == states[1].X.tobytes()
    assert states[0].H[1].tobytes() == states[1].H[1].tobytes()
