"""What a system said, as arrays over the frames of a sequence: all that the metrics look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slam.geometry import se3
from slam.geometry.arrays import Array, freeze_fields
from slam.types import FrameEstimate, SlamResult, Status

NO_OBJECT = 0


@dataclass(frozen=True, slots=True)
class CameraEstimates:
    """The estimated camera at each frame of the sequence."""

    T_world_camera: Array       # (K, 4, 4); whatever where there is no estimate
    pose_known: Array           # (K,) bool
    T_previous_camera: Array    # (K, 4, 4) the motion that ended in frame k
    step_known: Array           # (K,) bool: this motion is an estimate, over one frame
    step_covariance: Array | None = None   # (K, 6, 6) of T_previous_camera Exp(ξ); NaN: not stated

    def __post_init__(self) -> None:
        freeze_fields(self, T_world_camera=("K", 4, 4), pose_known=("K",),
                      T_previous_camera=("K", 4, 4), step_known=("K",),
                      step_covariance=("K", 6, 6))


@dataclass(frozen=True, slots=True)
class ObjectMotions:
    """Estimated object motions, one row for each track and frame, ordered by frame."""

    frame: Array                # (M,) int: the frame the motion ends in
    track: Array                # (M,) int
    H_world: Array              # (M, 4, 4) in the estimate's world
    centroid_world: Array       # (M, 3) at the frame before
    T_world_camera: Array       # (M, 4, 4) the estimated camera at the frame before
    stands_on: Array            # (M,) int: true object under the track's label; NO_OBJECT if none
    covariance: Array | None = None   # (M, 6, 6) of H_world Exp(ξ); NaN where not stated

    def __post_init__(self) -> None:
        freeze_fields(self, frame=("M",), track=("M",), H_world=("M", 4, 4),
                      centroid_world=("M", 3), T_world_camera=("M", 4, 4), stands_on=("M",),
                      covariance=("M", 6, 6))

    def __len__(self) -> int:
        return len(self.frame)


def camera_from_poses(T_world_camera: Array, known: Array) -> CameraEstimates:
    """Estimates whose motions are those between the poses (K, 4, 4) known (K,) in a row."""
    steps = np.broadcast_to(np.eye(4), T_world_camera.shape).copy()
    step_known = np.zeros(len(known), dtype=bool)
    steps[1:] = se3.inverse(T_world_camera[:-1]) @ T_world_camera[1:]
    step_known[1:] = known[1:] & known[:-1]
    return CameraEstimates(T_world_camera, known, steps, step_known)


def online_camera(estimates: Sequence[FrameEstimate], one_frame: Array) -> CameraEstimates:
    """What `process` returned, when it returned it.

    Args:
        estimates: one for each frame. A lost frame has neither pose nor motion.
        one_frame: (K,) bool: the system had seen the frame before this one, so that its motion
            spans one frame.
    """
    tracked = np.array([e.status is Status.TRACKED for e in estimates], dtype=bool)
    first = np.array([e.status is Status.FIRST for e in estimates], dtype=bool)
    return CameraEstimates(
        stacked([e.T_world_camera for e in estimates]), tracked | first,
        stacked([e.T_previous_camera for e in estimates]), tracked & one_frame,
        stacked_covariances([e.covariance for e in estimates]))


def online_motions(estimates: Sequence[FrameEstimate], one_frame: Array,
                   true_of_label: Sequence[Mapping[int, int]]) -> ObjectMotions:
    """The object motions of `process`, with the true object under each track's mask label.

    The camera at the frame before is X̂_k (X̂_{k-1}⁻¹X̂_k)⁻¹, in the world the motion is given in.
    """
    rows = [(k, track, motion, estimate)
            for k, estimate in enumerate(estimates)
            if estimate.status is not Status.LOST and one_frame[k]
            for track, motion in sorted(estimate.objects.items())]
    previous = [e.T_world_camera @ se3.inverse(e.T_previous_camera) for _, _, _, e in rows]
    return ObjectMotions(
        np.array([k for k, _, _, _ in rows], dtype=np.int64),
        np.array([track for _, track, _, _ in rows], dtype=np.int64),
        stacked([motion.H_world for _, _, motion, _ in rows]),
        np.array([motion.centroid_world for _, _, motion, _ in rows]).reshape(-1, 3),
        stacked(previous),
        np.array([true_of_label[k].get(motion.instance_id, NO_OBJECT)
                  for k, _, motion, _ in rows], dtype=np.int64),
        stacked_covariances([motion.covariance for _, _, motion, _ in rows]))


def batch_camera(result: SlamResult, stamps_s: Array) -> CameraEstimates:
    """What `finish` returned, its poses given to the frames with the same stamps (K,).

    Raises:
        ValueError: a pose belongs to no frame, or two to the same.
    """
    frame = frames_of_stamps(stamps_s, result.stamps_s, 1e-4)
    if np.any(frame < 0) or len(np.unique(frame)) < len(frame):
        raise ValueError(f"the stamps of {len(frame)} poses are not those of "
                         f"{len(stamps_s)} frames")
    T = np.broadcast_to(np.eye(4), (len(stamps_s), 4, 4)).copy()
    known = np.zeros(len(stamps_s), dtype=bool)
    T[frame] = result.T_world_camera
    known[frame] = [status is not Status.LOST for status in result.status]
    camera = camera_from_poses(T, known)
    if result.step_covariance is None:
        return camera
    covariance = np.full((len(stamps_s), 6, 6), np.nan)
    covariance[frame] = result.step_covariance
    return replace(camera, step_covariance=covariance)


def frames_of_stamps(stamps_s: Array, wanted_s: Array, tolerance_s: float) -> Array:
    """(N,) index of the frame nearest to each wanted stamp; -1 beyond the tolerance."""
    nearest = np.searchsorted((stamps_s[1:] + stamps_s[:-1]) / 2.0, wanted_s)
    return np.asarray(np.where(np.abs(stamps_s[nearest] - wanted_s) <= tolerance_s, nearest, -1))


def batch_motions(result: SlamResult, camera: CameraEstimates) -> ObjectMotions:
    """The object motions of `finish`. Nothing says on which labels they stand."""
    tracks = sorted(result.objects.items())
    frame = np.concatenate([np.zeros(0, np.int64)] + [t.frames for _, t in tracks])
    frame = frame.astype(np.int64)
    track = np.repeat(np.array([number for number, _ in tracks], dtype=np.int64),
                      [len(t.frames) for _, t in tracks])
    H = np.concatenate([np.zeros((0, 4, 4))] + [t.H_world for _, t in tracks])
    centroid = np.concatenate([np.zeros((0, 3))] + [t.centroid_world for _, t in tracks])
    unknown = [np.full((len(t.frames), 6, 6), np.nan) if t.covariance is None else t.covariance
               for _, t in tracks]
    covariance = np.concatenate([np.zeros((0, 6, 6)), *unknown])
    return motions_of_rows(frame, track, H, centroid, camera, covariance)


def motions_of_rows(frame: Array, track: Array, H_world: Array, centroid_world: Array,
                    camera: CameraEstimates, covariance: Array | None = None) -> ObjectMotions:
    """Rows of any order as object motions, those left out that begin before frame 0, or end
    beyond the last frame, or have no camera pose to be seen from."""
    inside = (frame >= 1) & (frame < len(camera.pose_known))
    inside[inside] = camera.pose_known[frame[inside] - 1]
    rows = np.flatnonzero(inside)
    rows = rows[np.lexsort((track[rows], frame[rows]))]
    return ObjectMotions(frame[rows], track[rows], H_world[rows], centroid_world[rows],
                         camera.T_world_camera[frame[rows] - 1],
                         np.full(len(rows), NO_OBJECT, dtype=np.int64),
                         None if covariance is None else covariance[rows])


def stacked(transforms: Sequence[Array]) -> Array:
    """A list of (4, 4) as one (N, 4, 4), N ≥ 0."""
    return np.array(transforms, dtype=np.float64).reshape(-1, 4, 4)


def stacked_covariances(covariances: Sequence[Array | None]) -> Array:
    """A list of (6, 6) as one (N, 6, 6); NaN where there is None."""
    unknown = np.full((6, 6), np.nan)
    return np.array([unknown if P is None else P for P in covariances],
                    dtype=np.float64).reshape(-1, 6, 6)
