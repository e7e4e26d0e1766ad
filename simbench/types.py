"""Exact truth, as it is passed between the renderer, the sensors, the disk and the metrics."""

from __future__ import annotations

from dataclasses import dataclass

from slam.geometry.arrays import Array, freeze_fields
from slam.types import Intrinsics


@dataclass(frozen=True, slots=True)
class ObjectInfo:
    """One moving (or parked) thing with a mask of its own."""

    instance_id: int     # > 0, constant over the sequence
    name: str
    root_part: int       # the part whose pose is the object's pose
    rigid: bool          # False: its parts move against each other
    category: str = ""   # as COCO names it; "": no detector knows it


@dataclass(frozen=True, slots=True)
class Edges3D:
    """Straight 3D edges of the scene, each fixed to one part."""

    part_id: Array            # (E,) int32
    endpoints_part: Array     # (E, 2, 3) m, in the part's frame

    def __post_init__(self) -> None:
        freeze_fields(self, part_id=("E",), endpoints_part=("E", 2, 3))


@dataclass(frozen=True, slots=True)
class SceneLayout:
    """What does not change over a sequence."""

    intrinsics: Intrinsics
    objects: tuple[ObjectInfo, ...]
    instance_of_part: Array   # (P,) int32: instance id of each part, 0 = background
    edges: Edges3D

    def __post_init__(self) -> None:
        freeze_fields(self, instance_of_part=("P",))


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """Exact truth of one instant. A part is a rigid body; background is part 0 and never moves."""

    index: int
    stamp_s: float
    T_world_camera: Array     # (4, 4) OpenCV axes
    T_world_part: Array       # (P, 4, 4)
    depth_m: Array            # (H, W) float32 z-depth before the sensor; 0 where nothing is seen
    part_id: Array            # (H, W) int32 part seen at each pixel; -1 where nothing is seen
    instance_id: Array        # (H, W) int32; 0 = background

    def __post_init__(self) -> None:
        freeze_fields(self, T_world_camera=(4, 4), T_world_part=("P", 4, 4),
                      depth_m=("H", "W"), part_id=("H", "W"), instance_id=("H", "W"))


@dataclass(frozen=True, slots=True)
class FlowTruth:
    """Exact motion of every pixel of frame i to frame j, on the pixels of frame i.

    Each pixel with a surface is exactly one of: visible in j, occluded in j, leaving the image.
    """

    flow_px: Array            # (H, W, 2) float32; 0 where there is no surface
    scene_flow_m: Array       # (H, W, 3) float32 motion in the world
    valid: Array              # (H, W) bool: a surface is seen here and lies in front of camera j
    occluded: Array           # (H, W) bool: inside the image of j, but something stands before it
    leaving: Array            # (H, W) bool: outside the image of j
    newly_visible: Array      # (H, W) bool, on the pixels of frame j: not seen in frame i

    def __post_init__(self) -> None:
        freeze_fields(self, flow_px=("H", "W", 2), scene_flow_m=("H", "W", 3), valid=("H", "W"),
                      occluded=("H", "W"), leaving=("H", "W"), newly_visible=("H", "W"))


@dataclass(frozen=True, slots=True)
class VisibleEdges:
    """The visible stretches of 3D edges in one frame."""

    edge: Array               # (S,) int32: which edge of Edges3D
    endpoints_px: Array       # (S, 2, 2)
    endpoints_camera: Array   # (S, 2, 3) m
    instance_id: Array        # (S,) int32

    def __post_init__(self) -> None:
        freeze_fields(self, edge=("S",), endpoints_px=("S", 2, 2), endpoints_camera=("S", 2, 3),
                      instance_id=("S",))


@dataclass(frozen=True, slots=True)
class ObjectPoses:
    """True poses of one object over a whole sequence."""

    T_world_object: Array     # (K, 4, 4)
    valid: Array              # (K,) bool: a true pose is known AND the object is seen here
    rigid: bool = True
    name: str = ""

    def __post_init__(self) -> None:
        freeze_fields(self, T_world_object=("K", 4, 4), valid=("K",))


@dataclass(frozen=True, slots=True)
class Trajectories:
    """True poses of camera and objects: all that the error metrics need."""

    stamps_s: Array                      # (K,)
    T_world_camera: Array                # (K, 4, 4)
    camera_valid: Array                  # (K,) bool
    objects: dict[int, ObjectPoses]      # true instance id -> poses

    def __post_init__(self) -> None:
        freeze_fields(self, stamps_s=("K",), T_world_camera=("K", 4, 4), camera_valid=("K",))
