"""A ring of poses that drifted: an edge across its ends brings it back, a wrong one does little."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slam.backend.pose_graph import PoseEdges, optimise_poses, residuals
from slam.geometry import se3

K = 40
SIGMA = np.array([0.002, 0.01])


def ring():
    angle = np.linspace(0.0, 2 * np.pi, K, endpoint=False)
    turn = se3.exp_so3(np.stack([0 * angle, angle, 0 * angle], 1))
    at = 5.0 * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], 1)
    return se3.from_rotation_translation(turn, at)


@pytest.fixture
def drifted():
    """True poses, drifted ones, and the noisy steps between them."""
    true = ring()
    noise = np.random.default_rng(0).normal(size=(K - 1, 6)) * np.repeat(SIGMA, 3)
    steps = se3.inverse(true[:-1]) @ true[1:] @ se3.exp(noise)
    poses = [true[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    return true, np.array(poses), steps


def edges_of(steps, loops):
    a = np.concatenate([np.arange(K - 1), [e[0] for e in loops]]).astype(int)
    b = np.concatenate([np.arange(1, K), [e[1] for e in loops]]).astype(int)
    T = np.concatenate([steps, [e[2] for e in loops]]) if loops else steps
    return PoseEdges(a, b, T, np.repeat(SIGMA[None], len(a), 0), np.arange(len(a)) >= K - 1)


def gaps_m(poses, true):
    return np.linalg.norm(poses[:, :3, 3] - true[:, :3, 3], axis=1)


def test_steps_alone_are_left_as_they_are(drifted):
    _, poses, steps = drifted
    assert_allclose(optimise_poses(poses, edges_of(steps, []), held=0), poses, atol=1e-9)


def test_a_loop_takes_most_of_the_drift_off(drifted):
    true, poses, steps = drifted
    edges = edges_of(steps, [(0, K - 1, se3.inverse(true[0]) @ true[K - 1])])
    found = optimise_poses(poses, edges, held=0)
    assert_allclose(found[0], true[0], atol=1e-12)
    assert gaps_m(found, true)[-1] < 0.1 * gaps_m(poses, true)[-1]
    assert gaps_m(found, true).mean() < 0.6 * gaps_m(poses, true).mean()
    assert residuals(found, edges)[-1] < 1.0


def test_a_wrong_robust_edge_stands_out_and_does_little(drifted):
    true, poses, steps = drifted
    wrong = (5, 30, np.eye(4))                    # 9 m off
    good = (0, K - 1, se3.inverse(true[0]) @ true[K - 1])
    clean = optimise_poses(poses, edges_of(steps, [good]), held=0)
    edges = edges_of(steps, [good, wrong])
    found = optimise_poses(poses, edges, held=0)
    assert np.abs(found[:, :3, 3] - clean[:, :3, 3]).max() < 0.5
    assert residuals(found, edges)[-1] > 100.0


def test_equal_graphs_give_equal_bytes(drifted):
    true, poses, steps = drifted
    edges = edges_of(steps, [(0, K - 1, se3.inverse(true[0]) @ true[K - 1])])
    first, again = (optimise_poses(poses, edges, held=0) for _ in range(2))
    assert first.tobytes() == again.tobytes()
