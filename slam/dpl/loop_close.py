"""Closing a loop: poses, then landmarks, then what was mapped twice, then everything together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam.backend.pose_graph import PoseEdges, optimise_poses, residuals
from slam.dpl.adjust import adjust_all
from slam.dpl.config import LoopConfig
from slam.dpl.fuse import fuse
from slam.dpl.keyframes import Keyframe, PointLineMap, shared_landmarks
from slam.dpl.loop_verify import Loop
from slam.dpl.track import PoseTracker
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import ClosedLoops

_TURN_RAD, _TURN_SHARE = 0.0005, 0.005   # σ of a relative rotation: so much, and so much of it
_WAY_M, _WAY_SHARE = 0.001, 0.005        # and of a relative translation
_LOOSE = 1e3                             # times that, where tracking was lost between
_MAX_TENSION = 6.0                       # standard deviations of the loop's edge, afterwards


class LoopCloser:
    """Corrects the map by loops; keeps them as edges of the pose graph."""

    def __init__(self, tracker: PoseTracker) -> None:
        self.tracker = tracker
        self.loops: list[Loop] = []

    def closed(self) -> ClosedLoops:
        """All loops so far."""
        return ClosedLoops(np.array([x.keyframe.frame for x in self.loops], np.int64),
                           np.array([x.old.frame for x in self.loops], np.int64),
                           np.array([x.T_old_keyframe for x in self.loops]).reshape(-1, 4, 4))

    def close(self, map_: PointLineMap, loop: Loop) -> bool:
        """Correct the map, unless the loop is at odds with all the rest."""
        config = self.tracker.config
        before = map_.poses()
        found = self._optimised(map_, loop, config.loop)
        if found is None:
            return False
        for keyframe, T in zip(map_.living(), found, strict=True):
            keyframe.T_world_camera = T
        map_.follow_references(before, map_.poses(), np.arange(map_.points.count),
                               np.arange(map_.lines.count))
        fuse(map_, loop, self.tracker)
        adjust_all(map_, self.tracker.camera, config, config.loop.iterations)
        self.loops.append(as_adjusted(loop))
        return True

    def _optimised(self, map_: PointLineMap, loop: Loop, config: LoopConfig) -> Array | None:
        """(A, 4, 4) poses of the living keyframes; None where they resist the loop."""
        living = map_.living()
        row = np.full(len(map_.keyframes), -1)
        row[[k.number for k in living]] = np.arange(len(living))
        T = np.array([k.T_world_camera for k in living])
        edges = _edges(map_, living, row, T, [*self.loops, loop], config)
        start = bent(T, row[loop.old.number], row[loop.keyframe.number], loop.T_old_keyframe)
        found = optimise_poses(start, edges, held=0)
        if not np.isfinite(found).all() or residuals(found, edges)[-1] > _MAX_TENSION:
            return None
        return found


def as_adjusted(loop: Loop) -> Loop:
    """The loop as the adjusted map has it.

    It was found by what both ends had been seen to share, a strip of the picture at times; now they
    hang together by all that has been fused around them.
    """
    return replace(loop, T_old_keyframe=se3.inverse(loop.old.T_world_camera)
                   @ loop.keyframe.T_world_camera)


def _edges(map_: PointLineMap, living: list[Keyframe], row: Array, T: Array, loops: list[Loop],
           config: LoopConfig) -> PoseEdges:
    """Steps from keyframe to keyframe, pairs that share many landmarks, and loops, these last."""
    step = np.arange(len(living) - 1)
    a, b = np.nonzero(np.triu(shared_landmarks(map_, living) >= config.edge_landmarks, 2))
    a, b = np.concatenate([step, a]), np.concatenate([step + 1, b])
    measured = se3.inverse(T[a]) @ T[b]
    robust = np.arange(len(a)) >= len(step)
    part = np.array([k.part for k in living])
    loose = np.where(part[a] == part[b], 1.0, _LOOSE)
    ends = [(row[a], row[b], T_a_b) for a, b, T_a_b in (between_living(map_, x) for x in loops)
            if a != b]
    a = np.concatenate([a, [e[0] for e in ends]]).astype(np.int64)
    b = np.concatenate([b, [e[1] for e in ends]]).astype(np.int64)
    measured = np.concatenate([measured, [e[2] for e in ends]])
    robust = np.concatenate([robust, np.ones(len(ends), bool)])
    loose = np.concatenate([loose, np.ones(len(ends))])
    sigma = np.stack([_TURN_RAD + _TURN_SHARE * se3.rotation_angle(measured[:, :3, :3]),
                      _WAY_M + _WAY_SHARE * np.linalg.norm(measured[:, :3, 3], axis=1)], axis=1)
    return PoseEdges(a, b, measured, sigma * loose[:, None], robust)


def between_living(map_: PointLineMap, loop: Loop) -> tuple[int, int, Array]:
    """Numbers a, b of the living keyframes that a loop ties, and T_a_b (4, 4).

    A keyframe that is gone hangs on another one, and so does what it measured.
    """
    (a, T_a_old), (b, T_b_new) = (map_.holder(k.number) for k in (loop.old, loop.keyframe))
    return a.number, b.number, T_a_old @ loop.T_old_keyframe @ se3.inverse(T_b_new)


def bent(T_world_camera: Array, old: int, new: int, T_old_new: Array) -> Array:
    """Poses (A, 4, 4) with the gap of a loop spread evenly over the way between its ends.

    What came after the loop goes along whole. With the gap left in one place a robust kernel
    might take the edges there for wrong.
    """
    T = T_world_camera
    way = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(way + 1e-6)])
    share = np.clip((way - way[old]) / (way[new] - way[old]), 0.0, 1.0)
    wanted = T[old] @ T_old_new
    turn = se3.exp_so3(share[:, None] * se3.log_so3(wanted[:3, :3] @ T[new, :3, :3].T))
    move = share[:, None] * (wanted[:3, 3] - T[new, :3, 3])
    return np.asarray(se3.from_rotation_translation(turn @ T[:, :3, :3], T[:, :3, 3] + move))
