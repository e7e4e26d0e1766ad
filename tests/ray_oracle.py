"""Truth by one mj_ray per pixel: it knows nothing of depth images, triangles or tiles."""

from typing import NamedTuple

import cv2
import mujoco
import numpy as np

from slam.geometry import se3


class Landing(NamedTuple):
    """On N pixels of frame i."""

    part: np.ndarray     # part hit in i, -1 = none
    depth_m: np.ndarray  # z in i
    flow_px: np.ndarray  # (N, 2) to j
    scene_flow_m: np.ndarray
    ahead: np.ndarray    # before camera j
    inside: np.ndarray   # and in its image
    hidden: np.ndarray   # and behind something


def cast(world, directions):
    """First hits of rays from the camera: distances in lengths of the ray, and bodies."""
    groups = np.array([1, 1, 1, 0, 0, 0], np.uint8)
    origin = world.T_world_camera[:3, 3]
    distance, body = np.empty(len(directions)), np.empty(len(directions), int)
    geom = np.empty(1, np.int32)
    for n, direction in enumerate(directions):
        distance[n] = mujoco.mj_ray(world.model, world.data, origin, direction, groups, 1, -1, geom)
        body[n] = world.model.geom_bodyid[geom[0]] if geom[0] >= 0 else -1
    return np.where(body >= 0, distance, np.inf), body


def pixels_of(frame, stride):
    """(N, 2) every stride-th pixel in both directions, row by row."""
    height, width = frame.depth_m.shape
    v, u = np.mgrid[0:height:stride, 0:width:stride]
    return np.stack([u, v], axis=-1).reshape(-1, 2)


def land(truth, i, j, stride):
    """Follow the pixels of i to j."""
    intrinsics = truth.layout.intrinsics
    uv = pixels_of(truth.frame(i), stride)
    focal = np.array([intrinsics.fx, intrinsics.fy])
    centre = np.array([intrinsics.cx, intrinsics.cy])
    rays = np.concatenate([(uv - centre) / focal, np.ones((len(uv), 1))], axis=1)
    world = truth.world_at(i)
    T_i, parts_i = world.T_world_camera, world.T_world_part
    depth, part = cast(world, rays @ T_i[:3, :3].T)
    hit = part >= 0
    points = se3.transform_points(T_i, rays * np.where(hit, depth, 1.0)[:, None])
    world = truth.world_at(j)
    motion = world.T_world_part @ se3.inverse(parts_i)
    moved = np.einsum("nij,nj->ni", motion[part][:, :3, :3], points) + motion[part][:, :3, 3]
    in_j = se3.transform_points(se3.inverse(world.T_world_camera), moved)
    ahead = hit & (in_j[:, 2] > 0)
    landed = in_j[:, :2] / np.where(ahead, in_j[:, 2], 1.0)[:, None] * focal + centre
    size = np.array([intrinsics.width, intrinsics.height])
    inside = ahead & np.all((landed >= -0.5) & (landed < size - 0.5), axis=-1)
    met, _ = cast(world, moved - world.T_world_camera[:3, 3])
    return Landing(part, depth, landed - uv, moved - points, ahead, inside,
                   inside & (met < 1.0 - 1e-6))


def near_steps(depth_m, reach=1):
    """(H, W) bool: within reach pixels of a step in depth, or of the sky."""
    window = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    return cv2.dilate(depth_m, window) > 1.02 * cv2.erode(depth_m, window)


def near_bends(depth_m):
    """(H, W) bool: the 3 by 3 pixels around are not one plane, to 1e-5 of the inverse depth."""
    inverse = np.divide(1.0, depth_m, out=np.zeros(depth_m.shape), where=depth_m > 0)
    bend = np.zeros_like(inverse)
    bend[1:-1] = np.abs(inverse[2:] - 2 * inverse[1:-1] + inverse[:-2])
    bend[:, 1:-1] = np.maximum(bend[:, 1:-1],
                               np.abs(inverse[:, 2:] - 2 * inverse[:, 1:-1] + inverse[:, :-2]))
    return cv2.dilate(bend, np.ones((3, 3), np.uint8)) > 1e-5 * inverse


def near_part_borders(part_id, reach=1):
    """(H, W) bool: within reach pixels of another part."""
    window = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    shown = part_id.astype(np.float32)
    return cv2.dilate(shown, window) != cv2.erode(shown, window)


def on_grid(image, stride):
    """The pixels of `pixels_of` of an (H, W, ...) image, as (N, ...)."""
    taken = image[::stride, ::stride]
    return taken.reshape(-1, *taken.shape[2:])
