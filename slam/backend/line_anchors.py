"""Lines anchored in the picture of their first frame, found again in each later frame.

As points are (slam.backend.anchors): patches along a segment are aligned with the first picture,
each across the line only, and a robust straight fit gives the offsets of the ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam.backend.anchors import has_room
from slam.backend.atlas import Atlas
from slam.backend.config import AnchorConfig
from slam.backend.frame_bodies import FrameBodies
from slam.config import NoiseConfig
from slam.frontend.follow import match_segments
from slam.frontend.observe import NO_GROUP
from slam.frontend.patches import fits
from slam.frontend.refine import RefineConfig, RefinedMatches, refine_matches
from slam.frontend.refine_lines import LineRefineConfig, fitted_segments
from slam.frontend.sampling import nearest
from slam.frontend.segments import SegmentConfig, cull_segments
from slam.frontend.support import patch_support
from slam.frontend.surface import carried
from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.geometry.line import orthonormal_from_plucker, plucker_from_points
from slam.line_sightings import packed
from slam.map import STATIC, Features, LineLandmarks, LineObservations
from slam.tables import joined, taken
from slam.types import Intrinsics, Segments2D

_OUTSIDE_PX = -1e6      # where what has no place in the image is put
_SHORTEST_PX = 12.0     # as seen now: a shorter segment has no direction to speak of
_MIN_LENGTH_M = 1e-3


@dataclass(frozen=True, slots=True)
class _Lines:
    """The lines alive, with what their first frame told; K patches on each."""

    number: Array        # (N,)
    body: Array          # (N,)
    slot: Array          # (N, K) of the pieces of its picture
    T_body_first: Array  # (N, 4, 4) pose of the camera that saw it first
    ends: Array          # (N, 2, 2) px there
    rho: Array           # (N, 2) 1/m there
    ends_now: Array      # (N, 2, 2) px where it was last seen
    missed: Array        # (N,) frames in a row

    def __len__(self) -> int:
        return len(self.number)


class LineAnchors:
    """Finds lines again in each frame, and takes up the tracker's where there are too few."""

    def __init__(self, intrinsics: Intrinsics, config: AnchorConfig, noise: NoiseConfig,
                 features: Features[LineLandmarks, LineObservations]) -> None:
        self.intrinsics, self.config, self.noise = intrinsics, config, noise
        self.features = features
        self.align = LineRefineConfig(samples=config.line_samples, patch=RefineConfig(
            radius_px=3, window_sigma_px=2.0, without_ramps=True, min_correlation=0.9))
        self.depth = SegmentConfig(samples=config.line_samples)
        self._atlas = Atlas(self.align.patch.radius_px)
        none, k = np.zeros(0, np.int64), config.line_samples
        self._alive = _Lines(none, none, np.zeros((0, k), np.int64), np.zeros((0, 4, 4)),
                             np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)), none)

    def follow(self, now: FrameBodies) -> None:
        """Record one frame's sightings of the lines that are known."""
        self._keep(now.has(self._alive.body))
        turn = now.is_due(self._alive.body)
        alive = taken(self._alive, np.flatnonzero(turn))
        if len(alive) == 0:
            return
        ends, rho_ends, start, normal, t, matches = self._aligned(now, alive)
        fitted = fitted_segments(ends, t, start, normal, matches, self.align)
        seen = np.flatnonzero(fitted.converged & (rho_ends > 0).all(axis=1))
        kept, slot, depth = cull_segments(fitted.endpoints_px[seen], now.current.frame.depth_m,
                                          now.groups, self.depth)
        rho = np.where(depth > 0, 1.0 / np.where(depth > 0, depth, 1.0), 0.0)
        change = np.abs(rho - rho_ends[seen])
        sigma = 0.5 * self.noise.inverse_depth_sigma     # of a straight fit through them all
        right = (kept & (slot == now.slot(alive.body[seen]))
                 & (change < self.config.max_depth_change * rho_ends[seen] + 4.0 * sigma
                    ).all(axis=1))
        seen, rho = seen[right], rho[right]
        # Both pictures of an alignment err alike; each sighting, the first one too, has its half.
        self.features.add_observations(LineObservations(
            alive.number[seen], np.full(len(seen), now.row), fitted.endpoints_px[seen],
            0.5 * fitted.covariance[seen], rho, np.full((len(seen), 2), sigma)))
        found = np.zeros(len(alive), bool)
        found[seen] = True
        missed, ends_now = np.array(self._alive.missed), np.array(self._alive.ends_now)
        missed[turn] = np.where(found, 0, alive.missed + 1)
        ends_now[turn] = np.where(found[:, None, None], fitted.endpoints_px, alive.ends_now)
        self._alive = replace(self._alive, missed=missed, ends_now=ends_now)
        self._keep(missed <= self.config.misses)

    def _aligned(self, now: FrameBodies, alive: _Lines
                 ) -> tuple[Array, Array, Array, Array, Array, RefinedMatches]:
        """The lines where they are expected, and their patches aligned across them."""
        n, k = alive.slot.shape
        uv, rho, slope = _samples(alive.ends, alive.rho, k)
        T_now_first = now.since(alive.T_body_first, alive.body)
        at, rho_now, warps = carried(
            self.intrinsics, np.concatenate([uv, alive.ends], axis=1).reshape(-1, 2),
            np.concatenate([rho, alive.rho], axis=1).reshape(-1),
            np.repeat(slope, k + 2, axis=0), np.repeat(T_now_first, k + 2, axis=0))
        at, rho_now = at.reshape(n, k + 2, 2), rho_now.reshape(n, k + 2)
        start, ends = at[:, :k], at[:, k:]
        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=-1)
        there = (rho_now > 0).all(axis=1) & (length > _SHORTEST_PX)
        safe = np.where(there, length, 1.0)
        normal = np.stack([-along[:, 1], along[:, 0]], axis=-1) / safe[:, None]
        t = np.einsum("nkc,nc->nk", start - ends[:, :1], along) / safe[:, None]**2
        start = np.where(there[:, None, None], start, _OUTSIDE_PX)
        matches = refine_matches(
            self._atlas.image, now.smooth, self._atlas.positions(alive.slot.reshape(-1),
                                                                 uv.reshape(-1, 2)),
            start.reshape(-1, 2), self.align.patch,
            warps.reshape(n, k + 2, 2, 2)[:, :k].reshape(-1, 2, 2),
            direction=np.repeat(normal, k, axis=0))
        return ends, np.where(there[:, None], rho_now[:, k:], -1.0), start, normal, t, matches

    def detect(self, now: FrameBodies, segments: Segments2D) -> None:
        """Take up lines of the tracker on the bodies that have too few."""
        alive, k = self._alive, self.config.line_samples
        new = np.ones(len(segments), bool)
        on = match_segments(alive.ends_now, segments.endpoints_px)
        new[on[on >= 0]] = False
        uv, _, _ = _samples(segments.endpoints_px, _inverse(segments.depth_m), k)
        slot = nearest(now.groups, uv)                                          # (N, K)
        inside = fits(uv.reshape(-1, 2), now.smooth.shape, self.align.patch.radius_px + 1)
        new &= ((slot == slot[:, :1]) & (slot != NO_GROUP)
                & inside.reshape(-1, k)).all(axis=1) & (segments.depth_m > 0).all(axis=1)
        index = np.flatnonzero(new)
        # On the edge of a thing, a patch sees what lies behind it, too.
        support = patch_support(now.surface, uv[index].reshape(-1, 2), self.align.patch.radius_px)
        index = index[support.mean(axis=0).reshape(-1, k).mean(axis=1) >= self.config.min_support]
        length = np.linalg.norm(np.diff(segments.endpoints_px[index], axis=1)[:, 0], axis=-1)
        index = index[np.argsort(-length, kind="stable")]
        body = now.bodies[slot[index, 0]]
        static = body == STATIC
        wanted = self.config.static_lines - int(np.count_nonzero(alive.body == STATIC))
        room = has_room(body, alive.body, self.config.object_lines)
        room[static] = np.arange(np.count_nonzero(static)) < wanted
        self._add(now, segments.endpoints_px[index[room]],
                  _inverse(segments.depth_m[index[room]]), uv[index[room]], slot[index[room], 0])

    def _add(self, now: FrameBodies, ends: Array, rho: Array, uv: Array, slot: Array) -> None:
        points = pinhole.back_project(self.intrinsics, ends.reshape(-1, 2), 1.0 / rho.reshape(-1))
        T = now.T_body_camera[slot]
        both = (np.einsum("nij,nej->nei", T[:, :3, :3], points.reshape(-1, 2, 3))
                + T[:, None, :3, 3])
        long = np.linalg.norm(both[:, 1] - both[:, 0], axis=1) > _MIN_LENGTH_M
        ends, rho, uv, slot, both, T = (part[long] for part in (ends, rho, uv, slot, both, T))
        n = len(ends)
        if n == 0:
            return
        body = now.bodies[slot]
        lines = packed(orthonormal_from_plucker(plucker_from_points(both[:, 0], both[:, 1])))
        numbers = self.features.add_landmarks(body, lines)
        slots = self._atlas.put(now.smooth, uv.reshape(-1, 2)).reshape(n, -1)
        self._alive = joined(self._alive, _Lines(numbers, body, slots, T, ends, rho, ends,
                                                 np.zeros(n, np.int64)))
        # Its share of the alignments' noise is known only from them: the batch fills it in.
        self.features.add_observations(LineObservations(
            numbers, np.full(n, now.row), ends, np.full((n, 2, 2), np.nan), rho,
            np.full((n, 2), 0.5 * self.noise.inverse_depth_sigma)))

    def _keep(self, kept: Array) -> None:
        self._atlas.release(self._alive.slot[~kept].reshape(-1))
        self._alive = taken(self._alive, np.flatnonzero(kept))


def _inverse(depth_m: Array) -> Array:
    return np.asarray(1.0 / np.where(depth_m > 0, depth_m, np.inf))


def _samples(ends: Array, rho: Array, count: int) -> tuple[Array, Array, Array]:
    """Places on segments (N, 2, 2), off their ends: px (N, K, 2), 1/m (N, K), slope (N, 2) of ρ.

    Inverse depth is linear along the image of a straight line.
    """
    along = ends[:, 1] - ends[:, 0]
    squared = np.maximum(np.sum(along * along, axis=1), 1e-6)
    margin = np.minimum(3.0 / np.sqrt(squared), 0.25)[:, None]       # other edges meet at ends
    t = margin + (1.0 - 2.0 * margin) * np.linspace(0.0, 1.0, count)
    uv = ends[:, None, 0] + t[..., None] * along[:, None]
    slope = (rho[:, 1] - rho[:, 0])[:, None] * along / squared[:, None]
    return uv, rho[:, :1] + t * (rho[:, 1:] - rho[:, :1]), slope
