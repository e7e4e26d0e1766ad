"""A simulated scene as a sequence in memory, drawn frame by frame as it is asked for."""

from __future__ import annotations

import hashlib
import json
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from simbench.depth_range import farthest_depth
from simbench.errors import UserError
from simbench.exposure import mean_in_linear_light
from simbench.extents import part_boxes
from simbench.render import Renderer
from simbench.sequence import IteratesFrames
from simbench.stated import MOST_FRAMES
from simbench.truth import RayCaster, flow_between, visible_edges
from simbench.types import (
    FlowTruth,
    FrameTruth,
    ObjectPoses,
    SceneLayout,
    Trajectories,
    VisibleEdges,
)
from simbench.world import World
from slam.geometry.arrays import Array
from slam.types import FlowField, Frame, Intrinsics

_KEPT = 4   # frames, and flows, that stay in memory
_INDOOR_M = 13.1              # scenes that reach no farther get a stereo camera for rooms
_INDOOR_BASELINE_M = 0.12
_OUTDOOR_BASELINE_M = 0.54    # KITTI's


class SimulatedTruth:
    """Exact truth of a world at K stamps; any frame and any pair of frames, in any order."""

    has_images = True

    def __init__(self, world: World, renderer: Renderer, stamps_s: Array,
                 kept: int = _KEPT) -> None:
        self.layout: SceneLayout = world.layout
        self._world, self._renderer, self._stamps_s = world, renderer, stamps_s
        self._caster = RayCaster(world.model)
        self._memory = _Memory(kept)
        self._seen: dict[int, frozenset[int]] = {}   # frame -> objects seen in it
        self._states = []
        T_world_camera, T_world_part = [], []
        world.reset()
        for stamp in stamps_s:
            world.advance_to(float(stamp))
            self._states.append(world.state())
            T_world_camera.append(world.T_world_camera)
            T_world_part.append(world.T_world_part)
        self._T_world_camera, self._T_world_part = np.stack(T_world_camera), np.stack(T_world_part)

    @property
    def reach_m(self) -> float:
        """The largest depth that any frame can hold."""
        return farthest_depth(self._world.model, self._T_world_camera, self._T_world_part)

    def world_at(self, k: int) -> World:
        """The world, brought to the instant of frame k."""
        self._world.restore(self._states[k])
        return self._world

    def frame(self, k: int) -> FrameTruth:
        """Poses, depth, parts and objects of frame k."""
        return self._memory.get(("frame", k), lambda: self._make_frame(k))

    def flow(self, i: int, j: int) -> FlowTruth:
        """Motion of every pixel of frame i to any frame j."""
        return self._memory.get(("flow", i, j), lambda: flow_between(
            self.frame(i), self.frame(j), self.layout, self._caster))

    def edges(self, k: int) -> VisibleEdges:
        """Visible stretches of the scene's edges in frame k."""
        return visible_edges(self.frame(k), self.layout, self._caster)

    def part_boxes(self) -> Array:
        """(P, 2, 3) m, lowest and highest corner of each part in its own frame, NaN if unseen."""
        return part_boxes(self._world.model)

    def true_instances(self, k: int) -> Array:
        """(H, W) int32 true object id per pixel; 0 = background."""
        return self.frame(k).instance_id

    @property
    def trajectories(self) -> Trajectories:
        """True poses at all stamps.

        An object is valid where a pixel shows it. Frames that were not asked for yet are drawn
        (depth and parts only) to find that out.
        """
        frames = range(len(self._stamps_s))
        for k in frames:
            if k not in self._seen:
                self._make_frame(k)
        objects = {
            each.instance_id: ObjectPoses(
                T_world_object=self._T_world_part[:, each.root_part],
                valid=np.array([each.instance_id in self._seen[k] for k in frames], bool),
                rigid=each.rigid, name=each.name)
            for each in self.layout.objects}
        return Trajectories(stamps_s=self._stamps_s, T_world_camera=self._T_world_camera,
                            camera_valid=np.ones(len(frames), bool), objects=objects)

    def _make_frame(self, k: int) -> FrameTruth:
        depth, part = self._renderer.depth_and_parts(self.world_at(k))
        # The last entry stands for part -1, where nothing is seen.
        instance = np.append(self.layout.instance_of_part, 0).astype(np.int32)[part]
        self._seen[k] = frozenset(np.flatnonzero(np.bincount(instance.ravel())).tolist())
        return FrameTruth(index=k, stamp_s=float(self._stamps_s[k]),
                          T_world_camera=self._T_world_camera[k],
                          T_world_part=self._T_world_part[k],
                          depth_m=depth, part_id=part, instance_id=instance)


class SimulatedSequence(IteratesFrames):
    """Frames as an ideal camera records them: exact depth, true flow, true object ids as labels."""

    def __init__(self, world: World, renderer: Renderer, frames: int, kept: int = _KEPT,
                 stereo: bool = False) -> None:
        """Move the world through all its frames (none is drawn yet).

        Args:
            world: is moved about from now on; do not move it elsewhere.
            renderer: stays the caller's to close.
            frames: K > 0; frame k is at k / world.fps.
            kept: frames (12 MB each at 640×480, flow included) that stay in memory; all of them
                where several systems are to see the same sequence.
            stereo: frames have a right image, and the intrinsics a baseline.
        Raises:
            UserError: frames is not positive, or more than a sequence may have.
        """
        if not 1 <= frames <= MOST_FRAMES:
            raise UserError(f"frames {frames}: a sequence has 1 to {MOST_FRAMES}")
        self.stamps_s = np.arange(frames) / world.fps
        self.truth = SimulatedTruth(world, renderer, self.stamps_s, kept)
        self.intrinsics: Intrinsics = world.layout.intrinsics
        self.holds = frozenset({"flow", "masks", "depth"} | ({"stereo"} if stereo else set()))
        if stereo:
            indoors = self.truth.reach_m <= _INDOOR_M
            self.intrinsics = replace(self.intrinsics, baseline_m=(
                _INDOOR_BASELINE_M if indoors else _OUTDOOR_BASELINE_M))
        self.name: str = world.spec.name
        self._fps: float = world.fps
        self._identity = {"scene": world.spec.name, "seed": world.seed, "dials": world.dials,
                          "fps": world.fps, "frames": frames, "renderer": type(renderer).__name__,
                          "size": [self.intrinsics.width, self.intrinsics.height],
                          "mujoco": mujoco.__version__} | ({"stereo": True} if stereo else {})
        self._renderer = renderer
        self._pictures = _Memory(kept)
        self._rights = _Memory(kept)

    def __len__(self) -> int:
        return len(self.stamps_s)

    def frame(self, k: int) -> Frame:
        """Frame k; its flow is that of the pixels of frame k − 1, None for the first frame.

        The flow is valid where the point lies in this frame's image, be it hidden there or not;
        `truth.flow(k - 1, k).occluded` tells which are hidden.
        """
        truth = self.truth.frame(k)
        return Frame(index=k, stamp_s=truth.stamp_s, rgb=self.rgb(k), depth_m=truth.depth_m,
                     intrinsics=self.intrinsics, instance_id=truth.instance_id,
                     flow=None if k == 0 else _as_field(self.truth.flow(k - 1, k)),
                     right=self.right(k) if "stereo" in self.holds else None)

    def rgb(self, k: int) -> Array:
        """(H, W, 3) uint8 picture of the instant of frame k."""
        return self._pictures.get(k, lambda: self._renderer.rgb(self.truth.world_at(k)))

    def right(self, k: int) -> Array:
        """(H, W, 3) uint8 picture of frame k from a camera one baseline to the right.

        Raises:
            ValueError: the sequence was made without stereo.
        """
        if self.intrinsics.baseline_m is None:
            raise ValueError(f"{self.name}: was made without stereo")
        shift = np.eye(4)
        shift[0, 3] = self.intrinsics.baseline_m

        def drawn() -> Array:
            world = self.truth.world_at(k)
            world.camera_offset = world.camera_offset @ shift
            return self._renderer.rgb(world)

        return self._rights.get(k, drawn)

    def render_blurred(self, k: int, exposure_s: float, subframes: int) -> Array:
        """(H, W, 3) uint8 picture of an exposure around the instant of frame k.

        The mean, in linear light, of sub-frames spread evenly over the exposure, so that the
        frame's truth is that of mid-exposure. Nothing came before the first frame: an exposure
        that would begin before time 0 is shortened at both ends.

        Raises:
            UserError: the exposure is negative or longer than a frame, or there is no sub-frame.
        """
        period_s = 1.0 / self._fps
        if not 0.0 <= exposure_s <= period_s or subframes < 1:
            raise UserError(f"motion blur of {exposure_s} s in {subframes} sub-frames: wanted an "
                            f"exposure from 0 to {period_s:.4g} s and at least one sub-frame")
        middle_s = float(self.stamps_s[k])
        half_s = min(0.5 * exposure_s, middle_s)
        offsets_s = half_s * ((2.0 * np.arange(subframes) + 1.0) / subframes - 1.0)
        world = self.truth.world_at(max(k - 1, 0))
        pictures = []
        for offset_s in offsets_s:
            world.advance_to(middle_s + float(offset_s))
            pictures.append(self._renderer.rgb(world))
        return mean_in_linear_light(pictures)

    def fingerprint(self) -> str:
        """SHA-256 of scene, version, seed, dials, size, stamps, renderer and MuJoCo version."""
        return hashlib.sha256(json.dumps(self._identity, sort_keys=True).encode()).hexdigest()


class _Memory:
    """The last few results, the least recently used going first."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._held: dict[str, OrderedDict[Hashable, Any]] = {}

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        kind = key[0] if isinstance(key, tuple) else ""
        held = self._held.setdefault(kind, OrderedDict())
        if key not in held:
            held[key] = make()
        held.move_to_end(key)
        while len(held) > self._size:
            held.popitem(last=False)
        return held[key]


def _as_field(flow: FlowTruth) -> FlowField:
    return FlowField(flow_px=flow.flow_px, valid=flow.valid & ~flow.leaving)
