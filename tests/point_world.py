"""A body of points, a camera that moves past it, and a path that drifts: all with their truth."""

import numpy as np

from slam.backend.bundle import BodyPath
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.map import STATIC, PointObservations
from slam.tables import taken
from slam.types import Intrinsics

CAMERA = Intrinsics(500.0, 500.0, 319.5, 239.5, 640, 480)
UV_SIGMA, RHO_SIGMA = 0.05, 0.002


def world(seed=0, frames=12, landmarks=60, noise=1.0):
    """Poses (F, 4, 4), points (P, 3) and their sightings by a camera that moves sideways."""
    rng = np.random.default_rng(seed)
    steps = np.array([0.0, 0.01, 0.0, 0.05, 0.0, 0.01]) + rng.normal(size=(frames - 1, 6)) * 0.003
    T = [np.eye(4)]
    for step in steps:
        T.append(T[-1] @ se3.exp(step))
    T = np.array(T)
    xyz = rng.uniform([-2, -1.5, 3], [2, 1.5, 8], size=(landmarks, 3))
    landmark = np.repeat(np.arange(landmarks), frames)
    frame = np.tile(np.arange(frames), landmarks)
    p = np.einsum("mij,mj->mi", se3.inverse(T)[frame][:, :3, :3],
                  xyz[landmark]) + se3.inverse(T)[frame][:, :3, 3]
    uv = pinhole.project(CAMERA, p) + rng.normal(size=(len(p), 2)) * UV_SIGMA * noise
    rho = 1.0 / p[:, 2] + rng.normal(size=len(p)) * RHO_SIGMA * noise
    seen = (np.abs(uv - [319.5, 239.5]) < [320, 240]).all(axis=1)
    s = PointObservations(landmark, frame, uv, np.broadcast_to(np.eye(2) * UV_SIGMA**2,
                                                              (len(p), 2, 2)),
                          rho, np.full(len(p), RHO_SIGMA))
    return T, xyz, taken(s, seen)


def odometry(T, seed, sigma=(2e-4, 1e-3)):
    """A path that drifts, with the information of its steps."""
    rng = np.random.default_rng(seed)
    s = np.repeat(sigma, 3)
    steps = se3.inverse(T[:-1]) @ T[1:] @ se3.exp(rng.normal(size=(len(T) - 1, 6)) * s)
    path = [T[0]]
    for step in steps:
        path.append(path[-1] @ step)
    return BodyPath(np.array(path), np.concatenate([np.eye(4)[None], steps]),
                    np.repeat(np.diag(s**-2.0)[None], len(T), axis=0))


def position_rms(T, truth):
    return np.sqrt(np.mean(np.sum((T[:, :3, 3] - truth[:, :3, 3]) ** 2, axis=1)))


def stream(T, path, window, points=None, lines=None, spoil=lambda row, seen: seen):
    """Feed a world to a window frame by frame; each pose (F, 4, 4) as it first came out.

    Args:
        points, lines: landmarks where they start, and their sightings.
        spoil: makes of a frame's row and sightings what the window is given.
    """
    record, online = window.record, []
    static = record.bodies[STATIC]
    kinds = [(features, *given) for features, given in
             ((record.points, points), (record.lines, lines)) if given is not None]
    for row in range(len(T)):
        record.indices.append(row)
        if row == 0:
            static.begin(0, T[0])
        else:
            static.add(row, path.steps[row], path.information[row])
        for features, places, seen in kinds:
            if row == 0:
                features.add_landmarks(np.zeros(len(places), np.int64), places)
            features.add_observations(spoil(row, taken(seen, seen.frame == row)))
        window.advance(row, [STATIC])
        online.append(static.poses[-1])
    return np.array(online)
