"""Dynamic features of a frame: corners and line ends that the camera's motion does not explain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slam.dpl.config import DplConfig
from slam.dpl.culling import (
    StillGround,
    cull_lines,
    full_boxes,
    inside_boxes,
    usable_boxes,
)
from slam.dpl.epipolar import epipolar_distance, follow, fundamental
from slam.dpl.features import Features
from slam.dpl.orb import spread
from slam.dpl.pose import refine_pose
from slam.dpl.sightings import Sightings
from slam.frontend.sampling import nearest
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import back_project, project
from slam.geometry.resection import resect
from slam.geometry.segment import unit_normals
from slam.spread import MEDIAN_CHI2_2, sigma_of_distances, sigma_of_lengths
from slam.types import Boxes2D, Intrinsics

_MIN_OUTSIDE = 40        # corners outside all boxes that may tell the camera's motion alone
_MIN_FOR_MOTION = 12     # corners with depth
_JUDGES = 120            # corners that tell the motion, spread over the image
_ROUNDS = 4              # renewals of the noise measured
_FIRST_SIGMA_PX = 0.5    # before
_LEAST_RATIO = 0.06      # of the variance measured to the one assumed, in one round
_KERNEL, _ITERATIONS = 2.0, 8            # of each round's fit
_RANSAC_PX, _RANSAC_TRIES = 1.5, 100
_BLUR_SIGMAS = 3.0       # of the depth, that may shift a corner
_SMALLEST_SIGMA_PX = 0.05
_RING = np.stack(np.meshgrid([-2.0, 0.0, 2.0], [-2.0, 0.0, 2.0]), axis=-1).reshape(9, 2)
_ONE_SURFACE = 1.1       # largest ratio of depths around a corner that lies on one surface
_RANGE_SIGMAS = 4.0      # of nine noisy depths of one surface, from the least to the greatest
_OVERLAP = 0.3           # of boxes in successive frames, to be of one thing
_MAX_BOXES = 100         # the largest scores are kept


@dataclass(frozen=True, slots=True)
class Culled:
    """What stays of a frame, and why the rest went."""

    points: Array        # (N,) bool: static
    lines: Array         # (L,) bool: static
    ground: StillGround


@dataclass(frozen=True, slots=True)
class Moved:
    """What was found to move between the frame before and this one."""

    tested_px: Array     # (T, 2) where corners and line ends that could be followed are now
    dynamic_px: Array    # (D, 2) those of them that moved
    boxes: Array         # (B, 4) usable boxes of this frame


@dataclass(slots=True)
class _Seen:
    gray: Array
    depth_m: Array
    corners_px: Callable[[], Array]      # (N, 2), once they are asked for
    ends_px: Array       # (L, 2, 2)


class MoverCuller:
    """Compares each frame with the one before (III-B)."""

    def __init__(self, camera: Intrinsics, config: DplConfig) -> None:
        self.camera, self.config = camera, config
        self._before: _Seen | None = None
        self._moved: list[tuple[Array, float]] = []      # box, when something last moved in it

    def test(self, gray: Array, depth_m: Array, boxes: Boxes2D | None, T_a_b: Array,
             corners_px: Callable[[], Array]) -> Moved:
        """What moved since the last frame.

        Args:
            T_a_b: (4, 4) the motion expected since then.
            corners_px: this frame's corners (N, 2), which are asked for with the next frame.
        """
        before, area = self._before, self._usable(boxes)
        self._before = _Seen(gray, depth_m, corners_px, np.zeros((0, 2, 2)))
        if before is None or before.gray.shape != gray.shape:
            return Moved(np.zeros((0, 2)), np.zeros((0, 2)), area)
        tested, dynamic = self._test(before, gray, depth_m, area, T_a_b)
        return Moved(tested, dynamic, area)

    def cull(self, features: Features, moved: Moved, stamp_s: float) -> Culled:
        """Which features of the frame just tested stay (Algorithm 1)."""
        assert self._before is not None
        self._before.ends_px = features.lines.ends_px
        return self._cull(features, moved.tested_px, moved.dynamic_px, moved.boxes, stamp_s)

    def _usable(self, boxes: Boxes2D | None) -> Array:
        if boxes is None or not len(boxes.corners_px):
            return np.zeros((0, 4))
        good = usable_boxes(boxes.corners_px, self.camera.width, self.camera.height)
        best = np.argsort(-boxes.score[good], kind="stable")[:_MAX_BOXES]
        return np.asarray(boxes.corners_px[good][best], dtype=np.float64)

    def _test(self, before: _Seen, gray: Array, depth_m: Array, area: Array, T_a_b: Array
              ) -> tuple[Array, Array]:
        """Where corners and line ends are now (N, 2), and those (D, 2) of them that moved."""
        c, corners_px = self.config.cull, before.corners_px()
        pixels = np.concatenate([corners_px, before.ends_px.reshape(-1, 2)])
        is_corner = np.arange(len(pixels)) < len(corners_px)
        across = _across(before.ends_px, len(corners_px))
        pair = follow(before.gray, gray, pixels, c.border_px, c.patch_difference,
                      self._expected(before, pixels, T_a_b))
        a, b, across = pair.before_px[pair.good], pair.now_px[pair.good], across[pair.good]
        is_corner = is_corner[pair.good]
        outside = ~inside_boxes(b, area).any(axis=0) & is_corner
        judges = outside if np.count_nonzero(outside) >= _MIN_OUTSIDE else is_corner
        judges = _spread_out(judges, b, gray.shape)
        moved = np.zeros(len(a), bool)
        F = fundamental(a[judges], b[judges], c.epipolar_px)
        if F is not None:
            distance = epipolar_distance(F, a, b)
            moved = distance > self._limit(sigma_of_distances(_finite(distance[judges])))
        if c.depth_aware:
            known, by_depth = self._by_depth(before, a, b, across, depth_m, judges, T_a_b)
            # Where the whole shift is known, it outdoes eq. (4), which sees one part of it.
            moved = np.where(known, by_depth, moved)
        return b, b[moved]

    def _expected(self, before: _Seen, pixels: Array, T_a_b: Array) -> Array:
        """Where pixels (N, 2) should be if nothing moves; where they are if depth is unknown."""
        depth = nearest(before.depth_m, pixels)
        xyz = back_project(self.camera, pixels, np.where(depth > 0, depth, np.nan))
        return project(self.camera, se3.transform_points(se3.inverse(T_a_b), xyz))

    def _by_depth(self, before: _Seen, a: Array, b: Array, across: Array, depth_m: Array,
                  judges: Array, T_a_b: Array) -> tuple[Array, Array]:
        """Where depth is known around a pixel (N,), and whether it moved (N,), in full."""
        c, sigma = self.config.cull, self.config.depth.inverse_depth_sigma
        near_a, far_a = _depth_range(before.depth_m, a)
        near_b, far_b = _depth_range(depth_m, b)
        known = _one_surface(near_a, far_a, sigma)
        depth_a = 2.0 / (1.0 / np.where(known, near_a, 1.0) + 1.0 / np.where(known, far_a, 1.0))
        xyz = back_project(self.camera, a, depth_a)
        use = judges & known
        if np.count_nonzero(use) < _MIN_FOR_MOTION:
            return np.zeros(len(a), bool), np.zeros(len(a), bool)
        T_a_b = self._motion(xyz[use], b[use], T_a_b)
        xyz_b = se3.transform_points(se3.inverse(T_a_b), xyz)
        with np.errstate(invalid="ignore"):
            off = project(self.camera, xyz_b) - b
            gap = np.where(np.isfinite(across[:, 0]), np.abs(np.sum(off * across, axis=1)),
                           np.linalg.norm(off, axis=1))
            # The pixel's shift by an error of inverse depth: f |t| at most, per unit of it.
            blur = _BLUR_SIGMAS * sigma * self.camera.fx * np.linalg.norm(T_a_b[:3, 3])
            rho_b = 1.0 / np.where(xyz_b[:, 2] > 0, xyz_b[:, 2], np.inf)
            far_off = c.depth_sigmas * sigma
            surface = _one_surface(near_b, far_b, sigma)
            leaves = surface & ((rho_b > 1.0 / np.where(surface, near_b, 1.0) + far_off)
                                | (rho_b < 1.0 / np.where(surface, far_b, 1.0) - far_off))
            limit = self._limit(sigma_of_lengths(_finite(gap[use])))
            return known, ~(gap <= limit + blur) | leaves

    def _limit(self, sigma_px: float) -> float:
        """How far off a corner may be: blur and rolling shutter spread even what stands still."""
        return max(self.config.cull.epipolar_px, self.config.cull.spreads * sigma_px)

    def _motion(self, xyz_a: Array, uv_b: Array, T_a_b: Array) -> Array:
        """The camera's motion that most pixels support: P3P in RANSAC, then refined."""
        found = resect(xyz_a, uv_b, self.camera, _RANSAC_PX, _RANSAC_TRIES)
        if found is not None:
            T_a_b = found[0]
        n, sigma_px = len(uv_b), _FIRST_SIGMA_PX
        for _ in range(_ROUNDS):
            # A kernel wider than the noise lets a few corners of a mover pull on the rest.
            pixels = np.tile([1.0 / sigma_px, 0.0, 1.0 / sigma_px, 0.0], (n, 1))
            fit = refine_pose(T_a_b, xyz_a, Sightings(uv_b, pixels, np.zeros(n)), self.camera,
                              _KERNEL, _ITERATIONS)
            T_a_b = fit.T_world_camera
            ratio = np.median(fit.chi2) / MEDIAN_CHI2_2
            sigma_px *= float(np.sqrt(np.clip(ratio, _LEAST_RATIO, 1.0)))
            sigma_px = max(sigma_px, _SMALLEST_SIGMA_PX)
        return T_a_b

    def _cull(self, features: Features, tested: Array, dynamic: Array, area: Array,
              stamp_s: float) -> Culled:
        c = self.config.cull
        points = features.points.uv_px
        full = full_boxes(dynamic, points, area, c.share, c.share_of, tested)
        full = self._with_memory(area, full, stamp_s)
        ground = StillGround(dynamic, area, full, c.near_px, c.near_outside_px)
        return Culled(ground.holds(points),
                      cull_lines(features.lines.ends_px, dynamic, area, full, c.near_px,
                                 c.near_outside_px), ground)

    def _with_memory(self, area: Array, full: Array, stamp_s: float) -> Array:
        """Boxes that go whole, now or because their thing moved a short while ago."""
        stay = self.config.cull.stay_dynamic_s
        held = [(box, t) for box, t in self._moved if 0.0 <= stamp_s - t <= stay]
        kept: list[tuple[Array, float]] = [(box, stamp_s) for box in area[full]]
        still = full.copy()
        for box, t in held:
            overlap = _overlaps(box, area)
            best = int(np.argmax(overlap)) if len(area) else -1
            if best >= 0 and overlap[best] > _OVERLAP and not full[best]:
                still[best] = True
                kept.append((area[best], t))
        self._moved = kept
        return still


def _finite(distance_px: Array) -> Array:
    """Those of them (N,) that are a number; none: a single 0."""
    finite = distance_px[np.isfinite(distance_px)]
    return finite if len(finite) else np.zeros(1)


def _spread_out(judges: Array, uv_px: Array, shape: tuple[int, ...]) -> Array:
    """(N,) bool: some of the judges (N,), evenly over the image.

    What fills most of the picture counts as the world, however rich in corners a mover is.
    """
    rows = np.flatnonzero(judges)
    kept = spread(uv_px[rows], np.zeros(len(rows)), shape, _JUDGES)
    out = np.zeros(len(uv_px), bool)
    out[rows[kept]] = True
    return out


def _across(ends_px: Array, corners: int) -> Array:
    """(N, 2) unit normals of the segments that ends belong to, along which they may slide; NaN
    for the corners before them, which may not."""
    return np.concatenate([np.full((corners, 2), np.nan),
                           np.repeat(unit_normals(ends_px), 2, axis=0)])


def _depth_range(depth_m: Array, uv: Array) -> tuple[Array, Array]:
    """Least and greatest depth (N,) around pixels; 0 where one of them is unknown."""
    around = nearest(depth_m, uv[:, None] + _RING)
    known = (np.isfinite(around) & (around > 0)).all(axis=1)
    return np.where(known, around.min(axis=1), 0.0), np.where(known, around.max(axis=1), 0.0)


def _one_surface(near_m: Array, far_m: Array, inverse_depth_sigma: float) -> Array:
    """(N,) bool: whether depths that range so lie on one surface.

    Far away noise alone spreads them.
    """
    safe = np.where(near_m > 0, near_m, 1.0)
    noise = _RANGE_SIGMAS * inverse_depth_sigma
    return np.asarray((near_m > 0) & ((far_m <= _ONE_SURFACE * safe)
                                      | (1.0 / safe - 1.0 / np.maximum(far_m, safe) <= noise)))


def _overlaps(box: Array, boxes: Array) -> Array:
    """(B,) area in common over area of both."""
    low, high = np.maximum(box[:2], boxes[:, :2]), np.minimum(box[2:], boxes[:, 2:])
    common = np.prod(np.maximum(high - low, 0.0), axis=1)
    both = np.prod(box[2:] - box[:2]) + np.prod(boxes[:, 2:] - boxes[:, :2], axis=1) - common
    return np.asarray(common / np.maximum(both, 1e-9))
