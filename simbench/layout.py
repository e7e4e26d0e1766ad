"""What a compiled scene holds: its camera, its objects, its edges."""

from __future__ import annotations

import mujoco
import numpy as np

from simbench.edges import model_edges
from simbench.errors import UserError
from simbench.scene import SceneObject, SceneSpec, Staging
from simbench.types import ObjectInfo, SceneLayout
from slam.types import Intrinsics


def model_layout(model: mujoco.MjModel, staging: Staging, size: tuple[int, int], spec: SceneSpec
                 ) -> SceneLayout:
    """Camera, objects and edges of a compiled scene at that image size (width, height).

    Raises:
        UserError: an object that is no body of the model.
    """
    objects = _moving_bodies(model) if staging.objects is None else staging.objects
    instance_of_part = np.zeros(model.nbody, np.int32)
    infos = []
    for number, each in enumerate(objects, start=1):
        root = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, each.body)
        if root <= 0:
            raise UserError(f"scene {spec.name}: object {each.body!r} is no body of {spec.mjcf}")
        below = _subtree(model, root)
        instance_of_part[below] = number
        jointed = any(model.body_jntnum[part] for part in below if part != root)
        rigid = not jointed if each.rigid is None else each.rigid
        infos.append(ObjectInfo(number, each.body, root, rigid, each.category))
    edges = model_edges(model, staging.shortest_edge_m, staging.edgeless)
    return SceneLayout(_intrinsics(model, size), tuple(infos), instance_of_part, edges)


def _intrinsics(model: mujoco.MjModel, size: tuple[int, int]) -> Intrinsics:
    """Square pixels; MuJoCo's optical axis meets the image at its middle."""
    width, height = size
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, "camera")
    focal = 0.5 * height / np.tan(0.5 * np.deg2rad(float(model.cam_fovy[camera])))
    return Intrinsics(float(focal), float(focal), (width - 1) / 2.0, (height - 1) / 2.0,
                      width, height)


def _moving_bodies(model: mujoco.MjModel) -> tuple[SceneObject, ...]:
    """The children of the world that move and can be seen."""
    found = []
    for body in range(1, model.nbody):
        if model.body_parentid[body] == 0:
            below = _subtree(model, body)
            moves = model.body_mocapid[body] >= 0 or any(model.body_jntnum[p] for p in below)
            if moves and any(model.body_geomnum[p] for p in below):
                found.append(SceneObject(model.body(body).name))
    return tuple(found)


def _subtree(model: mujoco.MjModel, root: int) -> list[int]:
    inside = {root}
    for body in range(root + 1, model.nbody):   # parents come before their children
        if int(model.body_parentid[body]) in inside:
            inside.add(body)
    return sorted(inside)
