"""Which of the motions solved between two frames are believed, and the features that bear them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slam.config import SdplConfig
from slam.dynamics.scene_flow import Followers
from slam.estimation.covariance import rotation_sigma, sharing
from slam.estimation.motion import Motions
from slam.frontend.follow import REFINED_KIND
from slam.frontend.grid import OBJECT_GRID_KIND
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.matches import PointMatches
from slam.systems.matched import Matched
from slam.types import Intrinsics


@dataclass(frozen=True, slots=True)
class ObjectMotion:
    """One object between two frames, still in the previous camera."""

    label: int                 # in the current frame
    relative: Array            # (4, 4) its motion against the static world, in camera a
    information: Array         # (6, 6) of its pose T_a_b
    followers: Followers
    rigidity: float
    inliers: int
    sharing: float             # by how much the information is too bold: patches that overlap


@dataclass(frozen=True, slots=True)
class Tracked:
    """All motions between two frames, and the features that followed them."""

    T_a_b: Array                         # (4, 4) the camera's
    information: Array                   # (6, 6)
    objects: tuple[ObjectMotion, ...]
    left_out: tuple[tuple[int, str], ...]   # mask label now, why it has no motion
    point_index: Array                   # (P,) features of the previous frame that live on
    point_uv: Array                      # (P, 2)
    line_index: Array                    # (L,)
    line_endpoints: Array                # (L, 2, 2)
    inlier_points: int
    inlier_lines: int
    lost_because: str = ""
    sharing: float = 1.0                 # as ObjectMotion's, and errors that hang together
    depth_error: float = 0.0             # 1/m, what a thing's depths err by together


@dataclass(frozen=True)
class Solved:
    """What the solver found, and what it rests on."""

    matched: Matched
    motions: Motions
    labels: list[int]          # in the current frame; of groups 1, 2, …
    parked: Array              # groups that stand, and were solved with the static world
    on_images: bool            # the corners were aligned on the images
    patch_px: float            # side of the corners' patches
    clustering: float          # of the camera's errors, over the last frames
    depth_error: float         # 1/m, what a thing's depths err by together, as known so far
    object_flow_scale: float   # noise of an object's cells over the stated one, as known so far

    @cached_property
    def sharing(self) -> Array:
        """(G,) by how much each group's information is too bold: patches that overlap, and of the
        camera what is measured of errors that hang together."""
        groups = len(self.motions.T_a_b)
        corners = self.matched.corners
        out = (np.asarray(sharing(corners.uv_a, corners.group, groups, self.patch_px))
               if self.on_images else np.ones(groups))
        out[0] = max(out[0], self.clustering)
        return out


def judged(solved: Solved, why: dict[int, str], intrinsics: Intrinsics,
           config: SdplConfig) -> Tracked:
    """The motions that enough features follow, and the features that live on.

    Args:
        why: groups that were left out before, and the reason.
    """
    own, motions = solved.matched.every, solved.motions
    good = motions.point_chi[: len(own)] < config.motion.point_gate
    static = np.isin(own.group, [0, *solved.parked])
    lines_good = np.flatnonzero(motions.line_chi < config.motion.line_gate)
    still_lines = int(np.count_nonzero(solved.matched.lines.group[lines_good] == 0))
    reason = _camera_unknown(solved, good, static, still_lines, config)
    if reason:
        return lost(reason)
    why, objects = dict(why), []
    for group in range(1, len(solved.labels) + 1):
        reason = why.get(group) or _object_unknown(solved, group, good, config)
        if reason:
            why[group] = reason
        else:
            objects.append(_object(solved, group, good, intrinsics, config.motion.point_gate))
    corners = slice(len(solved.matched.grid), len(own))
    alive = np.flatnonzero(good[corners])
    return Tracked(
        motions.T_a_b[0], motions.information[0], tuple(objects),
        tuple((solved.labels[g - 1], reason) for g, reason in sorted(why.items())),
        solved.matched.corner_index[alive], motions.refined_uv_b[: len(own)][corners][alive],
        solved.matched.line_index[lines_good], motions.refined_endpoints_b[lines_good],
        int(np.count_nonzero(good & static)), still_lines, sharing=float(solved.sharing[0]),
        depth_error=solved.depth_error)


def lost(reason: str) -> Tracked:
    """No motion at all, and why."""
    none = np.zeros(0, np.int64)
    return Tracked(np.eye(4), np.zeros((6, 6)), (), (), none, np.zeros((0, 2)), none,
                   np.zeros((0, 2, 2)), 0, 0, reason)


def followers_of(intrinsics: Intrinsics, matches: PointMatches, index: Array) -> Followers:
    """The points of the matches that `index` picks."""
    xyz_a = pinhole.back_project(intrinsics, matches.uv_a[index],
                                 1.0 / np.maximum(matches.rho_a[index], 1e-6))
    return Followers(np.asarray(xyz_a), np.where(np.isfinite(matches.rho_sigma_b[index]),
                                                 matches.rho_b[index], np.nan))


def _camera_unknown(solved: Solved, good: Array, static: Array, still_lines: int,
                    config: SdplConfig) -> str:
    share = float(np.mean(good[static])) if static.any() else 0.0
    if share < config.start.min_inlier_share:
        return f"{share:.0%} of the static matches follow one motion"
    if solved.on_images:
        # Flow estimated on an image without texture is the prediction, handed back.
        corners = _aligned(solved, static & good)
        if corners + 2 * still_lines < config.start.min_points:
            return f"{corners} corners and {still_lines} lines were found again"
    return ""


def _object_unknown(solved: Solved, group: int, good: Array, config: SdplConfig) -> str:
    members = solved.matched.every.group == group
    share = float(np.mean(good[members])) if members.any() else 0.0
    if share < config.dynamic.min_inlier_share:
        return f"{share:.0%} of its matches follow one motion"
    aligned = _aligned(solved, members & good)
    if solved.on_images and aligned < config.dynamic.min_matches:
        return f"{aligned} of its corners could be aligned"
    sigma = float(rotation_sigma(solved.motions.information[group]))
    if sigma > config.dynamic.max_rotation_sigma:
        return f"its rotation is known to {np.degrees(sigma):.1f}° only"
    return ""


def _aligned(solved: Solved, chosen: Array) -> int:
    return int(np.count_nonzero(chosen & (solved.matched.every.kind == REFINED_KIND)))


def _object(solved: Solved, group: int, good: Array, intrinsics: Intrinsics,
            gate: float) -> ObjectMotion:
    own, motions = solved.matched.every, solved.motions
    members = own.group == group
    # Against the static world's noise: an object that bends is not excused by its own.
    excess = motions.flow_scale[group, OBJECT_GRID_KIND] / solved.object_flow_scale
    rigid = motions.point_chi[: len(own)][members] * max(1.0, float(excess)) < gate
    followers = np.flatnonzero(members & good)
    return ObjectMotion(solved.labels[group - 1],
                        motions.T_a_b[0] @ se3.inverse(motions.T_a_b[group]),
                        motions.information[group],
                        followers_of(intrinsics, own, followers),
                        float(np.mean(rigid)), len(followers), float(solved.sharing[group]))
