"""Where in the map a frame might be: keyframes with like features, P3P in RANSAC."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slam.dpl.config import DplConfig
from slam.dpl.features import Features
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.matching import as_words, match_all
from slam.geometry.arrays import Array
from slam.geometry.resection import resect
from slam.types import Intrinsics

_MIN_MATCHES = 15
_RANSAC_PX, _RANSAC_TRIES = 4.0, 300


def match_keyframe(features: Features, keyframe: Keyframe, map_: PointLineMap,
                   config: DplConfig) -> tuple[Array, Array]:
    """Rows of the frame's points (P,) and of the map points (P,) they look like."""
    held = np.flatnonzero(keyframe.point_of >= 0)
    match = match_all(as_words(keyframe.features.points.descriptor[held]),
                      as_words(features.points.descriptor), config.track.map_distance, 0.85)
    paired = np.flatnonzero(match >= 0)
    rows = keyframe.point_of[held[paired]]
    return match[paired], rows


def pose_of(xyz_world: Array, uv_px: Array, camera: Intrinsics) -> tuple[Array, Array] | None:
    """T_world_camera (4, 4) that matches support, and which (N,) do; None if there are too few."""
    if len(xyz_world) < _MIN_MATCHES:
        return None
    return resect(xyz_world, uv_px, camera, _RANSAC_PX, _RANSAC_TRIES)


def places(map_: PointLineMap, features: Features, candidates: list[Keyframe],
           camera: Intrinsics, config: DplConfig) -> Iterator[tuple[Array, Array]]:
    """Poses at which a frame may be, with the map points that support each."""
    for keyframe in candidates:
        at, rows = match_keyframe(features, keyframe, map_, config)
        found = pose_of(map_.points.xyz[rows, 0], features.points.uv_px[at], camera)
        if found is not None and np.count_nonzero(found[1]) >= _MIN_MATCHES:
            yield found[0], rows[found[1]]
