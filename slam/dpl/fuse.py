"""What was mapped twice becomes one, once a loop has brought both to one place."""

from __future__ import annotations

import numpy as np

from slam.dpl.keyframes import Keyframe, PointLineMap
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
            _join(map_, map_.points, keyframe, "point_of", seen.pairs.point[fit.point_fits],
                  seen.points[fit.point_fits])
            _join(map_, map_.lines, keyframe, "line_of", seen.pairs.line[fit.line_fits],
                  seen.lines[fit.line_fits])


def _join(map_: PointLineMap, table: Landmarks, keyframe: Keyframe, name: str, feature: Array,
          landmark: Array) -> None:
    """Features of a keyframe are these landmarks; those they were before are the same things."""
    of = getattr(keyframe, name)
    own = of[feature]
    there = np.isin(landmark, of)                 # the keyframe sees it already, elsewhere or here
    blank = (own < 0) & ~there
    of[feature[blank]] = landmark[blank]
    twice = (own >= 0) & (own != landmark)
    map_.merge(table, own[twice], landmark[twice])
