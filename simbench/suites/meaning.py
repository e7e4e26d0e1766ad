"""What a dial means in numbers: corners, edges, and how far objects are from rigid."""

from __future__ import annotations

import cv2
import numpy as np

from simbench.input_choice import Rendered
from simbench.metrics.trajectory import rigid_alignment
from simbench.sequence import Sequence, SequenceTruth
from simbench.truth.motion import part_motions, scene_flow
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.geometry.camera import back_project
from slam.types import Intrinsics

_FAST_THRESHOLD_DN = 20        # grey levels between a corner and the ring around it
_SHORTEST_EDGE_PX = 20.0
_LOOKED_AT = 3                 # frames: first, middle, last
_MIN_POINTS = 20
_WITHIN_S = 1.0


def measured_meaning(sequence: Sequence) -> dict[str, float]:
    """Corners and edges of the pictures, and the deformation of the objects if the truth tells.

    `corners_per_mp`: FAST corners of 20 grey levels; `edges_px_per_mp`: length of the segments of
    LSD that are 20 px or longer; both means over three frames. `deviation_cm`: RMS distance of
    the visible points of all objects from the rigid motion that fits each object best, over one
    second or the whole sequence where that is shorter.
    """
    frames = np.unique(np.linspace(0, len(sequence) - 1, _LOOKED_AT).round().astype(int))
    pictures = [sequence.rgb(int(k)) if isinstance(sequence, Rendered)
                else sequence.frame(int(k)).rgb for k in frames]
    out = {"corners_per_mp": float(np.mean([_corners_per_mp(each) for each in pictures])),
           "edges_px_per_mp": float(np.mean([_edges_px_per_mp(each) for each in pictures]))}
    if sequence.truth is not None and sequence.truth.has_images and len(sequence) > 1:
        out["deviation_cm"] = 100.0 * deviation_m(sequence.truth, sequence.stamps_s,
                                                  sequence.intrinsics)
    return out


def deviation_m(truth: SequenceTruth, stamps_s: Array, intrinsics: Intrinsics) -> float:
    """RMS distance in m of the objects' visible points from their best rigid motions."""
    apart = max(1, int(np.searchsorted(stamps_s - stamps_s[0], _WITHIN_S - 1e-6)))
    apart = min(apart, len(stamps_s) - 1)
    starts = sorted({0, len(stamps_s) - 1 - apart})
    squares = [_squared_residuals(truth, i, i + apart, intrinsics) for i in starts]
    together = np.concatenate(squares)
    return float(np.sqrt(together.mean())) if len(together) else 0.0


def _squared_residuals(truth: SequenceTruth, i: int, j: int, intrinsics: Intrinsics) -> Array:
    layout = truth.layout
    deforming = [] if layout is None else [o.instance_id for o in layout.objects if not o.rigid]
    frame = truth.frame(i)
    moved_m = scene_flow(frame, part_motions(frame, truth.frame(j)), intrinsics)
    found = [np.zeros(0)]
    for each in deforming:
        v, u = np.nonzero(frame.instance_id == each)
        if len(u) < _MIN_POINTS:
            continue
        in_camera = back_project(intrinsics, np.stack([u, v], axis=-1), frame.depth_m[v, u])
        points = se3.transform_points(frame.T_world_camera, in_camera)
        moved = points + moved_m[v, u]
        fitted = se3.transform_points(rigid_alignment(points, moved), points)
        found.append(((moved - fitted) ** 2).sum(axis=-1))
    return np.concatenate(found)


def _megapixels(image: Array) -> float:
    return image.shape[0] * image.shape[1] / 1e6


def _grey(rgb: Array) -> Array:
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY))


def _corners_per_mp(rgb: Array) -> float:
    corners = cv2.FastFeatureDetector.create(_FAST_THRESHOLD_DN).detect(_grey(rgb))
    return len(corners) / _megapixels(rgb)


def _edges_px_per_mp(rgb: Array) -> float:
    found = cv2.createLineSegmentDetector().detect(_grey(rgb))[0]
    if found is None:
        return 0.0
    ends = found.reshape(-1, 2, 2)     # OpenCV 4 has (N, 1, 4), OpenCV 5 (N, 4)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
    return float(length[length >= _SHORTEST_EDGE_PX].sum()) / _megapixels(rgb)
