"""Settings of every stage, complete with defaults. One frozen dataclass per stage.

A threshold says its unit and where it comes from. Presets (slam.systems.registry) differ from
these defaults in a few named fields only.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True, slots=True)
class NoiseConfig:
    """What is assumed of the input's noise before the residuals have been seen."""

    flow_sigma_px: float = 0.3        # one flow vector, each axis
    inverse_depth_sigma: float = 0.002   # 1/m; σ_z = 0.002 z², a Kinect's or a good stereo rig's
    adapt: bool = True                # measure both from the residuals of each frame
    memory: float = 0.8               # weight of the earlier frames in the measured noise
    learn_depth_offset: bool = True   # a common offset of all inverse depths, once it stands out


@dataclass(frozen=True, slots=True)
class GridConfig:
    """Dense flow averaged over cells: every vector of a given flow counts."""

    static_cell_px: int = 8
    object_cell_px: int = 4
    min_filled: float = 0.25          # share of a cell's pixels that must be usable
    max_depth_change: float = 0.2     # relative inverse-depth change that no motion explains


@dataclass(frozen=True, slots=True)
class FlowConfig:
    """The system's own flow, where none is given."""

    preset: Literal["ultrafast", "fast", "medium"] = "fast"
    predict: bool = True              # estimate only what the expected motion leaves


@dataclass(frozen=True, slots=True)
class PointsConfig:
    """Corners that are followed over many frames."""

    static_count: int = 1000
    object_count: int = 160           # on each object


@dataclass(frozen=True, slots=True)
class MotionConfig:
    """Robust Levenberg-Marquardt on eq. (3) and (4)."""

    optimise_flow: bool = True        # False: φ = φ̂, the paper's ablation "wo. FO"
    kernel: Literal["huber", "cauchy"] = "cauchy"   # the paper: huber
    kernel_width: float = 3.0         # in standard deviations of the whole residual
    rounds: int = 2                   # renewals of noise scales, covariances, inverse depths
    iterations: int = 3               # Levenberg-Marquardt steps a round, at most
    step_tolerance: float = 0.1       # standard deviations; a shorter step is not taken
    reprojection_sigma_px: float = 0.02   # Σ_p: what the pinhole and rigidity leave unexplained
    line_sigma_px: float = 0.05       # Σ_l: a rendered or seen edge is not a perfect line
    line_normalisation: Literal["pixel", "paper"] = "pixel"
    point_gate: float = 4.0           # standard deviations; above: not an inlier
    line_gate: float = 4.0            # the same for lines, which are dropped (III-B)


@dataclass(frozen=True, slots=True)
class StartConfig:
    """P3P in RANSAC, from which the refinement starts."""

    max_points: int = 200             # sampled evenly over the matches
    iterations: int = 60
    threshold_px: float = 2.0         # at least; 4 σ of the flow where that is more
    min_points: int = 6               # fewer: no motion is estimated
    min_inlier_share: float = 0.2     # of the static matches; below it the frame is lost
    give_up_after: int = 10           # lost frames in a row; then tracking starts afresh


@dataclass(frozen=True, slots=True)
class DynamicConfig:
    """Which things move (III-C), and how masks are followed."""

    static_scene_flow_m_s: float = 0.12   # slower things count as static, if they never moved
    static_share_of_distance: float = 0.02   # per second; errors of flow and depth grow with it
    depth_jumps: float = 2.5          # times what parts of the image err by: a thing's depth does
    static_inverse_depth_error: float = 0.0025   # 1/m, of any pixel, lasting: 1 px of stereo
    parked_after_s: float = 0.3       # still for so long, a thing serves as a part of the world
    significance: float = 4.0         # standard deviations by which the motion must stand out
    moving_share: float = 0.3         # share of an object's points that must move
    stay_dynamic_s: float = 1.0       # a thing that moved stays dynamic through a short stop
    min_matches: int = 8              # fewer matches on an object: its motion is not estimated
    min_inlier_share: float = 0.25    # of its matches; below it nothing moves as one body
    max_rotation_sigma: float = 0.02  # rad a frame; what is known less well is no motion
    trusted_rigidity: float = 0.5     # only motions above it predict the next frame
    min_overlap: float = 0.3          # share of a mask that the flow must carry to its successor
    carry_s: float = 0.35             # so long a mask that is missed goes on with the flow
    find_again_acceleration_m_s2: float = 4.0   # of lost objects: a braking car, a swinging box
    find_again_likeness: float = 0.7  # share of a mask's colours that the object had, too
    forget_s: float = 3.0             # a track without a mask is forgotten after this time


@dataclass(frozen=True, slots=True)
class SmoothMotionConfig:
    """Objects keep their velocity but for accelerations of this size (standard deviations)."""

    enabled: bool = True
    acceleration_m_s2: float = 2.0             # a car in town, a swinging box, a person
    angular_acceleration_rad_s2: float = 2.0
    gate_chi2: float = 16.0                    # of 6 degrees: beyond it nothing is smoothed


@dataclass(frozen=True, slots=True)
class SegmentsConfig:
    """Line segments: which are sought and how long they are followed."""

    enabled: bool = True              # False: points only, as VDO-SLAM
    detector: Literal["edge_drawing", "lsd"] = "edge_drawing"   # the paper: lsd
    min_length_px: float = 25.0
    max_count: int = 150              # the longest are kept
    unseen_frames: int = 5            # frames that flow alone may carry a segment


@dataclass(frozen=True, slots=True)
class RefineConfig:
    """Sub-pixel alignment of the matches on the images."""

    use: Literal["auto", "always", "never"] = "auto"   # auto: where the system estimates the flow
    enough: int = 12                  # aligned corners of one motion that do without the grid
    grid_sigma_px: float = 1.0        # what a cell of estimated flow is trusted elsewhere


@dataclass(frozen=True, slots=True)
class SdplConfig:
    """Everything SDPL-SLAM's tracking can be told."""

    noise: NoiseConfig = field(default_factory=NoiseConfig)
    flow: FlowConfig = field(default_factory=FlowConfig)
    points: PointsConfig = field(default_factory=PointsConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    start: StartConfig = field(default_factory=StartConfig)
    dynamic: DynamicConfig = field(default_factory=DynamicConfig)
    smooth: SmoothMotionConfig = field(default_factory=SmoothMotionConfig)
    segments: SegmentsConfig = field(default_factory=SegmentsConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
