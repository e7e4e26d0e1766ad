"""Exact motion of every pixel between two frames, and what becomes of it."""

from __future__ import annotations


import numpy as np

from simbench.truth.motion import carry, scene_flow
from simbench.truth.rays import RayCaster
from simbench.truth.visibility import fates
from simbench.types import FlowTruth, FrameTruth, SceneLayout


def flow_between(truth_i: FrameTruth, truth_j: FrameTruth, layout: SceneLayout,
                 caster: RayCaster) -> FlowTruth:
    """Flow, scene flow and visibility from any frame i to any frame j, on the pixels of i.

    Every pixel's point moves with its part and is projected into camera j; whether something
    stands before it there is decided by rays wherever frame j's depth and parts leave doubt.
    A pixel whose point comes to lie behind camera j is `leaving` and not `valid`. Pixels of the
    sky are nothing of all this, and are not `newly_visible`.
    """
    intrinsics = layout.intrinsics
    carried = carry(truth_i, truth_j, intrinsics)
    forward = fates(truth_i, carried, truth_j, intrinsics, caster)
    backward = fates(truth_j, carry(truth_j, truth_i, intrinsics), truth_i, intrinsics, caster)
    height, width = truth_i.depth_m.shape
    flow = np.zeros((height, width, 2), np.float32)
    np.subtract(carried.u_px, np.arange(width), out=flow[..., 0], where=forward.ahead,
                casting="same_kind")
    np.subtract(carried.v_px, np.arange(height)[:, None], out=flow[..., 1], where=forward.ahead,
                casting="same_kind")
    return FlowTruth(
        flow_px=flow,
        scene_flow_m=scene_flow(truth_i, truth_j, intrinsics),
        valid=forward.ahead,
        occluded=forward.hidden,
        leaving=(truth_i.part_id >= 0) & ~forward.inside,
        newly_visible=(truth_j.part_id >= 0) & ~(backward.inside & ~backward.hidden))
