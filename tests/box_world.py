"""A textured room with boxes, ray-cast in NumPy: exact depth, masks and flow, no simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slam.geometry import camera as pinhole
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.types import FlowField, Frame, Intrinsics

CAMERA = Intrinsics(150.0, 150.0, 79.5, 59.5, 160, 120)
ROOM = np.array([3.0, 2.0, 5.0])       # half extents, m; its centre is the world's origin
FPS = 10.0


@dataclass(frozen=True)
class Box:
    """A box that moves as its poses say."""

    half_m: tuple[float, float, float]
    T_world_box: Array                 # (K, 4, 4)


@dataclass(frozen=True)
class Picture:
    """One rendered instant and where each pixel's surface point stands on its own body."""

    rgb: Array
    depth_m: Array
    label: Array                       # 0 = room
    body_points: Array                 # (H, W, 3) m, in the body's frame


def standing(x: float, y: float, z: float, frames: int) -> Array:
    """(K, 4, 4) poses of a box that stands still, turned a little so that three faces show."""
    return np.repeat(se3.exp(np.array([0.2, 0.5, 0.1, 0, 0, 0]))[None] * 1.0, frames, 0) \
        + _shift(x, y, z)


def moving(x: float, y: float, z: float, frames: int, velocity: tuple[float, ...],
           turn: tuple[float, ...] = (0.0, 0.0, 0.0), start: int = 0) -> Array:
    """The same, moved in the world by `velocity` (m) and turned about itself (rad) a frame."""
    poses = standing(x, y, z, frames).copy()
    for k in range(1, frames):
        step = k > start
        R = se3.exp_so3(np.array(turn) * step) @ poses[k - 1, :3, :3]
        poses[k] = se3.from_rotation_translation(R, poses[k - 1, :3, 3]
                                                 + np.array(velocity) * step)
    return poses


def _shift(x: float, y: float, z: float) -> Array:
    T = np.zeros((4, 4))
    T[:3, 3] = x, y, z
    return T


def hand_held(frames: int, amount: float = 1.0) -> Array:
    """(K, 4, 4) camera poses of a smooth motion in all six degrees of freedom."""
    t = np.arange(frames) / FPS
    xi = np.stack([0.05 * np.sin(1.3 * t), 0.08 * np.sin(1.7 * t), 0.04 * np.sin(0.9 * t),
                   0.25 * np.sin(1.1 * t), 0.12 * np.sin(1.5 * t), 0.25 * np.sin(0.7 * t)], -1)
    base = _shift(0.0, 0.0, -3.0) + np.eye(4)
    return np.asarray(base @ se3.exp(xi * amount))


def texture(points: Array, normal_axis: Array, seed: int) -> Array:
    """(..., 3) uint8 colours: waves in the body's own coordinates, a brightness for each face."""
    rng = np.random.default_rng([seed, 77])
    value = np.zeros(points.shape[:-1])
    for _ in range(24):
        direction = rng.normal(size=3) * 9.0
        value += np.sin(points @ direction + rng.uniform(0, 2 * np.pi))
    face = rng.uniform(70, 190, size=6)[normal_axis]
    grey = face + 9.0 * value
    tint = rng.uniform(0.85, 1.1, size=3)
    return np.clip(grey[..., None] * tint, 0, 255)


def render(T_world_camera: Array, boxes: Mapping[int, tuple[Array, Array]],
           camera: Intrinsics = CAMERA, offset: tuple[float, float] = (0.0, 0.0)) -> Picture:
    """Cast a ray through each pixel. `boxes`: label -> (half extents, T_world_box)."""
    v, u = np.mgrid[:camera.height, :camera.width].astype(float)
    rays = pinhole.rays(camera, np.stack([u + offset[0], v + offset[1]], -1).reshape(-1, 2))
    depth, face, points = _hit(np.eye(4), ROOM, T_world_camera, rays, from_inside=True)
    label = np.zeros(len(rays), np.int32)
    colour = texture(points, face, 0)
    for name, (half, T_world_box) in boxes.items():
        z, side, own = _hit(T_world_box, half, T_world_camera, rays, from_inside=False)
        nearer = z < depth
        depth = np.where(nearer, z, depth)
        label[nearer] = name
        points[nearer] = own[nearer]
        colour[nearer] = texture(own[nearer], side[nearer], name)
    shape = camera.height, camera.width
    return Picture(colour.reshape(*shape, 3), depth.reshape(shape), label.reshape(shape),
                   points.reshape(*shape, 3))


def _hit(T_world_body: Array, half: Array, T_world_camera: Array, rays: Array,
         from_inside: bool) -> tuple[Array, Array, Array]:
    """z-depth (N,) (inf: missed), face number (N,), point in the body's frame (N, 3)."""
    T = se3.inverse(T_world_body) @ T_world_camera
    direction, origin = rays @ T[:3, :3].T, T[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-np.asarray(half) - origin) / direction, (half - origin) / direction
    near, far = np.minimum(one, other), np.maximum(one, other)
    z, axis = (far.min(axis=1), far.argmin(axis=1)) if from_inside else (near.max(axis=1),
                                                                         near.argmax(axis=1))
    hit = np.full(len(rays), True) if from_inside else (z < far.min(axis=1)) & (z > 0.1)
    positive = np.take_along_axis(direction, axis[:, None], 1)[:, 0] > 0
    safe = np.where(hit, z, 1.0)
    return np.where(hit, z, np.inf), axis + 3 * positive, origin + safe[:, None] * direction


def sequence(T_world_camera: Array, boxes: Mapping[int, Box], camera: Intrinsics = CAMERA,
             with_flow: bool = True, labels: Mapping[int, int] | None = None) -> list[Frame]:
    """Frames as a system sees them; flow is exact, known where nothing comes to stand before."""
    frames: list[Frame] = []
    before: Picture | None = None
    for k, T in enumerate(T_world_camera):
        placed = {name: (np.array(box.half_m), box.T_world_box[k]) for name, box in boxes.items()}
        now = render(T, placed, camera)
        # Four rays a pixel, so that edges are where they are and not on whole pixels.
        quarter = [render(T, placed, camera, (a, b)).rgb
                   for a in (-0.25, 0.25) for b in (-0.25, 0.25)]
        rgb = np.rint(np.mean(quarter, axis=0)).astype(np.uint8)
        flow = None
        if with_flow and before is not None:
            flow = _flow(before, now, T, placed, camera)
        seen = now.label if labels is None else _renamed(now.label, labels)
        frames.append(Frame(k, k / FPS, rgb, now.depth_m.astype(np.float32), camera, seen,
                            flow=flow))
        before = now
    return frames


def _flow(before: Picture, now: Picture, T_world_camera: Array,
          placed: Mapping[int, tuple[Array, Array]], camera: Intrinsics) -> FlowField:
    world = before.body_points.copy()
    for name, (_, T_world_box) in placed.items():
        own = before.label == name
        world[own] = se3.transform_points(T_world_box, before.body_points[own])
    seen = se3.transform_points(se3.inverse(T_world_camera), world.reshape(-1, 3))
    uv = pinhole.project(camera, seen).reshape(*before.label.shape, 2)
    v, u = np.mgrid[:camera.height, :camera.width]
    column, row = np.rint(uv[..., 0]).astype(int), np.rint(uv[..., 1]).astype(int)
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    there = np.where(inside, row, 0), np.where(inside, column, 0)
    z = seen[:, 2].reshape(before.label.shape)
    valid = inside & (z > 0) & (np.abs(now.depth_m[there] - z) < 0.05 * z) \
        & (now.label[there] == before.label)
    return FlowField((uv - np.stack([u, v], -1)).astype(np.float32), valid)


def _renamed(label: Array, names: Mapping[int, int]) -> Array:
    out = np.zeros_like(label)
    for old, new in names.items():
        out[label == old] = new
    return out


def camera_errors(T_true: Array, estimates: list) -> tuple[Array, Array]:  # type: ignore[type-arg]
    """Translation (m) and rotation (rad) errors of each frame's motion."""
    errors = [se3.inverse(e.T_previous_camera) @ se3.inverse(T_true[k]) @ T_true[k + 1]
              for k, e in enumerate(estimates[1:])]
    return (np.array([np.linalg.norm(E[:3, 3]) for E in errors]),
            np.array([float(se3.rotation_angle(E[:3, :3])) for E in errors]))


def object_errors(T_camera: Array, T_box: Array, k: int, H_world: Array) -> tuple[float, float]:
    """Errors (m, rad) of a motion into frame k, in the body's frame; the estimate's world is
    the first camera."""
    A = T_camera[0]
    H = A @ H_world @ se3.inverse(A)
    L0, L1 = T_box[k - 1], T_box[k]
    E = se3.inverse(se3.inverse(L0) @ H @ L0) @ se3.inverse(L0) @ L1
    return float(np.linalg.norm(E[:3, 3])), float(se3.rotation_angle(E[:3, :3]))
