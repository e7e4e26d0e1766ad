"""Efficiency of estimated motions: the Cramér–Rao bound over their mean squared error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from simbench.metrics.bound import (
    TrueCorrespondences,
    motion_information,
    object_motion_covariance,
)
from simbench.metrics.camera import MotionErrors
from simbench.metrics.objects import ObjectErrors
from simbench.sequence import SequenceTruth
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame, FrameEstimate

CAMERA = 0               # the static world's number among the bodies
_PIXELS = 3000           # of a body tell its information to a percent
_MIN_PIXELS = 20


@dataclass(frozen=True, slots=True)
class GaussianNoise:
    """White noise of known size on the flow and the inverse depths that a system is given."""

    flow_px: float             # each axis
    inverse_depth: float       # 1/m


def visible_pixels(truth: SequenceTruth, k: int, noise: GaussianNoise,
                   most: int | None = None) -> dict[int, tuple[TrueCorrespondences, float]]:
    """Of each body, the pixels of frame k − 1 that stay visible in frame k.

    Args:
        most: so many of each body at most, evenly spread.
    Returns:
        body -> its correspondences, and how many pixels each of them stands for.
    """
    frame, flow = truth.frame(k - 1), truth.flow(k - 1, k)
    v, u = np.nonzero(flow.valid & ~flow.leaving & ~flow.occluded)
    of_body = frame.instance_id[v, u]
    out = {}
    for body in np.unique(of_body):
        own = np.flatnonzero(of_body == body)
        count = len(own)
        if count < _MIN_PIXELS:
            continue
        if most is not None and count > most:
            own = own[np.linspace(0, count - 1, most).astype(np.int64)]
        same = np.ones(len(own))
        out[int(body)] = TrueCorrespondences(
            np.stack([u[own], v[own]], axis=-1).astype(np.float64),
            1.0 / frame.depth_m[v[own], u[own]].astype(np.float64), noise.flow_px * same,
            noise.inverse_depth * same, noise.inverse_depth * same), count / len(own)
    return out


def true_step(truth: Trajectories, body: int, k: int) -> Array:
    """(4, 4) T_a_b from frame k − 1 to k as a body sees the camera move."""
    X_a, X_b = truth.T_world_camera[k - 1], truth.T_world_camera[k]
    if body == CAMERA:
        return se3.inverse(X_a) @ X_b
    L_a, L_b = truth.objects[body].T_world_object[k - 1: k + 1]
    return np.asarray(se3.inverse(X_a) @ L_a @ se3.inverse(L_b) @ X_b)


@dataclass(slots=True)
class Bounds:
    """An observer of a run: the information that each pair of frames holds of every body.

    Args:
        truth: exact truth with images.
        noise: of the inputs.
    """

    truth: SequenceTruth
    noise: GaussianNoise
    information: dict[int, dict[int, Array]] = field(default_factory=dict)   # by frame and body

    def __call__(self, frame: Frame, estimate: FrameEstimate) -> None:
        k = frame.index
        if k == 0:
            return
        self.information[k] = {
            body: each * motion_information(true_step(self.truth.trajectories, body, k), seen,
                                            frame.intrinsics)
            for body, (seen, each) in visible_pixels(self.truth, k, self.noise, _PIXELS).items()}

    def efficiencies(self, steps: MotionErrors, errors: Mapping[int, ObjectErrors]
                     ) -> dict[str, float]:
        """Of the camera's and the rigid objects' motions, translation and rotation."""
        return (self._block("camera", self._of_camera(steps))
                | self._block("objects", self._of_objects(errors)))

    def _of_camera(self, steps: MotionErrors) -> Iterable[tuple[float, float, Array]]:
        for k, t_m, r_deg in zip(steps.frame, steps.t_m, steps.r_deg, strict=True):
            of = self.information.get(int(k), {})
            if CAMERA in of:
                yield t_m, r_deg, np.linalg.inv(of[CAMERA])

    def _of_objects(self, errors: Mapping[int, ObjectErrors]
                    ) -> Iterable[tuple[float, float, Array]]:
        for body, each in errors.items():
            if not each.rigid:
                continue
            truth = self.truth.trajectories
            for k, t_m, r_deg in zip(each.frame, each.local_t_m, each.local_r_deg, strict=True):
                of = self.information.get(int(k), {})
                if CAMERA in of and body in of and np.isfinite(t_m):
                    T = se3.inverse(truth.objects[body].T_world_object[k]) @ truth.T_world_camera[k]
                    yield t_m, r_deg, object_motion_covariance(T, of[CAMERA], of[body])

    @staticmethod
    def _block(of: str, rows: Iterable[tuple[float, float, Array]]) -> dict[str, float]:
        found = [(t_m**2, np.radians(r_deg) ** 2, np.trace(P[3:, 3:]), np.trace(P[:3, :3]))
                 for t_m, r_deg, P in rows]
        if not found:
            return {}
        t2, r2, bound_t2, bound_r2 = np.mean(found, axis=0)
        if t2 <= 0.0 or r2 <= 0.0:
            return {}
        return {f"efficiency_{of}": float(bound_t2 / t2),
                f"efficiency_{of}_rotation": float(bound_r2 / r2)}
