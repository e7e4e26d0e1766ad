"""New points from two keyframes, for features whose depth is unknown."""

from __future__ import annotations

import numpy as np

from slam.dpl.config import DplConfig
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.matching import as_words, match_all
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import project, rays
from slam.types import Intrinsics


def triangulate_pairs(map_: PointLineMap, keyframe: Keyframe, others: list[Keyframe],
                      camera: Intrinsics, config: DplConfig) -> None:
    """Add points for pairs of features without depth."""
    for other in others:
        mine = _without_depth(keyframe)
        theirs = _without_depth(other)
        if len(mine) < 5 or len(theirs) < 5:
            continue
        match = match_all(as_words(keyframe.features.points.descriptor[mine]),
                          as_words(other.features.points.descriptor[theirs]),
                          config.track.map_distance, config.track.ratio)
        paired = np.flatnonzero(match >= 0)
        a, b = mine[paired], theirs[match[paired]]
        xyz, good = _meet(keyframe, other, a, b, camera, config)
        rows = map_.points.add(xyz[good][:, None], keyframe.features.points.descriptor[a[good]],
                               keyframe.features.points.level[a[good]],
                               keyframe.T_world_camera[:3, 3], keyframe.number)
        for seeing, feature in ((keyframe, a[good]), (other, b[good])):
            point_of = seeing.point_of.copy()
            point_of[feature] = rows
            map_.see_points(seeing, point_of)


def _without_depth(keyframe: Keyframe) -> Array:
    return np.flatnonzero((keyframe.point_of < 0) & (keyframe.features.points.depth_m <= 0))


def _meet(first: Keyframe, second: Keyframe, a: Array, b: Array, camera: Intrinsics,
          config: DplConfig) -> tuple[Array, Array]:
    """World points (N, 3) where rays meet, and which (N,) lie before both and fit both."""
    uv_a, uv_b = first.features.points.uv_px[a], second.features.points.uv_px[b]
    ray_a = rays(camera, uv_a) @ first.T_world_camera[:3, :3].T
    ray_b = rays(camera, uv_b) @ second.T_world_camera[:3, :3].T
    xyz, parallax_deg = midpoints(first.T_world_camera[:3, 3], ray_a,
                                  second.T_world_camera[:3, 3], ray_b)
    good = parallax_deg > config.mapping.min_parallax_deg
    for keyframe, uv, rows in ((first, uv_a, a), (second, uv_b, b)):
        seen = project(camera, se3.transform_points(se3.inverse(keyframe.T_world_camera), xyz))
        sigma = config.track.point_sigma_px * config.orb.scale ** keyframe.features.points.level[
            rows].astype(np.float64)
        with np.errstate(invalid="ignore"):
            good &= np.linalg.norm(seen - uv, axis=1) < config.track.gate * sigma
    return xyz, good


def midpoints(centre_a: Array, ray_a: Array, centre_b: Array, ray_b: Array
              ) -> tuple[Array, Array]:
    """Points (N, 3) midway between rays where they are nearest, and their angle (N,) in degrees.

    Args:
        centre_a, centre_b: (3,) m; ray_a, ray_b: (N, 3) of any length.
    """
    a = ray_a / np.linalg.norm(ray_a, axis=1, keepdims=True)
    b = ray_b / np.linalg.norm(ray_b, axis=1, keepdims=True)
    cosine = np.clip(np.sum(a * b, axis=1), -1.0, 1.0)
    between = centre_b - centre_a
    along_a, along_b = a @ between, b @ between
    sine2 = np.maximum(1.0 - cosine**2, 1e-12)
    s = (along_a - cosine * along_b) / sine2
    t = (cosine * along_a - along_b) / sine2
    middle = 0.5 * (centre_a + s[:, None] * a + centre_b + t[:, None] * b)
    ahead = (s > 0) & (t > 0)
    return middle, np.where(ahead, np.degrees(np.arccos(cosine)), 0.0)
