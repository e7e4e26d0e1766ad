"""Exact truth read from truth.zarr; flow, occlusion and visible edges are computed on reading."""

from __future__ import annotations

from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from simbench.errors import BadFile, BadFrame
from simbench.storage import MANIFEST, TRUTH, truth_chunk_path
from simbench.types import (
    Edges3D,
    FlowTruth,
    FrameTruth,
    ObjectInfo,
    ObjectPoses,
    SceneLayout,
    Trajectories,
    VisibleEdges,
)
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_KEPT = 4   # frames, and flows, that stay in memory
_ALL = ("stamps_s", "T_world_camera", "T_world_part", "instance_of_part", "edge_part_id",
        "edge_endpoints_part")


class StoredTruth:
    """Truth of a generated sequence; rays are cast in the scene, built again from its seed."""

    has_images = True

    def __init__(self, folder: Path, manifest: dict[str, Any], intrinsics: Intrinsics) -> None:
        """Read poses and layout. Raises BadFile when they are missing or damaged."""
        self._folder, self._manifest = folder, manifest
        try:
            self._group = zarr.open_group(folder / TRUTH, mode="r")
            fixed = {name: self._fixed(name) for name in _ALL}
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            raise BadFile(f"{folder / TRUTH}: missing or damaged ({type(error).__name__}); "
                          "generate the sequence again") from error
        self.stamps_s = fixed["stamps_s"]
        if len(self.stamps_s) != manifest["frames"]:
            raise BadFile(f"{folder / TRUTH}: {len(self.stamps_s)} frames, {MANIFEST} says "
                          f"{manifest['frames']}; generate the sequence again")
        self._T_world_camera, self._T_world_part = fixed["T_world_camera"], fixed["T_world_part"]
        objects = tuple(ObjectInfo(o["instance_id"], o["name"], o["root_part"], o["rigid"],
                                   o.get("category", ""))
                        for o in manifest["objects"])
        self.layout = SceneLayout(intrinsics, objects, fixed["instance_of_part"],
                                  Edges3D(fixed["edge_part_id"], fixed["edge_endpoints_part"]))
        self._frames = lru_cache(_KEPT)(self._read_frame)
        self._flows = lru_cache(_KEPT)(self._make_flow)

    def frame(self, k: int) -> FrameTruth:
        """Poses, depth, parts and objects of frame k. Raises BadFrame."""
        return self._frames(k)

    def flow(self, i: int, j: int) -> FlowTruth:
        """Motion of every pixel of frame i to any frame j. Raises BadFrame."""
        return self._flows(i, j)

    def edges(self, k: int) -> VisibleEdges:
        """Visible stretches of the scene's edges in frame k."""
        from simbench.truth import visible_edges  # noqa: PLC0415 (needs MuJoCo; poses do not)
        return visible_edges(self.frame(k), self.layout, self._caster)

    def part_boxes(self) -> Array:
        """(P, 2, 3) m, lowest and highest corner of each part in its own frame, NaN if unseen."""
        from simbench.extents import part_boxes  # noqa: PLC0415 (needs MuJoCo; poses do not)
        return part_boxes(self._model)

    def true_instances(self, k: int) -> Array:
        """(H, W) int32 true object id per pixel; 0 = background."""
        return self.frame(k).instance_id

    @property
    def poses(self) -> tuple[Array, Array]:
        """Of the camera (K, 4, 4) and of all parts (K, P, 4, 4), in the world."""
        return self._T_world_camera, self._T_world_part

    def states(self) -> Array:
        """(K, S) what `World.restore` takes to show each frame again."""
        return self._fixed("state")

    @cached_property
    def trajectories(self) -> Trajectories:
        """True poses; an object is valid where a pixel shows it."""
        count = len(self.stamps_s)
        pixels = [self._per_frame("object_pixels", k) for k in range(count)]
        objects = {
            each.instance_id: ObjectPoses(
                T_world_object=self._T_world_part[:, each.root_part],
                valid=np.array([row[i] > 0 for row in pixels], bool),
                rigid=each.rigid, name=each.name)
            for i, each in enumerate(self.layout.objects)}
        return Trajectories(self.stamps_s, self._T_world_camera, np.ones(count, bool), objects)

    def _read_frame(self, k: int) -> FrameTruth:
        part = self._per_frame("part_id", k).astype(np.int32)
        # The last entry stands for part -1, where nothing is seen.
        instance = np.append(self.layout.instance_of_part, 0).astype(np.int32)[part]
        return FrameTruth(index=k, stamp_s=float(self.stamps_s[k]),
                          T_world_camera=self._T_world_camera[k],
                          T_world_part=self._T_world_part[k],
                          depth_m=self._per_frame("depth_m", k), part_id=part,
                          instance_id=instance)

    def _make_flow(self, i: int, j: int) -> FlowTruth:
        from simbench.truth import flow_between  # noqa: PLC0415 (needs MuJoCo; poses do not)
        return flow_between(self.frame(i), self.frame(j), self.layout, self._caster)

    @cached_property
    def _caster(self) -> Any:
        """Casts rays in the scene."""
        from simbench.truth import RayCaster  # noqa: PLC0415 (needs MuJoCo; poses do not)
        return RayCaster(self._model)

    @cached_property
    def _model(self) -> Any:
        """The scene that the manifest names, built again. Raises UserError if it cannot be."""
        from simbench.scene import known_scene  # noqa: PLC0415 (needs MuJoCo; poses do not)
        from simbench.world import make_world  # noqa: PLC0415
        wanted = self._manifest
        width, height = wanted["size"]
        world = make_world(known_scene(wanted["scene"]), wanted["seed"], wanted["dials"],
                           (width, height), wanted["fps"])
        if len(world.layout.instance_of_part) != len(self.layout.instance_of_part):
            raise BadFile(f"{self._folder}: scene {wanted['scene']} has other parts than when the "
                          "sequence was generated; generate it again")
        return world.model

    def _fixed(self, name: str) -> Array:
        # zarr takes a chunk that is not there for one of zeros.
        array = self._group[name]
        assert isinstance(array, zarr.Array)
        chunk = self._folder.joinpath(TRUTH, name, "c", *["0"] * array.ndim)
        if array.size and not chunk.exists():
            raise FileNotFoundError(chunk)
        return np.asarray(array[...])

    def _per_frame(self, name: str, k: int) -> Array:
        path = truth_chunk_path(self._folder, name, k)
        array = self._group[name]
        assert isinstance(array, zarr.Array)
        if array.shape[1] == 0:
            return np.zeros(0, np.int32)
        if not path.exists():
            raise BadFrame(f"{path}: no such file; generate the sequence again")
        try:
            return np.asarray(array[k])
        except (ValueError, RuntimeError, OSError):
            raise BadFrame(f"{path}: truncated or damaged; generate the sequence again") from None
