"""New lines from two keyframes, for segments whose depth is unknown.

A segment and the camera's centre span a plane, and two such planes meet in the line. Any two do: a
wrong pair is told by where the one segment comes to lie in the other picture.
"""

from __future__ import annotations

import numpy as np

from slam.dpl.config import DplConfig
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.matching import as_words, match_all
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import project, rays
from slam.types import Intrinsics

_MIN_OVERLAP = 0.5       # of two segments in one picture, over the shorter


def triangulate_line_pairs(map_: PointLineMap, keyframe: Keyframe, others: list[Keyframe],
                           camera: Intrinsics, config: DplConfig) -> None:
    """Add lines for pairs of segments without depth, such as those along a stereo pair's rows."""
    for other in others:
        mine, theirs = _without_depth(keyframe), _without_depth(other)
        match = match_all(as_words(keyframe.features.lines.descriptor[mine]),
                          as_words(other.features.lines.descriptor[theirs]),
                          config.track.line_distance, config.track.ratio)
        paired = np.flatnonzero(match >= 0)
        a, b = mine[paired], theirs[match[paired]]
        ends, good = _meet(keyframe, other, a, b, camera, config)
        rows = map_.lines.add(ends[good], keyframe.features.lines.descriptor[a[good]],
                              np.zeros(np.count_nonzero(good), np.int32),
                              keyframe.T_world_camera[:3, 3], keyframe.number)
        for seeing, feature in ((keyframe, a[good]), (other, b[good])):
            line_of = seeing.line_of.copy()
            line_of[feature] = rows
            map_.see_lines(seeing, line_of)


def _without_depth(keyframe: Keyframe) -> Array:
    return np.flatnonzero((keyframe.line_of < 0)
                          & ~(keyframe.features.lines.depth_m > 0).all(axis=1))


def _meet(first: Keyframe, second: Keyframe, a: Array, b: Array, camera: Intrinsics,
          config: DplConfig) -> tuple[Array, Array]:
    """World ends (N, 2, 3) of the first segments, and which (N,) lie before and beside both."""
    seen_a, seen_b = first.features.lines.ends_px[a], second.features.lines.ends_px[b]
    ray_a, ray_b = (rays(camera, seen.reshape(-1, 2)).reshape(-1, 2, 3)
                    @ keyframe.T_world_camera[:3, :3].T
                    for seen, keyframe in ((seen_a, first), (seen_b, second)))
    depth_m, angle_deg = along_rays(ray_a, ray_b, second.T_world_camera[:3, 3]
                                    - first.T_world_camera[:3, 3])
    good = (angle_deg > config.mapping.min_parallax_deg) & (
        (depth_m > config.depth.min_m) & (depth_m < config.depth.max_m)).all(axis=1)
    ends = first.T_world_camera[:3, 3] + np.where(good[:, None], depth_m, 1.0)[..., None] * ray_a
    uv = project(camera, se3.transform_points(se3.inverse(second.T_world_camera),
                                              ends.reshape(-1, 3))).reshape(-1, 2, 2)
    return ends, good & (overlap(uv, seen_b) > _MIN_OVERLAP)


def along_rays(ray_a: Array, ray_b: Array, between: Array) -> tuple[Array, Array]:
    """How far (N, 2) along rays planes meet them, in their lengths, and the planes' angle (N,) °.

    Where the planes are parallel there is no line: inf or NaN.

    Args:
        ray_a, ray_b: (N, 2, 3) through the ends of segments; those of b span the planes.
        between: (3,) from the centre of a to that of b, m.
    """
    normal_a, normal_b = (_unit(np.cross(ray[:, 0], ray[:, 1])) for ray in (ray_a, ray_b))
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (normal_b @ between)[:, None] / np.einsum("nk,nek->ne", normal_b, ray_a)
    sine = np.linalg.norm(np.cross(normal_a, normal_b), axis=1)
    return far, np.degrees(np.arcsin(np.minimum(sine, 1.0)))


def overlap(uv_px: Array, ends_px: Array) -> Array:
    """(N,) how much of the shorter of two segments (N, 2, 2) lies beside the other, along the
    second; 0 where the first has no image."""
    along = ends_px[:, 1] - ends_px[:, 0]
    length = np.linalg.norm(along, axis=1)
    t = np.einsum("nek,nk->ne", uv_px - ends_px[:, :1], _unit(along))
    common = np.minimum(t.max(axis=1), length) - np.maximum(t.min(axis=1), 0.0)
    share = common / np.maximum(np.minimum(length, np.ptp(t, axis=1)), 1e-9)
    return np.where(np.isfinite(share), share, 0.0)


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))
