"""A world in the hands of an agent, as a sequence of which the last two frames are known."""

from __future__ import annotations

import numpy as np

from simbench.exposure import mean_in_linear_light
from simbench.extents import part_boxes
from simbench.render import Renderer
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
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import Frame, Intrinsics


class LiveTruth:
    """Exact truth of the present and the previous frame, and all poses so far."""

    has_images = True

    def __init__(self, world: World) -> None:
        self.layout: SceneLayout = world.layout
        self._model = world.model
        self._caster = RayCaster(world.model)
        self._frames: list[FrameTruth] = []     # the last two
        self._flow: FlowTruth | None = None
        self._stamps_s: list[float] = []
        self._T_world_camera: list[Array] = []
        self._T_world_part: list[Array] = []
        self._seen: list[frozenset[int]] = []

    def append(self, stamp_s: float, world: World, depth_m: Array, part_id: Array) -> None:
        """The world has moved on: this is the present frame now."""
        # The last entry stands for part -1, where nothing is seen.
        instance = np.append(self.layout.instance_of_part, 0).astype(np.int32)[part_id]
        frame = FrameTruth(len(self._seen), stamp_s, world.T_world_camera, world.T_world_part,
                           depth_m, part_id, instance)
        self._frames = [*self._frames[-1:], frame]
        self._flow = None
        self._stamps_s.append(stamp_s)
        self._T_world_camera.append(frame.T_world_camera)
        self._T_world_part.append(frame.T_world_part)
        self._seen.append(frozenset(np.flatnonzero(np.bincount(instance.ravel())).tolist()))

    def frame(self, k: int) -> FrameTruth:
        """Raises ValueError unless k is the present or the previous frame."""
        for frame in self._frames:
            if frame.index == k:
                return frame
        raise ValueError(f"frame {k} is not one of the last two of {len(self._seen)}")

    def flow(self, i: int, j: int) -> FlowTruth:
        """Motion of every pixel of frame i to frame j, both of the last two."""
        if (i, j) != (len(self._seen) - 2, len(self._seen) - 1):
            return flow_between(self.frame(i), self.frame(j), self.layout, self._caster)
        if self._flow is None:
            self._flow = flow_between(self.frame(i), self.frame(j), self.layout, self._caster)
        return self._flow

    def edges(self, k: int) -> VisibleEdges:
        """Visible stretches of the scene's edges."""
        return visible_edges(self.frame(k), self.layout, self._caster)

    def part_boxes(self) -> Array:
        """(P, 2, 3) m, lowest and highest corner of each part in its own frame, NaN if unseen."""
        return part_boxes(self._model)

    def true_instances(self, k: int) -> Array:
        """(H, W) int32 true object id per pixel; 0 = background."""
        return self.frame(k).instance_id

    @property
    def trajectories(self) -> Trajectories:
        """Poses from the start to the present frame; an object is valid where a pixel shows it."""
        T_world_part = np.stack(self._T_world_part)
        objects = {
            each.instance_id: ObjectPoses(
                T_world_part[:, each.root_part],
                np.array([each.instance_id in seen for seen in self._seen]),
                each.rigid, each.name)
            for each in self.layout.objects}
        return Trajectories(np.array(self._stamps_s), np.stack(self._T_world_camera),
                            np.ones(len(self._seen), bool), objects)


class LiveSequence:
    """Frame 0 is the world after its reset; each `step` makes the next."""

    holds = frozenset[str]()

    def __init__(self, world: World, renderer: Renderer, steps: int) -> None:
        """
        Args:
            world: is reset, and moved by this sequence from now on.
            renderer: stays the caller's to close.
            steps: how many `step`s will be made at most.
        """
        world.reset()
        self.name: str = world.spec.name
        self.intrinsics: Intrinsics = world.layout.intrinsics
        self.stamps_s: Array = np.arange(steps + 1) / world.fps
        self.truth = LiveTruth(world)
        self.index = 0
        self._world, self._renderer = world, renderer
        self._pictures: dict[int, Array] = {}
        self._state_before = world.state()
        self._twist = np.zeros(6)
        self._see()

    def __len__(self) -> int:
        return len(self.stamps_s)

    def step(self, twist: Array) -> None:
        """Go on to the next stamp.

        Args:
            twist: (6,) [ω rad/s, v m/s] of the camera in its own frame, on top of its script.
        """
        self._state_before, self._twist = self._world.state(), np.asarray(twist, np.float64)
        self.index += 1
        self._move(float(self.stamps_s[self.index]))
        self._see()

    def frame(self, k: int) -> Frame:
        """The present or the previous frame by an ideal camera, without flow or masks."""
        truth = self.truth.frame(k)
        return Frame(k, truth.stamp_s, self.rgb(k), truth.depth_m, self.intrinsics)

    def rgb(self, k: int) -> Array:
        """(H, W, 3) uint8 picture of the present or the previous frame."""
        return self._pictures[k]

    def render_blurred(self, k: int, exposure_s: float, subframes: int) -> Array:
        """(H, W, 3) uint8 picture of an exposure around the present frame k.

        An exposure that would begin before the last frame is shortened at both ends.
        """
        middle_s = float(self.stamps_s[k])
        half_s = min(0.5 * exposure_s, middle_s - float(self.stamps_s[max(k - 1, 0)]))
        offsets_s = half_s * ((2.0 * np.arange(subframes) + 1.0) / subframes - 1.0)
        present = self._world.state()
        self._world.restore(self._state_before)
        pictures = []
        for offset_s in offsets_s:
            self._move(middle_s + float(offset_s))
            pictures.append(self._renderer.rgb(self._world))
        self._world.restore(present)
        return mean_in_linear_light(pictures)

    def fingerprint(self) -> str:
        """Raises ValueError: what an agent does has no identity before it is done."""
        raise ValueError(f"{self.name}: a live sequence has no fingerprint")

    def _move(self, stamp_s: float) -> None:
        """Advance the world, and its camera's offset with the present twist."""
        elapsed_s = stamp_s - self._world.time_s
        offset = self._world.camera_offset @ se3.exp(self._twist * elapsed_s)
        self._world.advance_to(stamp_s)
        if np.any(self._twist):
            self._world.camera_offset = offset

    def _see(self) -> None:
        depth_m, part_id = self._renderer.depth_and_parts(self._world)
        self.truth.append(float(self.stamps_s[self.index]), self._world, depth_m, part_id)
        self._pictures.pop(self.index - 2, None)
        self._pictures[self.index] = self._renderer.rgb(self._world)
