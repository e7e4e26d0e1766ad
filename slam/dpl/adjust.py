"""Bundle adjustment of keyframes with their points and lines (local, and of the whole map).

A map line is adjusted by its two ends, each measured across the seen line and in inverse depth
(slam.dpl.sightings), so that points and lines are one family of landmarks to the solver.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from slam.backend.config import BundleConfig
from slam.backend.descend import levenberg_marquardt
from slam.dpl.config import DplConfig
from slam.dpl.keyframes import Keyframe, PointLineMap, shared_landmarks
from slam.dpl.map_problem import MapProblem, MapState, Rows
from slam.dpl.sightings import Sightings, joined, of_line_ends, of_points
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_FEW = 20              # keyframes whose system is small whatever their order
_CUT_CHI2 = 1.5        # times the square of the tracker's gate


def adjust(map_: PointLineMap, free: list[Keyframe], fixed: list[Keyframe], camera: Intrinsics,
           config: DplConfig, iterations: int) -> None:
    """Refine free keyframes and all landmarks they see; write them back into the map.

    Sightings that do not fit afterwards are taken off their keyframes. A step that does not
    lower the cost is not taken.
    """
    points, lines = map_.landmarks_of(free)
    if len(points) + len(lines) == 0:
        return
    keyframes = sorted([*free, *fixed], key=lambda k: k.number)
    if len(keyframes) > _FEW:
        keyframes = in_narrow_order(keyframes, map_)
    rows, seen = _collect(keyframes, points, lines, map_, camera, config)
    held = np.array([k in fixed for k in keyframes])
    if not held.any():
        held[np.argmin([k.number for k in keyframes])] = True     # the oldest carries the world
    T = np.array([k.T_world_camera for k in keyframes])
    xyz = np.concatenate([map_.points.xyz[points, 0], map_.lines.xyz[lines].reshape(-1, 3)])
    problem = MapProblem(rows, seen, held, len(xyz), camera, config.track.kernel_width)
    T, xyz = levenberg_marquardt(problem, MapState(T, xyz), BundleConfig(iterations=iterations))
    T = se3.orthonormalised(T)
    if not (np.isfinite(T).all() and np.isfinite(xyz).all()):
        return
    for keyframe, pose, stays in zip(keyframes, T, held, strict=True):
        if not stays:
            keyframe.T_world_camera = pose
    map_.points.xyz[points, 0] = xyz[:len(points)]
    map_.lines.xyz[lines] = xyz[len(points):].reshape(-1, 2, 3)
    _cut(map_, keyframes, rows, problem.chi2 > _CUT_CHI2 * config.track.gate**2)


def adjust_all(map_: PointLineMap, camera: Intrinsics, config: DplConfig, iterations: int
               ) -> None:
    """Refine the whole map; the first keyframe stays, and what nobody sees follows its keyframe."""
    living, before = map_.living(), map_.poses()
    points, lines = map_.landmarks_of(living)
    if len(living) < 2:
        return
    adjust(map_, [k for k in living if k is not living[0]], [living[0]], camera, config, iterations)
    map_.follow_references(before, map_.poses(),
                           np.setdiff1d(np.arange(map_.points.count), points),
                           np.setdiff1d(np.arange(map_.lines.count), lines))


def in_narrow_order(keyframes: list[Keyframe], map_: PointLineMap) -> list[Keyframe]:
    """The order in which keyframes that share landmarks stand close together.

    A closed loop couples its first keyframes with its last ones. By their numbers the band of the
    reduced system would be as wide as the map; by Cuthill and McKee's order it is as wide as
    two views of one place.
    """
    order = reverse_cuthill_mckee(csr_array(shared_landmarks(map_, keyframes) > 0),
                                  symmetric_mode=True)
    return [keyframes[i] for i in order]


def _collect(keyframes: list[Keyframe], points: Array, lines: Array, map_: PointLineMap,
             camera: Intrinsics, config: DplConfig) -> tuple[Rows, Sightings]:
    """All sightings of these landmarks, by landmark and then by keyframe.

    The feet of line ends are those at the poses as they are.
    """
    point_row = np.full(map_.points.count + 1, -1, np.int64)     # the last row answers −1
    line_row = np.full(map_.lines.count + 1, -1, np.int64)
    point_row[points], line_row[lines] = np.arange(len(points)), np.arange(len(lines))
    pose, landmark, feature, is_point = [], [], [], []
    measured: list[Sightings] = []
    for i, keyframe in enumerate(keyframes):
        p, q = point_row[keyframe.point_of], line_row[keyframe.line_of]
        fp, fq = np.flatnonzero(p >= 0), np.flatnonzero(q >= 0)
        ends = len(points) + 2 * q[fq, None] + [0, 1]            # both of a line stand together
        landmark.append(np.concatenate([p[fp], ends.reshape(-1)]))
        feature.append(np.concatenate([fp, np.repeat(fq, 2)]))
        is_point.append(np.arange(len(landmark[-1])) < len(fp))
        pose.append(np.full(len(landmark[-1]), i, np.int64))
        measured += _measured(keyframe, fp, fq, map_, camera, config)
    whole = [np.concatenate(part) for part in (pose, landmark, feature, is_point)]
    order, seen = np.lexsort((whole[0], whole[1])), joined(*measured)
    return (Rows(*(part[order] for part in whole)),
            Sightings(seen.uv_px[order], seen.whitening[order], seen.rho[order]))


def _measured(keyframe: Keyframe, points: Array, lines: Array, map_: PointLineMap,
              camera: Intrinsics, config: DplConfig) -> tuple[Sightings, Sightings]:
    """What a keyframe's points (P,) and lines (Q,), rows of features, measure."""
    c, sigma_rho = config.track, config.depth.inverse_depth_sigma
    return (of_points(keyframe.features.points[points], c.point_sigma_px, config.orb.scale,
                      sigma_rho),
            of_line_ends(map_.lines.xyz[keyframe.line_of[lines]], keyframe.features.lines[lines],
                         keyframe.T_world_camera, camera, c.line_sigma_px, sigma_rho))


def _cut(map_: PointLineMap, keyframes: list[Keyframe], rows: Rows, bad: Array) -> None:
    """Take sightings that do not fit off their keyframes; a line with one bad end goes whole."""
    at = np.flatnonzero(bad)
    for i in np.unique(rows.pose[at]):
        mine = at[rows.pose[at] == i]
        feature, is_point = rows.feature[mine], rows.is_point[mine]
        point_of, line_of = keyframes[i].point_of.copy(), keyframes[i].line_of.copy()
        point_of[feature[is_point]], line_of[feature[~is_point]] = -1, -1
        map_.see_points(keyframes[i], point_of)
        map_.see_lines(keyframes[i], line_of)
