"""How well a system tells moving features from those that stand still (DPL-SLAM III-B)."""

from __future__ import annotations

import numpy as np

from simbench.sequence import SequenceTruth
from simbench.types import FrameTruth
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import Pinhole, back_project
from slam.types import Frame, FrameEstimate, Judged

MOVING_M_S = 0.05        # a surface slower than this counts as standing still
_SAMPLES = 7             # positions along a segment; it moves where a third of them do


def moving_at(uv_px: Array, before: FrameTruth, now: FrameTruth, camera: Pinhole) -> Array:
    """(N,) bool: what is seen at pixels (N, 2) of `now` has moved in the world since `before`."""
    height, width = now.part_id.shape
    column = np.clip(np.rint(uv_px[:, 0]), 0, width - 1).astype(np.intp)
    row = np.clip(np.rint(uv_px[:, 1]), 0, height - 1).astype(np.intp)
    part, depth = now.part_id[row, column], now.depth_m[row, column]
    pixel = np.stack([column, row], axis=1).astype(np.float64)
    xyz = se3.transform_points(now.T_world_camera, back_project(camera, pixel, depth))
    motion = before.T_world_part @ se3.inverse(now.T_world_part)      # part 0 stands
    there = part >= 0
    T = motion[np.where(there, part, 0)]
    was = np.einsum("nij,nj->ni", T[:, :3, :3], xyz) + T[:, :3, 3]
    dt_s = now.stamp_s - before.stamp_s
    return np.asarray(there & (depth > 0)
                      & (np.linalg.norm(xyz - was, axis=1) > MOVING_M_S * dt_s))


class CullingErrors:
    """An observer of a run: precision and recall of "dynamic" over points and segments.

    Args:
        truth: exact truth, or None, and then there is nothing to measure.
    """

    def __init__(self, truth: SequenceTruth | None) -> None:
        self._truth = truth
        self._judged = False
        self._left_out = self._moving = self._both = 0

    def __call__(self, frame: Frame, estimate: FrameEstimate) -> None:
        if self._truth is None or estimate.judged is None or frame.index == 0:
            return
        self._judged = True
        moving = _truly_moving(estimate.judged, self._truth, frame)
        dynamic = np.concatenate([estimate.judged.points_dynamic,
                                  estimate.judged.segments_dynamic])
        self._left_out += int(np.count_nonzero(dynamic))
        self._moving += int(np.count_nonzero(moving))
        self._both += int(np.count_nonzero(dynamic & moving))

    def metrics(self) -> dict[str, float]:
        """The `culling` block; a share of nothing is absent."""
        if not self._judged:
            return {}
        shares = (("precision", self._left_out), ("recall", self._moving))
        return {name: self._both / of for name, of in shares if of}


def _truly_moving(judged: Judged, truth: SequenceTruth, frame: Frame) -> Array:
    """(N + L,) bool of the points and then of the segments."""
    before, now = truth.frame(frame.index - 1), truth.frame(frame.index)
    t = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    ends = judged.segments_px
    along = (ends[:, None, 0] * (1 - t) + ends[:, None, 1] * t).reshape(-1, 2)
    at = moving_at(np.concatenate([judged.points_px, along]), before, now, frame.intrinsics)
    points, segments = at[:len(judged.points_px)], at[len(judged.points_px):]
    return np.concatenate([points, segments.reshape(-1, _SAMPLES).mean(axis=1) > 1.0 / 3.0])
