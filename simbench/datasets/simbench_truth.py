"""Exact truth read from truth.zarr; flow, occlusion and visible edges are computed on reading."""

from __future__ import annotations

from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from simbench.datasets.manifest import Manifest
from simbench.datasets.truth_arrays import TruthArray
from simbench.errors import BadFile, BadFrame
from simbench.storage import TRUTH
from simbench.types import (
    Edges3D,
    FlowTruth,
    FrameTruth,
    ObjectPoses,
    SceneLayout,
    Trajectories,
    VisibleEdges,
)
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_KEPT = 4   # frames, and flows, that stay in memory
_PER_FRAME = ("depth_m", "part_id", "object_pixels")
_DTYPES = {"stamps_s": "<f8", "T_world_camera": "<f8", "T_world_part": "<f8",
           "instance_of_part": "<i4", "edge_part_id": "<i4", "edge_endpoints_part": "<f8",
           "depth_m": "<f4", "part_id": "<i2", "object_pixels": "<i4"}
_WHOLE = tuple(name for name in _DTYPES if name not in _PER_FRAME)


class StoredTruth:
    """Truth of a generated sequence; rays are cast in the scene, built again from its seed."""

    has_images = True

    def __init__(self, folder: Path, manifest: Manifest, intrinsics: Intrinsics) -> None:
        """Read poses and layout. Raises BadFile when they are missing or damaged."""
        self._folder, self._manifest = folder, manifest
        arrays = {name: TruthArray(folder / TRUTH, name) for name in _WHOLE}
        self._per_frame = {name: TruthArray(folder / TRUTH, name, per_frame=True)
                           for name in _PER_FRAME}
        frames, objects = manifest.frames, manifest.objects
        size = (intrinsics.height, intrinsics.width)
        parts = arrays["instance_of_part"].shape[0]
        edges = arrays["edge_part_id"].shape[0]
        wanted = {"stamps_s": (frames,), "T_world_camera": (frames, 4, 4),
                  "T_world_part": (frames, parts, 4, 4), "instance_of_part": (parts,),
                  "edge_part_id": (edges,), "edge_endpoints_part": (edges, 2, 3),
                  "depth_m": (frames, *size), "part_id": (frames, *size),
                  "object_pixels": (frames, len(objects))}
        for name, array in (arrays | self._per_frame).items():
            if array.shape != wanted[name] or array.dtype != _DTYPES[name]:
                raise BadFile(f"{array.path}: {array.dtype} {array.shape}, wanted "
                              f"{_DTYPES[name]} {wanted[name]}; generate the sequence again")
        try:
            fixed = {name: array.whole() for name, array in arrays.items()}
        except BadFile as error:
            raise BadFile(f"{folder / TRUTH}: missing or damaged: {error}") from None
        _check_values(folder, fixed, max((o.root_part for o in objects), default=0))
        self.stamps_s = fixed["stamps_s"]
        self._T_world_camera, self._T_world_part = fixed["T_world_camera"], fixed["T_world_part"]
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
        return TruthArray(self._folder / TRUTH, "state").whole()

    @cached_property
    def trajectories(self) -> Trajectories:
        """True poses; an object is valid where a pixel shows it."""
        count = len(self.stamps_s)
        pixels = [self._per_frame["object_pixels"].frame(k) for k in range(count)]
        objects = {
            each.instance_id: ObjectPoses(
                T_world_object=self._T_world_part[:, each.root_part],
                valid=np.array([row[i] > 0 for row in pixels], bool),
                rigid=each.rigid, name=each.name)
            for i, each in enumerate(self.layout.objects)}
        return Trajectories(self.stamps_s, self._T_world_camera, np.ones(count, bool), objects)

    def _read_frame(self, k: int) -> FrameTruth:
        part = self._per_frame["part_id"].frame(k).astype(np.int32)
        depth_m = self._per_frame["depth_m"].frame(k)
        parts = len(self.layout.instance_of_part)
        if part.min() < -1 or part.max() >= parts or not np.isfinite(depth_m).all():
            raise BadFrame(f"{self._folder / TRUTH}: frame {k} shows a part that does not exist, "
                           "or a depth that is no number; generate the sequence again")
        # The last entry stands for part -1, where nothing is seen.
        instance = np.append(self.layout.instance_of_part, 0).astype(np.int32)[part]
        return FrameTruth(index=k, stamp_s=float(self.stamps_s[k]),
                          T_world_camera=self._T_world_camera[k],
                          T_world_part=self._T_world_part[k],
                          depth_m=depth_m, part_id=part, instance_id=instance)

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
        world = self._manifest.make_world()
        if len(world.layout.instance_of_part) != len(self.layout.instance_of_part):
            raise BadFile(f"{self._folder}: scene {self._manifest.scene} has other parts than "
                          "when the sequence was generated; generate it again")
        return world.model


def _check_values(folder: Path, fixed: dict[str, Array], last_root: int) -> None:
    """Raises BadFile where an array of all frames holds what it cannot."""
    parts = len(fixed["instance_of_part"])
    edge_part, instance = fixed["edge_part_id"], fixed["instance_of_part"]
    with np.errstate(over="ignore", invalid="ignore"):
        steps_s = np.diff(fixed["stamps_s"])
    wrong = {
        "a number is not finite": not all(np.isfinite(values).all() for values in fixed.values()),
        "the stamps do not increase": bool(np.any(steps_s <= 0)),
        "an edge or an object is of no part": last_root >= parts or bool(
            np.any((edge_part < 0) | (edge_part >= parts))),
        "an instance id is out of range": bool(np.any((instance < 0) | (instance > 65535)))}
    for what, holds in wrong.items():
        if holds:
            raise BadFile(f"{folder / TRUTH}: {what}; generate the sequence again")
