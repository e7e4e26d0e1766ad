"""The solver: descent, groups, consistency with the noise, and the noise it measures."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import chi2

from slam.config import MotionConfig
from slam.estimation.motion import (
    NoiseScales,
    _levenberg_marquardt,
    _Problem,
    refine_motions,
)
from slam.geometry import se3
from slam.matches import no_lines
from slam.tables import joined
from two_views import CAMERA, no_points, perturbed, random_lines, random_points, some_motion

WIDE = MotionConfig(kernel="huber", kernel_width=1e6)
ONE = NoiseScales(np.ones(4))


def scene(seed, n=150, lines=20, **noise):
    """Two motions seen by points and lines: (2, 4, 4) true poses, points, lines."""
    rng = np.random.default_rng(seed)
    T = np.stack([some_motion(rng), some_motion(rng)])
    points = joined(random_points(rng, T[0], n, **noise), random_points(rng, T[1], n, group=1,
                                                                        kind=1, **noise))
    return rng, T, points, joined(random_lines(rng, T[0], lines),
                                  random_lines(rng, T[1], lines, group=1))


@given(st.integers(0, 10_000), st.sampled_from(["huber", "cauchy"]))
@settings(max_examples=25)
def test_no_group_ends_at_a_higher_cost_than_it_began(seed, kernel):
    rng, T, points, lines = scene(seed, 40, 8)
    wild = points.uv_b.copy()
    wild[::4] += rng.normal(size=wild[::4].shape) * 60
    config = MotionConfig(kernel=kernel)
    problem = _Problem(replace(points, uv_b=wild), lines, 2, CAMERA, config, ONE)
    start = perturbed(T, rng, 0.2, 0.8)
    problem.renew(start)
    before = problem.linearise(start)[0]
    end, _ = _levenberg_marquardt(problem, start, config)
    assert np.all(problem.linearise(end)[0] <= before)
    assert np.isfinite(end).all()


def test_motions_solved_together_equal_each_solved_alone():
    rng, T, points, lines = scene(3)
    config = replace(WIDE, rounds=4, iterations=10, step_tolerance=1e-9)
    start = perturbed(T, rng)
    both = refine_motions(start, points, lines, CAMERA, config, ONE, adapt=False)
    for g in range(2):
        mine_p, mine_l = points.group == g, lines.group == g
        alone = refine_motions(
            start[g][None],
            replace(points, **{f: getattr(points, f)[mine_p] for f in (
                "uv_a", "rho_a", "rho_sigma_a", "uv_b", "flow_cov", "rho_b", "rho_sigma_b",
                "rho_slope_b", "kind")}, group=np.zeros(mine_p.sum(), np.int64)),
            replace(lines, **{f: getattr(lines, f)[mine_l] for f in (
                "endpoints_a", "rho_a", "rho_sigma_a", "endpoints_b", "flow_sigma")},
                group=np.zeros(mine_l.sum(), np.int64)),
            CAMERA, config, ONE, adapt=False)
        assert_allclose(both.T_a_b[g], alone.T_a_b[0], atol=1e-10)
        assert_allclose(both.information[g], alone.information[0], rtol=1e-6)
        assert_allclose(both.point_chi[mine_p], alone.point_chi, atol=1e-6)
        assert_allclose(both.line_chi[mine_l], alone.line_chi, atol=1e-6)


@pytest.mark.parametrize("which", ["points", "lines", "both"])
def test_errors_are_as_large_as_the_information_says(which):
    """NEES of the camera's and an object's increment over many draws of the noise."""
    # The line's own noise of 0.05 px is not drawn, so it is not assumed here either.
    config = replace(WIDE, rounds=3, iterations=8, reprojection_sigma_px=1e-3, line_sigma_px=1e-3)
    nees = []
    for seed in range(60):
        rng, T, points, lines = scene(seed + 100, 80, 25)
        points = no_points() if which == "lines" else points
        lines = no_lines() if which == "points" else lines
        found = refine_motions(perturbed(T, rng, 0.003, 0.01), points, lines, CAMERA, config, ONE,
                               adapt=False)
        error = se3.log(se3.inverse(found.T_a_b) @ T)
        nees.append(np.einsum("gi,gij,gj->g", error, found.information, error))
    total, freedom = np.sum(nees, axis=0), 6 * len(nees)
    low, high = chi2.ppf([5e-4, 1 - 5e-4], freedom)
    assert np.all((total > low) & (total < high)), total / len(nees)


def test_a_second_depth_read_where_the_flow_was_wrong_says_what_it_is_worth():
    """On steep surfaces the flow's error stands in the depth, too: it is known, and no noise."""
    config = replace(WIDE, rounds=3, iterations=8, reprojection_sigma_px=1e-3)
    nees, errors, errors_blind = [], [], []
    for seed in range(60):
        rng = np.random.default_rng(seed + 500)
        T = some_motion(rng)
        points = random_points(rng, T, 80, rho_sigma=2e-4, slope=4e-3)
        start = perturbed(T, rng, 0.003, 0.01)[None]
        blind = replace(points, rho_slope_b=np.zeros((80, 2)))
        for out, matches in ((errors, points), (errors_blind, blind)):
            found = refine_motions(start, matches, no_lines(), CAMERA, config, ONE, adapt=False)
            out.append(se3.log(se3.inverse(found.T_a_b[0]) @ T))
            if matches is points:
                nees.append(out[-1] @ found.information[0] @ out[-1])
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 6 * len(nees))
    assert low < np.sum(nees) < high
    rms, rms_blind = (np.sqrt(np.mean(np.square(e), axis=0)) for e in (errors, errors_blind))
    assert np.all(rms < 0.3 * rms_blind)


def measured_over_frames(T, points, frames=4):
    """Scales as a run measures them: each frame starts where the last one ended."""
    scales = ONE
    for _ in range(frames):
        found = refine_motions(T, points, no_lines(), CAMERA, MotionConfig(), scales)
        scales = NoiseScales(np.r_[np.diag(found.flow_scale[:, :2]), 1.0, 1.0], found.line_scale,
                             found.depth_scale)
    return scales


@pytest.mark.parametrize(("true_px", "assumed_px"), [(0.3, 0.1), (0.1, 0.3), (1.2, 0.3)])
def test_the_flow_noise_is_measured_from_the_residuals(true_px, assumed_px):
    _, T, points, _ = scene(11, 1500, 0, flow_sigma=true_px, assumed_flow=assumed_px)
    scales = measured_over_frames(T, points)
    assert_allclose(scales.flow[:2], true_px / assumed_px, rtol=0.08)
    assert scales.depth == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(("true_sigma", "assumed_sigma"), [(0.006, 0.002), (0.002, 0.008)])
def test_the_depth_noise_is_measured_from_the_residuals(true_sigma, assumed_sigma):
    _, T, points, _ = scene(12, 1500, 0, rho_sigma=true_sigma, assumed_rho=assumed_sigma)
    scales = measured_over_frames(T, points)
    assert scales.depth == pytest.approx(true_sigma / assumed_sigma, rel=0.12)
    assert_allclose(scales.flow[:2], 1.0, rtol=0.15)


@pytest.mark.parametrize("true_over_stated", [0.4, 3.0])
def test_the_noise_of_lines_is_measured_from_their_residuals(true_over_stated):
    rng = np.random.default_rng(17)
    T = some_motion(rng)
    lines = random_lines(rng, T, 150, flow_sigma=0.3 * true_over_stated)
    lines = replace(lines, flow_sigma=np.full(150, 0.3))
    scales = ONE
    for _ in range(4):     # frames
        found = refine_motions(T[None], random_points(rng, T, 500), lines, CAMERA,
                               MotionConfig(line_sigma_px=1e-3), scales)
        scales = replace(scales, lines=found.line_scale)
    assert scales.lines == pytest.approx(true_over_stated, rel=0.15)


def test_noise_of_two_groups_is_told_apart():
    rng = np.random.default_rng(13)
    T = np.stack([some_motion(rng), some_motion(rng)])
    points = joined(random_points(rng, T[0], 1500, 0.1, assumed_flow=0.3),
                    random_points(rng, T[1], 1500, 0.9, assumed_flow=0.3, group=1, kind=0))
    found = refine_motions(T, points, no_lines(), CAMERA, MotionConfig(), ONE)
    assert found.flow_scale[0, 0] == pytest.approx(1 / 3, rel=0.1)
    assert found.flow_scale[1, 0] == pytest.approx(3.0, rel=0.1)


def test_too_few_matches_take_the_static_worlds_scale():
    rng = np.random.default_rng(14)
    T = np.stack([some_motion(rng), some_motion(rng)])
    points = joined(random_points(rng, T[0], 500, 0.6, assumed_flow=0.3),
                    random_points(rng, T[1], 15, 0.6, assumed_flow=0.3, group=1, kind=0))
    found = refine_motions(T, points, no_lines(), CAMERA, MotionConfig(), ONE)
    assert found.flow_scale[1, 0] == found.flow_scale[0, 0]


def test_noise_free_input_gives_the_motion_exactly():
    rng, T, points, _ = scene(15, 200, 0, flow_sigma=0.0, rho_sigma=0.0, assumed_flow=0.3,
                              assumed_rho=0.002)
    found = refine_motions(perturbed(T, rng), points, no_lines(), CAMERA, MotionConfig(), ONE)
    assert np.abs(se3.log(se3.inverse(found.T_a_b) @ T)).max() < 1e-6
    assert np.isfinite(found.information).all()


def test_what_stands_for_an_unknown_second_depth_does_not_matter():
    rng = np.random.default_rng(16)
    T = some_motion(rng)
    points = random_points(rng, T, 200, known_b=False)
    start = perturbed(T, rng)[None]
    one, other = (refine_motions(start, replace(points, rho_b=np.full(200, value)), no_lines(),
                                 CAMERA, MotionConfig(), ONE) for value in (0.0, 3.0))
    assert_allclose(one.T_a_b, other.T_a_b, atol=1e-9)
    assert np.isfinite(one.T_a_b).all()


def test_the_second_depth_adds_what_one_image_cannot_tell():
    """Along the optical axis flow says little; the second frame's depth says it."""
    rng = np.random.default_rng(17)
    T = some_motion(rng)
    points = random_points(rng, T, 400)
    blind = replace(points, rho_sigma_b=np.full(400, np.inf))
    here = replace(WIDE, rounds=1, iterations=0)
    both, one = (refine_motions(T[None], m, no_lines(), CAMERA, here, ONE, adapt=False)
                 .information[0] for m in (points, blind))
    assert np.all(np.linalg.eigvalsh(both - one) > -1e-4 * np.trace(one))
    assert np.linalg.inv(both)[5, 5] < 0.93 * np.linalg.inv(one)[5, 5]


@pytest.mark.parametrize("kernel", ["huber", "cauchy"])
def test_outliers_are_told_from_inliers_and_hardly_pull(kernel):
    rng, T, points, lines = scene(18, 300, 20)
    moved = points.uv_b.copy()
    outlier = rng.random(len(moved)) < 0.25
    side = rng.choice([-1.0, 1.0], size=(outlier.sum(), 2))
    moved[outlier] += side * rng.uniform(8, 40, size=side.shape)
    found = refine_motions(perturbed(T, rng, 0.003, 0.01), replace(points, uv_b=moved), lines,
                           CAMERA, MotionConfig(kernel=kernel), ONE)
    config = MotionConfig()
    assert np.all(found.point_chi[outlier] > config.point_gate)
    assert np.mean(found.point_chi[~outlier] < config.point_gate) > 0.98
    error = se3.log(se3.inverse(found.T_a_b) @ T)
    sigma = np.sqrt(np.linalg.inv(found.information).diagonal(axis1=1, axis2=2))
    assert np.all(np.abs(error) < 4.5 * sigma)


def test_a_line_on_another_motion_exceeds_the_gate():
    _, T, points, lines = scene(19, 300, 20)
    ends = lines.endpoints_b.copy()
    ends[3] += [12.0, -9.0]
    found = refine_motions(T, points, replace(lines, endpoints_b=ends), CAMERA, MotionConfig(),
                           ONE)
    assert found.line_chi[3] > MotionConfig().line_gate
    others = np.delete(found.line_chi, 3)
    assert np.mean(others < MotionConfig().line_gate) > 0.95
