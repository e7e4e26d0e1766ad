"""A small true world of poses, and estimates of it with errors that are known."""

from __future__ import annotations

import numpy as np

from simbench.errors import BadFrame
from simbench.metrics.estimates import CameraEstimates, ObjectMotions, camera_from_poses
from simbench.types import ObjectPoses, Trajectories
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import (
    Frame,
    FrameEstimate,
    Intrinsics,
    ObjectEstimate,
    ObjectTrack,
    Points2D,
    Segments2D,
    SlamResult,
    Status,
)

CAMERA = Intrinsics(60.0, 60.0, 31.5, 23.5, 64, 48)


def smooth_poses(count: int, rng: np.random.Generator, start: Array | None = None,
                 speed_m: float = 0.05) -> Array:
    """(K, 4, 4) poses of a smooth random motion."""
    base = np.r_[rng.normal(size=3) * 0.01, rng.normal(size=3) * speed_m]
    steps = se3.exp(base + 0.2 * np.abs(base) * rng.normal(size=(count, 6)))
    poses = [np.eye(4) if start is None else start]
    for step in steps[1:]:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def world(count: int = 40, fps: float = 10.0, seed: int = 0, objects: int = 2,
          still: int = 1) -> Trajectories:
    """Moving objects 1..n, then `still` parked ones, all seen in every frame."""
    rng = np.random.default_rng(seed)
    start = se3.exp(np.r_[rng.normal(size=3), rng.normal(size=3) * 5.0])
    camera = smooth_poses(count, rng, start)
    poses = {}
    for i in range(1, objects + still + 1):
        at = camera[0] @ se3.exp(np.r_[rng.normal(size=3), 3.0 * i, 0.5, 4.0])
        L = smooth_poses(count, rng, at, 0.08) if i <= objects else np.repeat(at[None], count, 0)
        poses[i] = ObjectPoses(L, np.ones(count, dtype=bool), True, f"thing {i}")
    return Trajectories(np.arange(count) / fps, camera, np.ones(count, dtype=bool), poses)


def exact_camera(truth: Trajectories, T_estimate_true: Array | None = None) -> CameraEstimates:
    """The true camera, in another world."""
    A = se3.inverse(truth.T_world_camera[0]) if T_estimate_true is None else T_estimate_true
    return camera_from_poses(A @ truth.T_world_camera, truth.camera_valid)


def exact_motions(truth: Trajectories, camera: CameraEstimates, track_of: dict[int, int],
                  perturbation: Array | None = None) -> ObjectMotions:
    """True motions in the estimate's world; `perturbation` (4, 4) is applied in the body frame:
    L⁻¹ Ĥ L = (L⁻¹ H L) P⁻¹, so that E = P."""
    A = camera.T_world_camera[0] @ se3.inverse(truth.T_world_camera[0])
    P = np.eye(4) if perturbation is None else perturbation
    rows = []
    for k in range(1, len(truth.stamps_s)):
        for true_id, track in track_of.items():
            L = truth.objects[true_id].T_world_object
            H = L[k] @ se3.inverse(P) @ se3.inverse(L[k - 1])
            rows.append((k, track, A @ H @ se3.inverse(A),
                         se3.transform_points(A, L[k - 1, :3, 3][None])[0], true_id))
    frame = np.array([r[0] for r in rows], dtype=np.int64)
    return ObjectMotions(frame, np.array([r[1] for r in rows], dtype=np.int64),
                         np.array([r[2] for r in rows]).reshape(-1, 4, 4),
                         np.array([r[3] for r in rows]).reshape(-1, 3),
                         camera.T_world_camera[frame - 1],
                         np.array([r[4] for r in rows], dtype=np.int64))


class SyntheticTruth:
    """Poses only, as of a simulator or of a recording."""

    layout = None

    def __init__(self, trajectories: Trajectories, exact: bool = True) -> None:
        self.trajectories, self.has_images = trajectories, exact


class SyntheticSequence:
    """Grey frames with one mask square for each object; labels are object ids plus 10."""

    name = "synthetic"
    intrinsics = CAMERA
    holds = frozenset({"masks", "depth"})

    def __init__(self, trajectories: Trajectories, broken: tuple[int, ...] = (),
                 exact: bool = True) -> None:
        self.truth = SyntheticTruth(trajectories, exact)
        self.stamps_s, self.broken = trajectories.stamps_s, broken

    def __len__(self) -> int:
        return len(self.stamps_s)

    def frame(self, k: int) -> Frame:
        if k in self.broken:
            raise BadFrame(f"rgb/{k}.png: truncated; replace it")
        rgb = np.full((48, 64, 3), 90 + k, dtype=np.uint8)
        labels = np.zeros((48, 64), dtype=np.int32)
        for n, i in enumerate(self.truth.trajectories.objects):
            labels[8:30, 4 + 20 * n:18 + 20 * n] = 10 + i
        return Frame(k, float(self.stamps_s[k]), rgb, np.full((48, 64), 4.0, dtype=np.float32),
                     CAMERA, labels)

    def fingerprint(self) -> str:
        return "0" * 64


class SyntheticFeed:
    """What `run` needs of a feed."""

    def __init__(self, sequence: SyntheticSequence) -> None:
        self.sequence, self.intrinsics = sequence, sequence.intrinsics

    def __len__(self) -> int:
        return len(self.sequence)

    def frame(self, k: int) -> Frame:
        return self.sequence.frame(k)

    def true_object_of_label(self, k: int) -> dict[int, int]:
        return {10 + i: i for i in self.sequence.truth.trajectories.objects}


class PerturbedTruth:
    """A "system" that was told the truth, and answers it with known errors E = P.

    `tracks` maps true objects to track numbers; a callable gives them for each frame.
    """

    def __init__(self, truth: Trajectories, camera_error: Array | None = None,
                 object_error: Array | None = None, tracks=None) -> None:  # type: ignore[no-untyped-def]
        self.truth = truth
        self.P_camera = np.eye(4) if camera_error is None else camera_error
        self.P_object = np.eye(4) if object_error is None else object_error
        self.tracks = tracks or (lambda k: {1: 7, 2: 3})
        self.poses: list[Array] = []
        self.stamps: list[float] = []
        self.found: dict[int, list[tuple[int, Array, Array]]] = {}

    def process(self, frame: Frame) -> FrameEstimate:
        k = frame.index
        X = self.truth.T_world_camera
        step = np.eye(4)
        if self.poses:
            step = se3.inverse(X[k - 1]) @ X[k] @ se3.inverse(self.P_camera)
        pose = self.poses[-1] @ step if self.poses else np.eye(4)
        objects = {}
        if self.poses:
            A = self.poses[-1] @ se3.inverse(X[k - 1])
            for true_id, track in self.tracks(k).items():
                L = self.truth.objects[true_id].T_world_object
                H = A @ L[k] @ se3.inverse(self.P_object) @ se3.inverse(L[k - 1]) @ se3.inverse(A)
                centroid = se3.transform_points(A, L[k - 1, :3, 3][None])[0]
                objects[track] = ObjectEstimate(H, centroid, 10 + true_id)
                self.found.setdefault(track, []).append((k, H, centroid))
        self.poses.append(pose)
        self.stamps.append(frame.stamp_s)
        points = Points2D(np.array([[8.0 + k % 3, 27.0], [40.0, 40.0]]), np.array([4.0, 4.0]),
                          np.array([0, 1]), np.array([11, 0], dtype=np.int32))
        segments = Segments2D(np.array([[[2.0, 2.0], [30.0, 4.0]], [[6.0, 10.0], [16.0, 28.0]]]),
                              np.full((2, 2), 4.0), np.array([0, 1]), np.array([0, 11], np.int32))
        return FrameEstimate(k, frame.stamp_s, pose, step, objects,
                             Status.TRACKED if len(self.poses) > 1 else Status.FIRST,
                             points=points, segments=segments,
                             timings_ms={"flow": 4.0, "camera": 2.0})

    def finish(self) -> SlamResult:
        return SlamResult(
            np.array(self.stamps), np.array(self.poses),
            {track: ObjectTrack(np.array([r[0] for r in rows]), np.array([r[1] for r in rows]),
                                np.array([r[2] for r in rows]))
             for track, rows in self.found.items()},
            (Status.FIRST,) + (Status.TRACKED,) * (len(self.poses) - 1),
            static_line_tracklet_lengths=np.array([3.0, 5.0]))
