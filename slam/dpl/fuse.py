"""What was mapped twice becomes one, once a loop has brought both to one place."""

from __future__ import annotations

import numpy as np

from slam.dpl.keyframes import PointLineMap
from slam.dpl.landmarks import Landmarks
from slam.dpl.loop_verify import Loop
from slam.dpl.track import PoseTracker
from slam.geometry.arrays import Array

_NEIGHBOURS = 10         # keyframes on each side of the loop


def fuse(map_: PointLineMap, loop: Loop, tracker: PoseTracker) -> None:
    """Look for the landmarks of each side in the keyframes of the other; the older ones stay."""
    new = [loop.keyframe, *map_.neighbours(loop.keyframe, _NEIGHBOURS)]
    old = [loop.old, *map_.neighbours(loop.old, _NEIGHBOURS)]
    for keyframes, others in ((new, old), (old, new)):
        for keyframe in keyframes:
            points, lines = map_.landmarks_of(others)
            features = keyframe.features.of_any_landmark(tracker.config.orb.scale)
            seen = tracker.look_for(map_, points, lines, features, keyframe.T_world_camera,
                                    tracker.config.loop.search_px)
            fit = tracker.fit(keyframe.T_world_camera, seen.pairs, features)
            if fit.inliers < tracker.config.track.min_inliers:
                continue
            point, line = seen.pairs.point[fit.point_fits], seen.pairs.line[fit.line_fits]
            of_points, of_lines = seen.points[fit.point_fits], seen.lines[fit.line_fits]
            own_points, own_lines = keyframe.point_of[point], keyframe.line_of[line]
            map_.see_points(keyframe, _completed(keyframe.point_of, point, of_points))
            map_.see_lines(keyframe, _completed(keyframe.line_of, line, of_lines))
            _merge(map_, map_.points, own_points, of_points)
            _merge(map_, map_.lines, own_lines, of_lines)


def _completed(of: Array, feature: Array, landmark: Array) -> Array:
    """Landmarks by feature, with those that features without one turn out to be."""
    blank = (of[feature] < 0) & ~np.isin(landmark, of)   # not seen already by another feature
    out = of.copy()
    out[feature[blank]] = landmark[blank]
    return out


def _merge(map_: PointLineMap, table: Landmarks, own: Array, landmark: Array) -> None:
    """What features were so far (N,) and what they turn out to be (N,) are the same things."""
    twice = (own >= 0) & (own != landmark)
    map_.merge(table, own[twice], landmark[twice])
