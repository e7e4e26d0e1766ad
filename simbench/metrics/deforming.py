"""Objects that are not rigid: the rigid motion that best fits what their visible points did."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simbench.metrics.camera import gauge
from simbench.metrics.estimates import CameraEstimates, ObjectMotions
from simbench.metrics.motion import body_motion, motion_errors, moved_to_world
from simbench.metrics.objects import ObjectErrors
from simbench.metrics.trajectory import rigid_alignment
from simbench.sequence import SequenceTruth
from simbench.types import Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import back_project
from slam.types import Frame, FrameEstimate

_MIN_POINTS = 20


class RigidFits:
    """An observer of a run: fits of the true scene flow of deforming objects, frame by frame.

    Args:
        truth: exact truth, or None, and then nothing is known of scene flow.
    """

    def __init__(self, truth: SequenceTruth | None) -> None:
        layout = None if truth is None else truth.layout
        self._truth = truth
        self._ids = [] if layout is None else [o.instance_id for o in layout.objects
                                               if not o.rigid]
        self.H_world: dict[tuple[int, int], Array] = {}   # (object, frame) -> (4, 4)

    def __call__(self, frame: Frame, estimate: FrameEstimate) -> None:
        if self._truth is None or not self._ids or frame.index == 0:
            return
        before, k = self._truth.frame(frame.index - 1), frame.index
        flow = self._truth.flow(k - 1, k)
        for each in self._ids:
            v, u = np.nonzero((before.instance_id == each) & flow.valid)
            if len(u) < _MIN_POINTS:
                continue
            in_camera = back_project(frame.intrinsics, np.stack([u, v], axis=-1),
                                     before.depth_m[v, u])
            points = se3.transform_points(before.T_world_camera, in_camera)
            self.H_world[each, k] = rigid_alignment(points, points + flow.scene_flow_m[v, u])


def rigid_fit_metrics(fits: Mapping[tuple[int, int], Array], errors: Mapping[int, ObjectErrors],
                      motions: ObjectMotions, camera: CameraEstimates, truth: Trajectories
                      ) -> dict[str, dict[str, float]]:
    """E_t_rigid_fit and E_R_rigid_fit of each object that has fits, by its number as text.

    The errors are taken as E_t and E_R are, in the true body frame before the motion, against
    the fit in place of the motion of the object's root.
    """
    S = gauge(camera, truth)
    out: dict[str, dict[str, float]] = {}
    for true_id, found in errors.items():
        chosen = [i for i, k in enumerate(found.frame.tolist()) if (true_id, k) in fits]
        if S is None or not chosen:
            continue
        frame = found.frame[chosen]
        L = truth.objects[true_id].T_world_object[frame - 1]
        H = moved_to_world(S, motions.H_world[found.row[chosen]])
        fit = np.array([fits[true_id, k] for k in frame.tolist()])
        t_m, r_deg = motion_errors(body_motion(L, H), body_motion(L, fit))
        out[str(true_id)] = {"E_t_rigid_fit": float(t_m.mean()),
                             "E_R_rigid_fit": float(r_deg.mean())}
    return out
