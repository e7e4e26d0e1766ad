"""The global batch: every body of a run refined, and the run's result made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

import numba
import numpy as np

from slam.backend.bundle import BodyPath, BundleResult, bundle
from slam.backend.config import BundleConfig
from slam.estimation.covariance import moved_covariance
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.line_sightings import ends_in_metres, seen_stretches
from slam.map import (
    STATIC,
    BodyRecord,
    Features,
    Landmarks,
    MapRecord,
    Observations,
    PointLandmarks,
    PointObservations,
)
from slam.tables import taken
from slam.types import Intrinsics, ObjectTrack, SlamResult


def refine_run(record: MapRecord, tracked: SlamResult, camera: Intrinsics,
               config: BundleConfig) -> SlamResult:
    """The run's result with poses and object motions after the batch.

    Args:
        tracked: the result as tracked, over the same rows.
    """
    start = perf_counter()
    bodies = {number: refine_body(body, number, record, camera, config)
              for number, body in record.bodies.items() if len(body.frames) > 1}
    if STATIC not in bodies:
        return tracked
    made = with_paths(record, tracked, {n: b.T_body_camera for n, b in bodies.items()})
    of_steps = bodies[STATIC].step_covariance
    if of_steps is not None:
        made = with_covariances(made, record, of_steps,
                                _covariances_of_motions(made.T_world_camera, record, bodies))
    static = bodies[STATIC]
    segments = static_segments(record, static.T_body_camera, static.lines_body, camera, config)
    timings = dict(tracked.timings_ms) | {"global batch": 1e3 * (perf_counter() - start)}
    return replace(made, points_world=static.xyz_body, lines_world=segments, timings_ms=timings)


def _covariances_of_motions(X: Array, record: MapRecord, bodies: dict[int, BundleResult]
                            ) -> dict[int, Array]:
    """Body -> (F, 6, 6) of the motions to its frames, the camera's pose before them given."""
    rows = record.bodies[STATIC].frames
    of_camera = np.full((len(X), 6, 6), np.nan)
    of_camera[rows] = bodies[STATIC].step_covariance
    out = {}
    for number, body in bodies.items():
        if number != STATIC and body.step_covariance is not None:
            frames, Y = np.array(record.bodies[number].frames), body.T_body_camera
            out[number] = np.full((len(frames), 6, 6), np.nan)
            out[number][1:] = moved_covariance(X[frames[:-1]] @ se3.inverse(Y[:-1]) @ Y[1:],
                                               of_camera[frames[1:]] + body.step_covariance[1:])
    return out


def with_covariances(run: SlamResult, record: MapRecord, of_steps: Array,
                     of_motions: Mapping[int, Array]) -> SlamResult:
    """The run with covariances of its steps and motions; NaN over frames that were lost.

    Args:
        of_steps: (F, 6, 6) of the steps to the static world's frames; the first leads nowhere.
        of_motions: body -> (F, 6, 6) of the motions to its frames.
    """
    step_covariance = np.full((len(run.T_world_camera), 6, 6), np.nan)
    rows, then = _without_gaps(record.bodies[STATIC])
    step_covariance[rows] = of_steps[then]
    objects = dict(run.objects)
    for number, covariance in of_motions.items():
        body = record.bodies[number]
        track = objects[body.track]
        P = (np.full((len(track.frames), 6, 6), np.nan) if track.covariance is None
             else np.array(track.covariance))
        place = {int(index): m for m, index in enumerate(track.frames)}
        for row, i in zip(*_without_gaps(body), strict=True):
            m = place.get(record.indices[row])
            if m is not None:
                P[m] = covariance[i]
        objects[body.track] = replace(track, covariance=P)
    return replace(run, objects=objects, step_covariance=step_covariance)


def _without_gaps(body: BodyRecord) -> tuple[Array, Array]:
    """Rows of the run that follow right on the body's frame before, and which frames they are."""
    frames = np.array(body.frames)
    i = np.flatnonzero(np.diff(frames) == 1) + 1
    return frames[i], i


def static_segments(record: MapRecord, T_world_camera: Array, lines: Array, camera: Intrinsics,
                    config: BundleConfig) -> Array:
    """(L, 2, 3) m: the static world's lines between where their ends were seen.

    Args:
        T_world_camera: (F, 4, 4) of the static world's frames; lines: (L, 10), as `of_body` has
            them, where the batch has put them.
    """
    _, s = of_body(record.lines, record.bodies[STATIC], STATIC, config)
    ends, sigma_m = ends_in_metres(s.ends_px, s.covariance, s.rho, s.rho_sigma, camera)
    T = T_world_camera[s.frame][:, None]
    ends = (T[..., :3, :3] @ ends[..., None])[..., 0] + T[..., :3, 3]
    ends[np.isinf(sigma_m)] = np.nan
    segments = seen_stretches(lines, s.landmark, ends)
    return np.asarray(segments[np.isfinite(segments).all(axis=(1, 2))])


def run_of_record(record: MapRecord, tracked: SlamResult) -> SlamResult:
    """The run's result with poses and object motions as the record has them."""
    paths = {number: np.array(body.poses) for number, body in record.bodies.items()
             if len(body.frames) > 1}
    return with_paths(record, tracked, paths) if STATIC in paths else tracked


def with_paths(record: MapRecord, tracked: SlamResult, paths: dict[int, Array]) -> SlamResult:
    """The tracked run with the paths T_body_camera (F, 4, 4) of each body in their place."""
    X = _camera_path(tracked.T_world_camera, record.bodies[STATIC].frames, paths[STATIC])
    objects = dict(tracked.objects)
    indices = np.array(record.indices)
    for number, Y in paths.items():
        if number != STATIC:
            body = record.bodies[number]
            objects[body.track] = _with_motions(objects[body.track], body, indices, Y, X,
                                                tracked.T_world_camera)
    return replace(tracked, T_world_camera=X, objects=objects)


def filled_in(sightings: Observations) -> Observations:
    """Sightings by landmark, the first one of each with the noise of the later ones.

    Those that are not finite, and landmarks seen once, are left out.

    Args:
        sightings: by frame.
    """
    s = taken(sightings, np.argsort(sightings.landmark, kind="stable"))
    covariance = np.array(s.covariance)
    fill_first(s.landmark, covariance)
    rho = np.where(s.rho_sigma < np.inf, s.rho, 0.0)
    px = s.uv_px if isinstance(s, PointObservations) else s.ends_px
    finite = np.ones(len(s), bool)
    for part in (covariance, px, rho):
        finite &= np.isfinite(part).all(axis=tuple(range(1, part.ndim)))
    return taken(replace(s, covariance=covariance, rho=rho), np.flatnonzero(finite))


def spread_out(count: Array, landmark: Array, most: int) -> Array:
    """(M,) bool: at most so many sightings of each landmark, evenly over its life.

    Args:
        count: (P,) sightings of each landmark; landmark: (M,) ascending.
    """
    n = count[landmark]
    rank = np.arange(len(landmark)) - np.searchsorted(landmark, landmark)
    few = np.minimum(n, most)
    return np.asarray((rank + 1) * few // n > rank * few // n)


@numba.njit(cache=True)
def fill_first(landmark, covariance):  # type: ignore[no-untyped-def]
    """Give covariances (M, 2, 2) that are not finite the mean of their landmark's others."""
    first = 0
    while first < len(landmark):
        last, known = first, 0
        mean = np.zeros((2, 2))
        while last < len(landmark) and landmark[last] == landmark[first]:
            if np.isfinite(covariance[last]).all():
                mean += covariance[last]
                known += 1
            last += 1
        if 0 < known < last - first:
            for i in range(first, last):
                if not np.isfinite(covariance[i]).all():
                    covariance[i] = mean / known
        first = last


def refine_body(body: BodyRecord, number: int, record: MapRecord, camera: Intrinsics,
                config: BundleConfig) -> BundleResult:
    """One body's bundle adjustment."""
    xyz, sightings = of_body(record.points, body, number, config)
    lines, line_sightings = of_body(record.lines, body, number, config)
    path = BodyPath(np.array(body.poses), np.array(body.steps), np.array(body.information),
                    record.step_correlation)
    return bundle(path, xyz, sightings, camera, config, lines, line_sightings)


def of_body(features: Features[Landmarks, Observations], body: BodyRecord, number: int,
            config: BundleConfig) -> tuple[Array, Observations]:
    """Where a body's landmarks start, and their sightings by row of them and of the path."""
    landmarks, s = features.landmarks(), features.observations()
    row_of = np.full(max(body.frames) + 1, -1)
    row_of[body.frames] = np.arange(len(body.frames))
    inside = s.frame < len(row_of)
    own = inside & (landmarks.body[s.landmark] == number)
    own[own] = row_of[s.frame[own]] >= 0
    s = filled_in(taken(s, np.flatnonzero(own)))
    count = np.bincount(s.landmark, minlength=len(landmarks))
    s = taken(s, np.flatnonzero((count[s.landmark] >= config.min_sightings)
                                & spread_out(count, s.landmark, config.max_sightings)))
    used, landmark = np.unique(s.landmark, return_inverse=True)
    place = landmarks.xyz_body if isinstance(landmarks, PointLandmarks) else landmarks.line_body
    return place[used], replace(s, landmark=landmark, frame=row_of[s.frame])


def _camera_path(tracked: Array, frames: list[int], refined: Array) -> Array:
    """All poses (K, 4, 4): refined ones, and those of lost frames relative to the last refined."""
    last = np.maximum.accumulate(np.where(np.isin(np.arange(len(tracked)), frames),
                                          np.arange(len(tracked)), 0))
    X = np.array(tracked)
    X[frames] = refined
    return np.asarray(X[last] @ se3.inverse(tracked[last]) @ tracked)


def _with_motions(track: ObjectTrack, body: BodyRecord, indices: Array, Y: Array, X: Array,
                  X_tracked: Array) -> ObjectTrack:
    """The track with one body's motions H_k = L_k L_{k−1}⁻¹, L = X Y⁻¹."""
    rows = np.array(body.frames)
    L = X[rows] @ se3.inverse(Y)
    H = se3.orthonormalised(L[1:] @ se3.inverse(L[:-1]))
    carried = X[rows[:-1]] @ se3.inverse(X_tracked[rows[:-1]])
    H_world, centroid = np.array(track.H_world), np.array(track.centroid_world)
    place = {int(frame): i for i, frame in enumerate(track.frames)}
    for i, index in enumerate(indices[rows[1:]]):
        at = place.get(int(index))
        if at is not None:
            H_world[at] = H[i]
            centroid[at] = se3.transform_points(carried[i], centroid[at][None])[0]
    return replace(track, H_world=H_world, centroid_world=centroid)
