"""Exact motion of every pixel between two frames, and what becomes of it."""

from __future__ import annotations

from simbench.truth.motion import part_motions, scene_flow
from simbench.truth.rays import RayCaster
from simbench.truth.surface import surface_of
from simbench.truth.visibility import follow
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
    motions = part_motions(truth_i, truth_j)
    seen_i, seen_j = surface_of(truth_i), surface_of(truth_j)
    there = follow(seen_i, seen_j, motions, intrinsics, caster)
    back = follow(seen_j, seen_i, part_motions(truth_j, truth_i), intrinsics, caster)
    return FlowTruth(
        flow_px=there.flow_px,
        scene_flow_m=scene_flow(truth_i, motions, intrinsics),
        valid=there.ahead,
        occluded=there.hidden,
        leaving=(truth_i.part_id >= 0) & ~there.inside,
        newly_visible=(truth_j.part_id >= 0) & ~(back.inside & ~back.hidden))
