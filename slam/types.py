"""The types passed between stages: frozen, checked, struct of arrays, read-only.

Geometry is float64, images are float32 or uint8. `T_a_b` maps coordinates in b to a.
Camera axes are OpenCV's (x right, y down, z forward); pixel centres are at integer coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from slam.geometry.arrays import Array, ShapeError, check_shape, freeze_fields
from slam.geometry.line import PluckerLines  # noqa: F401 - one of the types between stages


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera without distortion, in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    baseline_m: float | None = None   # None unless the frames carry a right image

    @property
    def matrix(self) -> Array:
        """The (3, 3) calibration matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class FlowField:
    """Dense optical flow from the previous frame to this one, on the previous frame's pixels."""

    flow_px: Array                       # (H, W, 2) float32: (du, dv)
    valid: Array | None = None           # (H, W) bool; None: valid wherever finite
    sigma_px: Array | None = None        # (H, W) float32 standard deviation, where known

    def __post_init__(self) -> None:
        freeze_fields(self, flow_px=("H", "W", 2), valid=("H", "W"), sigma_px=("H", "W"))


@dataclass(frozen=True, slots=True)
class Boxes2D:
    """Detections of any class."""

    corners_px: Array    # (N, 4): u_min, v_min, u_max, v_max
    score: Array         # (N,) in [0, 1]
    label: Array         # (N,) int: class number

    def __post_init__(self) -> None:
        freeze_fields(self, corners_px=("N", 4), score=("N",), label=("N",))


@dataclass(frozen=True, slots=True)
class Frame:
    """What a SLAM system is given for one instant. No truth is in it."""

    index: int
    stamp_s: float
    rgb: Array                           # (H, W, 3) uint8
    depth_m: Array                       # (H, W) float32 z-depth; 0 where there is none
    intrinsics: Intrinsics
    instance_id: Array | None = None     # (H, W) int32; 0 = background; labels change per frame
    boxes: Boxes2D | None = None
    flow: FlowField | None = None        # None: the system computes it
    right: Array | None = None           # (H, W, 3) uint8, rectified stereo

    def __post_init__(self) -> None:
        freeze_fields(self, rgb=("H", "W", 3), depth_m=("H", "W"), instance_id=("H", "W"),
                      right=("H", "W", 3))
        wanted = (self.intrinsics.height, self.intrinsics.width)
        check_shape("Frame.depth_m", self.depth_m, wanted)
        if self.flow is not None and self.flow.flow_px.shape[:2] != wanted:
            raise ShapeError(f"Frame.flow: wanted {wanted}, got {self.flow.flow_px.shape[:2]}")


@dataclass(frozen=True, slots=True)
class Points2D:
    uv_px: Array         # (N, 2)
    depth_m: Array       # (N,) z-depth, 0 where unknown
    track_id: Array      # (N,) int64
    instance_id: Array   # (N,) int32, 0 = static background

    def __post_init__(self) -> None:
        freeze_fields(self, uv_px=("N", 2), depth_m=("N",), track_id=("N",), instance_id=("N",))

    def __len__(self) -> int:
        return len(self.uv_px)


@dataclass(frozen=True, slots=True)
class Segments2D:
    endpoints_px: Array  # (N, 2, 2): start and end, (u, v); integers are pixel centres
    depth_m: Array       # (N, 2) z-depth of both ends; 0 where unknown
    track_id: Array      # (N,) int64
    instance_id: Array   # (N,) int32, 0 = static background

    def __post_init__(self) -> None:
        freeze_fields(self, endpoints_px=("N", 2, 2), depth_m=("N", 2), track_id=("N",),
                      instance_id=("N",))

    def __len__(self) -> int:
        return len(self.endpoints_px)


@dataclass(frozen=True, slots=True)
class Judged:
    """Features of one frame that a system judged to move or to stand still."""

    points_px: Array         # (N, 2)
    points_dynamic: Array    # (N,) bool: left out
    segments_px: Array       # (L, 2, 2)
    segments_dynamic: Array  # (L,) bool

    def __post_init__(self) -> None:
        freeze_fields(self, points_px=("N", 2), points_dynamic=("N",), segments_px=("L", 2, 2),
                      segments_dynamic=("L",))


class Status(StrEnum):
    """How the camera pose of a frame came about."""

    FIRST = "first"      # the first frame: the pose is the identity by definition
    TRACKED = "tracked"
    LOST = "lost"        # no estimate: the pose is only predicted; `reason` says why


@dataclass(frozen=True, slots=True)
class ObjectEstimate:
    """One moving object between the previous frame and this one, in the estimate's world."""

    H_world: Array                 # (4, 4): p_k = H p_{k-1}
    centroid_world: Array          # (3,) of the object's points at the PREVIOUS frame
    instance_id: int               # the mask label on which the track stands in THIS frame
    rigidity: float = 1.0          # share of the object's features that move as one body
    inliers: int = 0
    # (6, 6) of Ĥ Exp(ξ), [ω, v], the camera's pose at k−1 given; None where not known.
    covariance: Array | None = None

    def __post_init__(self) -> None:
        freeze_fields(self, H_world=(4, 4), centroid_world=(3,), covariance=(6, 6))


@dataclass(frozen=True, slots=True)
class FrameEstimate:
    """What `process` returns for a frame, when it returns it."""

    index: int
    stamp_s: float
    T_world_camera: Array                 # (4, 4)
    T_previous_camera: Array              # (4, 4): this frame's motion, as estimated now
    objects: Mapping[int, ObjectEstimate] = field(default_factory=dict)   # track -> motion
    status: Status = Status.TRACKED
    reason: str = ""                      # why the frame is lost, or what was left out
    points: Points2D | None = None        # what was used, for pictures and statistics
    segments: Segments2D | None = None
    inliers: Mapping[str, int] = field(default_factory=dict)      # "points", "lines"
    timings_ms: Mapping[str, float] = field(default_factory=dict)  # stage -> milliseconds
    static_labels: tuple[int, ...] = ()   # mask labels judged not to move
    judged: Judged | None = None          # of systems that leave out dynamic features
    # (6, 6) of T_previous_camera Exp(ξ), [ω, v]; None where not known.
    covariance: Array | None = None

    def __post_init__(self) -> None:
        freeze_fields(self, T_world_camera=(4, 4), T_previous_camera=(4, 4), covariance=(6, 6))


@dataclass(frozen=True, slots=True)
class ObjectTrack:
    """One object track over the frames in which it was estimated, in the estimate's world."""

    frames: Array            # (M,) int: index of the frame k each motion ends in
    H_world: Array           # (M, 4, 4)
    centroid_world: Array    # (M, 3) at frame k-1
    covariance: Array | None = None   # (M, 6, 6) of H_world Exp(ξ), as ObjectEstimate's; NaN: none

    def __post_init__(self) -> None:
        freeze_fields(self, frames=("M",), H_world=("M", 4, 4), centroid_world=("M", 3),
                      covariance=("M", 6, 6))


@dataclass(frozen=True, slots=True)
class ClosedLoops:
    """N places that were seen again, and by which the map was corrected."""

    row: Array               # (N,) int64 of the run: the frame that closed each
    seen_before: Array       # (N,) int64: the frame that it was found again in
    T_before_now: Array      # (N, 4, 4) camera then to camera now, once the map was corrected

    def __post_init__(self) -> None:
        freeze_fields(self, row=("N",), seen_before=("N",), T_before_now=("N", 4, 4))

    def __len__(self) -> int:
        return len(self.row)


@dataclass(frozen=True, slots=True)
class SlamResult:
    """What `finish` returns: the whole run after the last refinement."""

    stamps_s: Array                     # (K,)
    T_world_camera: Array               # (K, 4, 4)
    objects: Mapping[int, ObjectTrack]
    status: tuple[Status, ...]
    points_world: Array | None = None   # (P, 3) static map points
    lines_world: Array | None = None    # (L, 2, 3) static map segments
    static_line_tracklet_lengths: Array | None = None   # (T,) frames each static line lived
    timings_ms: Mapping[str, float] = field(default_factory=dict)   # of `finish` itself
    step_covariance: Array | None = None   # (K, 6, 6) of X_{k-1}⁻¹ X_k Exp(ξ), [ω, v]; NaN: none
    loops: ClosedLoops | None = None       # None: the system looks for none

    def __post_init__(self) -> None:
        freeze_fields(self, stamps_s=("K",), T_world_camera=("K", 4, 4), points_world=("P", 3),
                      lines_world=("L", 2, 3), static_line_tracklet_lengths=("T",),
                      step_covariance=("K", 6, 6))
