"""Settings of every stage of DPL-SLAM, complete with defaults."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True, slots=True)
class OrbConfig:
    """ORB points, spread over the image and the pyramid (ORB-SLAM's numbers)."""

    count: int = 1000
    levels: int = 8
    scale: float = 1.2
    fast_threshold: int = 7          # grey levels; low, and the spread keeps the best of each cell


@dataclass(frozen=True, slots=True)
class LineConfig:
    """Segments with LBD descriptors."""

    enabled: bool = True
    detector: Literal["edge_drawing", "lsd"] = "edge_drawing"   # the paper: lsd
    count: int = 150                 # the longest are kept
    min_length_px: float = 25.0


@dataclass(frozen=True, slots=True)
class DepthConfig:
    """What is assumed of measured depth."""

    inverse_depth_sigma: float = 0.002   # 1/m; σ_z = 0.002 z², a Kinect's or a good stereo rig's
    min_m: float = 0.05              # nearer is no depth
    max_m: float = 100.0             # farther depths make no landmark
    learn_depth_offset: bool = True  # a common offset of all inverse depths, once it stands out


@dataclass(frozen=True, slots=True)
class StereoConfig:
    """Matching of rectified pairs (III-A.1), where frames bring no depth."""

    row_px: float = 2.0              # from a point's row, at the finest level (ORB-SLAM)
    min_disparity_px: float = 1.0    # farther than this the depth says nothing
    max_disparity_px: float = 192.0  # 2 m on KITTI
    descriptor_distance: int = 75    # bits of 256 (ORB-SLAM)
    max_move_px: float = 3.0         # of the alignment; farther is a failure
    sigma_px: float = 0.05           # of disparities, beside what the patches tell
    grid_rows: int = 48              # of cells that segments must share (PL-SLAM)
    line_distance: int = 80          # bits
    line_cosine: float = 0.94        # of the directions: 20°
    line_overlap: float = 0.75       # of the rows


@dataclass(frozen=True, slots=True)
class CullConfig:
    """Dynamic features (III-B)."""

    enabled: bool = True
    corners: int = 400
    border_px: int = 5               # corners nearer to the border are dropped
    patch_difference: float = 20.0   # grey levels, mean over the 3×3 patches (DS-SLAM: 2120 summed)
    epipolar_px: float = 1.0         # at least (DS-SLAM)
    spreads: float = 4.0             # and so many standard deviations of what stands still
    near_px: float = 15.0            # Algorithm 1
    near_outside_px: float = 8.0     # the same outside all boxes
    share: float = 0.4               # Algorithm 1
    share_of: Literal["frame", "box"] = "frame"  # of all features of the frame, as printed
    depth_aware: bool = True         # test the full motion where depth is known, not eq. (4) alone
    depth_sigmas: float = 5.0        # of the inverse depth, by which a corner must leave its place
    stay_dynamic_s: float = 0.5      # a box that held a mover is culled whole so long (0: paper)


@dataclass(frozen=True, slots=True)
class TrackConfig:
    """Pose of each frame against the map."""

    descriptor_distance: int = 90    # bits of 256, between frames
    map_distance: int = 75           # and against map points
    line_distance: int = 80
    ratio: float = 0.8               # best over second best, against the map
    search_px: float = 20.0          # around the prediction
    wide_search_px: float = 60.0     # where the prediction finds too few
    local_search_px: float = 6.0     # around the pose found
    point_sigma_px: float = 0.8      # at the finest level; coarser ones grow with the scale
    line_sigma_px: float = 0.8       # of a detected line at each of its ends
    kernel_width: float = 2.5        # of Cauchy's kernel, standard deviations
    gate: float = 3.0                # standard deviations; above: not an inlier
    iterations: int = 10
    min_inliers: int = 20            # points and lines; fewer: the frame is lost
    min_inlier_share: float = 0.25   # of the pairs; below it they fit by chance
    local_keyframes: int = 12
    relocalise_inliers: int = 30


@dataclass(frozen=True, slots=True)
class AnchorConfig:
    """Map points aligned with the patch of their first sighting."""

    enabled: bool = True
    radius_px: int = 5               # 11×11 patches
    min_correlation: float = 0.85
    prior_sigma_px: float = 0.7      # of where the map and the pose from corners put a patch
    max_move_px: float = 1.5         # from there; farther is another thing
    apart_px: float = 5.0            # landmarks without a corner are sought so far from others
    sigma_px: float = 0.3            # of aligned points, beside what the patches tell, before the
    least_sigma_px: float = 0.06     # frame's own residuals tell it; it is this at least
    own_sigma_px: float = 0.05       # of a landmark in the keyframe that its patch is of


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """Keyframes and local mapping."""

    keyframe_share: float = 0.75     # of the reference keyframe's landmarks; below: a new one
    min_points: int = 100            # landmarks tracked; fewer, and half as many points with depth
                                     # that are none yet: a new keyframe
    max_gap: int = 30                # frames between keyframes, at most
    window: int = 8                  # keyframes that local bundle adjustment moves
    fixed: int = 6                   # neighbours that hold it
    iterations: int = 5
    min_found_share: float = 0.25    # of the frames that should see a landmark (ORB-SLAM)
    redundant_share: float = 0.9     # of a keyframe's points in three others: the keyframe goes
    min_parallax_deg: float = 1.0    # of triangulated landmarks


@dataclass(frozen=True, slots=True)
class LoopConfig:
    """Loop closing. Relocalisation uses the same place recognition, enabled or not."""

    enabled: bool = True
    consistent: int = 3              # keyframes in a row that must propose one place (ORB-SLAM)
    likeness: float = 0.5            # of a place, against the least like covisible keyframe
    near_landmarks: int = 30         # in common with such a keyframe
    search_px: float = 8.0           # around predictions, when a loop is checked
    min_inliers: int = 50            # points and lines that fit one pose, each way
    min_inlier_share: float = 0.5    # of the pairs
    min_area: float = 0.2            # of the image's 8×6 cells that hold inliers
    max_drift: float = 0.15          # of the way since, by which a loop may correct
    edge_landmarks: int = 40         # in common between keyframes tied in the pose graph
    rest: int = 8                    # keyframes after a loop before the next one
    iterations: int = 10             # of the adjustment of the whole map


@dataclass(frozen=True, slots=True)
class DplConfig:
    """Everything DPL-SLAM can be told."""

    orb: OrbConfig = field(default_factory=OrbConfig)
    lines: LineConfig = field(default_factory=LineConfig)
    depth: DepthConfig = field(default_factory=DepthConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    cull: CullConfig = field(default_factory=CullConfig)
    track: TrackConfig = field(default_factory=TrackConfig)
    anchors: AnchorConfig = field(default_factory=AnchorConfig)
    mapping: MappingConfig = field(default_factory=MappingConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
