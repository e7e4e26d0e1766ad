"""Pose-graph optimisation with GTSAM: poses that agree best with measured relative poses."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array, freeze_fields

_HUBER = 1.345           # standard deviations: 95 % as efficient as least squares on clean edges


@dataclass(frozen=True, slots=True)
class PoseEdges:
    """E relative poses: T_world_b = T_world_a T_a_b, up to noise."""

    a: Array             # (E,) rows of poses
    b: Array             # (E,)
    T_a_b: Array         # (E, 4, 4)
    sigma: Array         # (E, 2): rad, m
    robust: Array        # (E,) bool: may be wrong; Huber's kernel

    def __post_init__(self) -> None:
        freeze_fields(self, a=("E",), b=("E",), T_a_b=("E", 4, 4), sigma=("E", 2), robust=("E",))


def optimise_poses(T_world_camera: Array, edges: PoseEdges, held: int, iterations: int = 50
                   ) -> Array:
    """Poses (K, 4, 4) that agree best with the edges, from those given; pose `held` stays."""
    values, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
    for k, T in enumerate(T_world_camera):
        values.insert(k, gtsam.Pose3(T))
    graph.add(gtsam.NonlinearEqualityPose3(held, gtsam.Pose3(T_world_camera[held])))
    for a, b, T, sigma, robust in zip(edges.a.tolist(), edges.b.tolist(), edges.T_a_b,
                                      edges.sigma, edges.robust, strict=True):
        graph.add(gtsam.BetweenFactorPose3(a, b, gtsam.Pose3(T), _noise(sigma, bool(robust))))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(iterations)
    # The elimination order is COLAMD's by default, which is deterministic.
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
    return se3.orthonormalised(np.array([found.atPose3(k).matrix()
                                         for k in range(len(T_world_camera))]))


def _noise(sigma: Array, robust: bool) -> gtsam.noiseModel.Base:
    plain = gtsam.noiseModel.Diagonal.Sigmas(np.repeat(sigma, 3))
    if not robust:
        return plain
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(_HUBER), plain)


def residuals(T_world_camera: Array, edges: PoseEdges) -> Array:
    """(E,) how far poses are from the edges, in standard deviations."""
    gap = se3.inverse(edges.T_a_b) @ se3.inverse(T_world_camera[edges.a]) @ T_world_camera[edges.b]
    xi = se3.log(gap).reshape(-1, 2, 3) / edges.sigma[:, :, None]
    return np.asarray(np.linalg.norm(xi.reshape(-1, 6), axis=1))
