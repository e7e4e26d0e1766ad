"""Landmarks anchored in the picture of their first frame, found again in each later frame.

A track that is followed from frame to frame adds up the errors of its steps: a random walk, which
holds no more of the poses than the steps do. Aligned with its first picture, a landmark errs by
one alignment in each frame, however long it lives, and so ties poses far apart together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from slam.backend.config import AnchorConfig
from slam.config import NoiseConfig
from slam.frontend.observe import NO_GROUP, Observation
from slam.frontend.points import PointConfig, corner_response, detect_points
from slam.frontend.refine import RefineConfig, prepare_image, refine_matches
from slam.frontend.sampling import nearest
from slam.frontend.support import patch_support, surface_image
from slam.frontend.surface import fit_surfaces
from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.map import STATIC, MapRecord, PointObservations
from slam.types import Intrinsics


@dataclass(frozen=True, slots=True)
class _Anchors:
    """The landmarks alive, with what their first frame told."""

    number: Array        # (N,)
    body: Array          # (N,)
    keyframe: Array      # (N,) row of the first frame
    uv: Array            # (N, 2) px there
    rho: Array           # (N,) 1/m there
    slope: Array         # (N, 2) 1/m/px there
    uv_now: Array        # (N, 2) where it was last seen
    missed: Array        # (N,) frames in a row

    def __len__(self) -> int:
        return len(self.number)

    def take(self, index: Array) -> _Anchors:
        return _Anchors(*(getattr(self, f.name)[index] for f in fields(self)))

    def join(self, other: _Anchors) -> _Anchors:
        return _Anchors(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)])
                          for f in fields(self)))


def _no_anchors() -> _Anchors:
    none = np.zeros(0, np.int64)
    return _Anchors(none, none, none, np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)),
                    np.zeros((0, 2)), none)


class AnchorTracker:
    """Finds landmarks again in each frame, and detects new ones where there are too few."""

    def __init__(self, intrinsics: Intrinsics, config: AnchorConfig, noise: NoiseConfig) -> None:
        self.intrinsics, self.config, self.noise = intrinsics, config, noise
        self.corners = PointConfig(object_count=config.object_count)
        self.align = RefineConfig(without_ramps=True, min_correlation=0.95)
        self._alive = _no_anchors()
        self._images: dict[int, Array] = {}         # row of a keyframe -> its smoothed image
        self._poses: dict[tuple[int, int], Array] = {}   # (body, keyframe) -> T_body_camera
        self._since_detection = 0

    def observe(self, row: int, current: Observation, T_body_camera: Mapping[int, Array],
                body_of_label: Mapping[int, int], record: MapRecord) -> None:
        """Add one frame's sightings to the record.

        Args:
            row: of the frame in the run.
            T_body_camera: body -> (4, 4) the tracker's pose of the camera in it.
            body_of_label: mask label in this frame -> body; labels that are not named are left
                out, and the background is the static world.
        """
        smooth = prepare_image(current.gray, self.align)
        bodies = sorted(T_body_camera)
        slot = {body: i for i, body in enumerate(bodies)}
        if STATIC not in slot or len(bodies) >= NO_GROUP:
            return
        groups = current.groups({label: slot[body] for label, body in body_of_label.items()
                                 if body in slot})
        table = np.full(max(bodies) + 1, -1)
        table[bodies] = np.arange(len(bodies))
        self._follow(row, current, smooth, groups, T_body_camera, table, record)
        self._since_detection += 1
        new_body = any(body not in self._alive.body for body in bodies)
        if self._since_detection >= self.config.every or new_body:
            self._detect(row, current, smooth, groups, T_body_camera, np.array(bodies), record)
            self._since_detection = 0
        needed = set(self._alive.keyframe.tolist())
        self._images = {k: image for k, image in self._images.items() if k in needed}
        self._poses = {key: T for key, T in self._poses.items() if key[1] in needed}

    def _follow(self, row: int, current: Observation, smooth: Array, groups: Array,
                T_body_camera: Mapping[int, Array], table: Array, record: MapRecord) -> None:
        alive = self._alive
        known = alive.body < len(table)
        known[known] = table[alive.body[known]] >= 0
        alive = alive.take(np.flatnonzero(known))          # bodies that ended took theirs along
        uv, covariance = np.zeros((len(alive), 2)), np.zeros((len(alive), 2, 2))
        rho_expected, found = np.zeros(len(alive)), np.zeros(len(alive), bool)
        for keyframe in np.unique(alive.keyframe):
            own = np.flatnonzero(alive.keyframe == keyframe)
            T_now_first = self._since(int(keyframe), alive.body[own], T_body_camera)
            expected, rho_expected[own], warps = carried(
                self.intrinsics, alive.uv[own], alive.rho[own], alive.slope[own], T_now_first)
            # What lies behind the camera has no place: put it outside the image.
            expected = np.where(rho_expected[own, None] > 0, expected, -1e6)
            aligned = refine_matches(self._images[int(keyframe)], smooth, alive.uv[own],
                                     expected, self.align, warps)
            uv[own], covariance[own] = aligned.uv_current, aligned.covariance
            found[own] = aligned.converged
        found[found] = nearest(groups, uv[found]) == table[alive.body[found]]
        surface = fit_surfaces(current.rho, current.label_index, uv, self.noise.inverse_depth_sigma)
        measured = surface.rho > 0
        change = np.abs(surface.rho - rho_expected)
        allowed = (self.config.max_depth_change * rho_expected
                   + 4.0 * self.noise.inverse_depth_sigma * surface.gain)
        found &= ~measured | (change < allowed)
        seen = np.flatnonzero(found)
        # Both pictures of an alignment err alike; each sighting, the first one too, has its half.
        record.points.add_observations(PointObservations(
            alive.number[seen], np.full(len(seen), row), uv[seen], 0.5 * covariance[seen],
            surface.rho[seen], self._rho_sigma(surface.gain[seen], measured[seen])))
        missed = np.where(found, 0, alive.missed + 1)
        alive = replace(alive, missed=missed, uv_now=np.where(found[:, None], uv, alive.uv_now))
        self._alive = alive.take(np.flatnonzero(missed <= self.config.misses))

    def _since(self, keyframe: int, body: Array, T_body_camera: Mapping[int, Array]) -> Array:
        """(N, 4, 4): from the camera at a keyframe to the camera now, as each body sees it."""
        out = np.empty((len(body), 4, 4))
        for b in np.unique(body):
            out[body == b] = (se3.inverse(T_body_camera[int(b)])
                              @ self._poses[(int(b), keyframe)])
        return out

    def _rho_sigma(self, gain: Array, measured: Array) -> Array:
        return np.where(measured, self.noise.inverse_depth_sigma * gain, np.inf)

    def _detect(self, row: int, current: Observation, smooth: Array, groups: Array,
                T_body_camera: Mapping[int, Array], bodies: Array, record: MapRecord) -> None:
        alive = self._alive
        labels = groups.astype(np.int32)
        wanted = self.config.static_count - int(np.count_nonzero(alive.body == STATIC))
        uv, _ = detect_points(corner_response(current.gray), max(wanted, 0), labels, alive.uv_now,
                              self.corners)
        slot = nearest(groups, uv)
        surface = fit_surfaces(current.rho, current.label_index, uv, self.noise.inverse_depth_sigma)
        keep = np.flatnonzero((surface.rho > 0) & (slot != NO_GROUP))
        # A patch over the edge of a thing moves with the thing; what lies behind does not.
        edges = surface_image(current.frame.depth_m, labels)
        support = patch_support(edges, uv[keep], self.align.radius_px).mean(axis=0)
        keep = keep[support >= self.config.min_support]
        keep = keep[self._has_room(bodies[slot[keep]])]
        uv, rho, body = uv[keep], surface.rho[keep], bodies[slot[keep]]
        if len(uv) == 0:
            return
        poses = np.stack([T_body_camera[int(b)] for b in bodies])[slot[keep]]
        in_camera = pinhole.back_project(self.intrinsics, uv, 1.0 / rho)
        xyz = np.einsum("nij,nj->ni", poses[:, :3, :3], in_camera) + poses[:, :3, 3]
        numbers = record.points.add_landmarks(body, xyz)
        n = len(uv)
        self._images[row] = smooth
        for b in bodies:
            self._poses[(int(b), row)] = T_body_camera[int(b)]
        self._alive = alive.join(_Anchors(numbers, body, np.full(n, row), uv, rho,
                                          surface.slope[keep], uv, np.zeros(n, np.int64)))
        # Its share of the alignments' noise is known only from them: the bundle fills it in.
        record.points.add_observations(PointObservations(
            numbers, np.full(n, row), uv, np.full((n, 2, 2), np.nan), rho,
            self._rho_sigma(surface.gain[keep], np.ones(n, bool))))

    def _has_room(self, body: Array) -> Array:
        """(N,) bool: so many new landmarks of each object as it has too few."""
        room = np.ones(len(body), bool)
        for b in np.unique(body[body != STATIC]):
            own = np.flatnonzero(body == b)
            free = self.config.object_count - int(np.count_nonzero(self._alive.body == b))
            room[own[max(free, 0):]] = False
        return room


def carried(camera: Intrinsics, uv: Array, rho: Array, slope: Array, T_b_a: Array
            ) -> tuple[Array, Array, Array]:
    """Where motions put pixels on inclined surfaces, and how they deform the image there.

    Args:
        uv, rho, slope: (N, 2) px, (N,) 1/m and (N, 2) ∂ρ/∂uv in camera a.
        T_b_a: (N, 4, 4) from camera a to b.
    Returns:
        uv (N, 2) and inverse depths (N,) in b (< 0 behind it), warps (N, 2, 2).
    """
    R, t = T_b_a[:, :3, :3], T_b_a[:, :3, 3]
    moved = np.einsum("nij,nj->ni", R, pinhole.rays(camera, uv)) + rho[:, None] * t
    safe = np.where(moved[:, 2:] > 1e-6, moved, [0.0, 0.0, 1.0])
    per_pixel = R[:, :, :2] / np.array([camera.fx, camera.fy])
    warp = pinhole.project_jacobian(camera, safe) @ (per_pixel
                                                     + t[:, :, None] * slope[:, None, :])
    rho_b = np.where(moved[:, 2] > 1e-6, rho / safe[:, 2], -1.0)
    return pinhole.project(camera, safe), rho_b, warp
