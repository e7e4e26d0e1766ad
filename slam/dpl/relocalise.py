"""Where in the map a frame might be: keyframes with like features, P3P in RANSAC."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from slam.dpl.config import DplConfig
from slam.dpl.features import Features
from slam.dpl.keyframes import Keyframe, PointLineMap
from slam.dpl.matching import as_words, match_all
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_MIN_MATCHES = 15


def match_keyframe(features: Features, keyframe: Keyframe, map_: PointLineMap,
                   config: DplConfig) -> tuple[Array, Array]:
    """Rows of the frame's points (P,) and of the map points (P,) they look like."""
    held = np.flatnonzero(keyframe.point_of >= 0)
    match = match_all(as_words(keyframe.features.points.descriptor[held]),
                      as_words(features.points.descriptor), config.track.map_distance, 0.85)
    paired = np.flatnonzero(match >= 0)
    rows = keyframe.point_of[held[paired]]
    return match[paired], rows


def pose_from_points(xyz_world: Array, uv_px: Array, camera: Intrinsics
                     ) -> tuple[Array, Array] | None:
    """T_world_camera (4, 4) by P3P in RANSAC, and which (N,) support it; None if none is found."""
    if len(xyz_world) < _MIN_MATCHES:
        return None
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        xyz_world, uv_px, camera.matrix, None, iterationsCount=300, reprojectionError=4.0,
        confidence=0.999, flags=cv2.SOLVEPNP_P3P)
    if not found or inliers is None or not (np.isfinite(rotation).all()
                                            and np.isfinite(translation).all()):
        return None
    T_camera_world = se3.from_rotation_translation(se3.exp_so3(rotation[:, 0]), translation[:, 0])
    fits = np.zeros(len(xyz_world), bool)
    fits[inliers[:, 0]] = True
    return se3.inverse(T_camera_world), fits


def places(map_: PointLineMap, features: Features, candidates: list[Keyframe],
           camera: Intrinsics, config: DplConfig) -> Iterator[tuple[Array, Array]]:
    """Poses at which a frame may be, with the map points that support each."""
    for keyframe in candidates:
        at, rows = match_keyframe(features, keyframe, map_, config)
        found = pose_from_points(map_.points.xyz[rows, 0], features.points.uv_px[at], camera)
        if found is not None and np.count_nonzero(found[1]) >= _MIN_MATCHES:
            yield found[0], rows[found[1]]
