"""Points anchored in the picture of their first frame, found again in each later frame.

A track that is followed from frame to frame adds up the errors of its steps: a random walk, which
holds no more of the poses than the steps do. Aligned with its first picture, a landmark errs by
one alignment in each frame, however long it lives, and so ties poses far apart together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam.backend.atlas import Atlas
from slam.backend.config import AnchorConfig
from slam.backend.frame_bodies import FrameBodies
from slam.config import NoiseConfig
from slam.frontend.observe import NO_GROUP
from slam.frontend.points import PointConfig, corner_response, detect_points
from slam.frontend.refine import RefineConfig, refine_matches
from slam.frontend.sampling import nearest
from slam.frontend.support import patch_support
from slam.frontend.surface import SurfacePatches, carried, fit_surfaces
from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.map import STATIC, Features, PointLandmarks, PointObservations
from slam.tables import joined, taken
from slam.types import Intrinsics

_OUTSIDE_PX = -1e6      # where what has no place in the image is put


@dataclass(frozen=True, slots=True)
class _Anchors:
    """The landmarks alive, with what their first frame told."""

    number: Array        # (N,)
    body: Array          # (N,)
    slot: Array          # (N,) of the piece of its picture
    T_body_first: Array  # (N, 4, 4) pose of the camera that saw it first
    uv: Array            # (N, 2) px there
    rho: Array           # (N,) 1/m there
    slope: Array         # (N, 2) 1/m/px there
    uv_now: Array        # (N, 2) where it was last seen
    missed: Array        # (N,) frames in a row

    def __len__(self) -> int:
        return len(self.number)


def _no_anchors() -> _Anchors:
    none = np.zeros(0, np.int64)
    return _Anchors(none, none, none, np.zeros((0, 4, 4)), np.zeros((0, 2)), np.zeros(0),
                    np.zeros((0, 2)), np.zeros((0, 2)), none)


class PointAnchors:
    """Finds points again in each frame, and detects new ones where there are too few."""

    def __init__(self, intrinsics: Intrinsics, config: AnchorConfig, noise: NoiseConfig,
                 features: Features[PointLandmarks, PointObservations]) -> None:
        self.intrinsics, self.config, self.noise = intrinsics, config, noise
        self.features = features
        self.corners = PointConfig(object_count=config.object_count)
        self.align = RefineConfig(without_ramps=True, min_correlation=0.95)
        self._atlas = Atlas(self.align.radius_px)
        self._alive = _no_anchors()

    def follow(self, now: FrameBodies) -> None:
        """Record one frame's sightings of the landmarks that are known."""
        self._keep(now.has(self._alive.body))              # bodies that ended took theirs along
        turn = now.is_due(self._alive.body)
        alive = taken(self._alive, np.flatnonzero(turn))
        if len(alive) == 0:
            return
        expected, rho_expected, warps = carried(self.intrinsics, alive.uv, alive.rho, alive.slope,
                                                now.since(alive.T_body_first, alive.body))
        expected = np.where(rho_expected[:, None] > 0, expected, _OUTSIDE_PX)
        aligned = refine_matches(self._atlas.image, now.smooth,
                                 self._atlas.positions(alive.slot, alive.uv), expected, self.align,
                                 warps)
        uv, found = aligned.uv_current, np.array(aligned.converged)
        found[found] = nearest(now.groups, uv[found]) == now.slot(alive.body[found])
        seen = np.flatnonzero(found)
        surface = self._surface(now, uv[seen])
        measured = surface.rho > 0
        change = np.abs(surface.rho - rho_expected[seen])
        allowed = (self.config.max_depth_change * rho_expected[seen]
                   + 4.0 * self.noise.inverse_depth_sigma * surface.gain)
        right = ~measured | (change < allowed)
        found[seen[~right]] = False
        seen = seen[right]
        sigma = np.where(measured, self.noise.inverse_depth_sigma * surface.gain, np.inf)[right]
        # Both pictures of an alignment err alike; each sighting, the first one too, has its half.
        self.features.add_observations(PointObservations(
            alive.number[seen], np.full(len(seen), now.row), uv[seen],
            0.5 * aligned.covariance[seen], surface.rho[right], sigma))
        missed, uv_now = np.array(self._alive.missed), np.array(self._alive.uv_now)
        missed[turn] = np.where(found, 0, alive.missed + 1)
        uv_now[turn] = np.where(found[:, None], uv, alive.uv_now)
        self._alive = replace(self._alive, missed=missed, uv_now=uv_now)
        self._keep(missed <= self.config.misses)

    def detect(self, now: FrameBodies) -> None:
        """New landmarks on the bodies that have too few."""
        alive = self._alive
        wanted = self.config.static_count - int(np.count_nonzero(alive.body == STATIC))
        uv, _ = detect_points(corner_response(now.current.gray), max(wanted, 0),
                              now.groups.astype(np.int32), alive.uv_now, self.corners)
        slot = nearest(now.groups, uv)
        uv, slot = uv[slot != NO_GROUP], slot[slot != NO_GROUP]
        # A patch over the edge of a thing moves with the thing; what lies behind does not.
        support = patch_support(now.surface, uv, self.align.radius_px).mean(axis=0)
        keep = np.flatnonzero(support >= self.config.min_support)
        keep = keep[has_room(now.bodies[slot[keep]], alive.body, self.config.object_count)]
        surface = self._surface(now, uv[keep])
        known = surface.rho > 0
        keep, rho, slope, gain = (keep[known], surface.rho[known], surface.slope[known],
                                  surface.gain[known])
        uv, body, n = uv[keep], now.bodies[slot[keep]], len(keep)
        if n == 0:
            return
        poses = now.T_body_camera[slot[keep]]
        in_camera = pinhole.back_project(self.intrinsics, uv, 1.0 / rho)
        xyz = np.einsum("nij,nj->ni", poses[:, :3, :3], in_camera) + poses[:, :3, 3]
        numbers = self.features.add_landmarks(body, xyz)
        self._alive = joined(alive, _Anchors(numbers, body, self._atlas.put(now.smooth, uv), poses,
                                             uv, rho, slope, uv, np.zeros(n, np.int64)))
        # Its share of the alignments' noise is known only from them: the batch fills it in.
        self.features.add_observations(PointObservations(
            numbers, np.full(n, now.row), uv, np.full((n, 2, 2), np.nan), rho,
            self.noise.inverse_depth_sigma * gain))

    def _keep(self, kept: Array) -> None:
        self._atlas.release(self._alive.slot[~kept])
        self._alive = taken(self._alive, np.flatnonzero(kept))

    def _surface(self, now: FrameBodies, uv: Array) -> SurfacePatches:
        return fit_surfaces(now.current.rho, now.current.label_index, uv,
                            self.noise.inverse_depth_sigma)


def has_room(body: Array, alive: Array, count: int) -> Array:
    """(N,) bool: of new landmarks, so many of each object as it has too few."""
    room = np.ones(len(body), bool)
    for b in np.unique(body[body != STATIC]):
        own = np.flatnonzero(body == b)
        room[own[max(count - int(np.count_nonzero(alive == b)), 0):]] = False
    return room
