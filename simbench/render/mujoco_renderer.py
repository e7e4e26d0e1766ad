"""MuJoCo's classic OpenGL renderer: RGB with shadows and 4x MSAA, depth and parts in one pass."""

from __future__ import annotations

import atexit
import functools
import weakref
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from simbench.errors import UserError
from simbench.render import SHOWN_GEOM_GROUPS, gl

if TYPE_CHECKING:
    from simbench.world import World
    from slam.geometry.arrays import Array

_COLOUR_SAMPLES = 4
_GL_RGBA = 0x1908   # four bytes a pixel are read out faster than three, and viewed as one integer
_SHOWN = (mujoco.mjtVisFlag.mjVIS_TEXTURE, mujoco.mjtVisFlag.mjVIS_STATIC)
_live: weakref.WeakSet[MujocoRenderer] = weakref.WeakSet()


class MujocoRenderer:
    """Draws worlds of one image size; a world with another model is taken up when it comes."""

    def __init__(self, world: World) -> None:
        """Make the OpenGL context for the image size of `world`.

        Raises:
            NoOpenGL: this machine cannot render.
            UserError: the model has no camera "camera", or the image is too large.
        """
        intrinsics = world.layout.intrinsics
        self._width, self._height = intrinsics.width, intrinsics.height
        self._context: Any = gl.make_context(self._width, self._height)
        self._rect = mujoco.MjrRect(0, 0, self._width, self._height)
        self._model: Any = None
        self._colour: Any = None     # MjrContext with multisampling
        self._exact: Any = None      # MjrContext without: a pixel is what stands at its centre
        _live.add(self)
        _close_all_at_exit()
        self._bind(world.model)

    def rgb(self, world: World) -> Array:
        """(H, W, 3) uint8, with shadows and 4 samples a pixel."""
        self._update(world)
        picture = np.empty((self._height, self._width, 3), np.uint8)
        _draw(self._rect, self._scene, self._colour)
        mujoco.mjr_readPixels(picture, None, self._rect, self._colour)
        return np.ascontiguousarray(picture[::-1])

    def depth_and_parts(self, world: World) -> tuple[Array, Array]:
        """(H, W) float32 z-depth in metres, 0 = nothing; (H, W) int32 body, -1 = nothing."""
        self._update(world)
        shape = (self._height, self._width)
        ids, z_buffer = np.empty((*shape, 4), np.uint8), np.empty(shape, np.float32)
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = True
        _draw(self._rect, self._scene, self._exact)
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = False
        mujoco.mjr_readPixels(ids, z_buffer, self._rect, self._exact)
        numbers = ids.view(np.uint32)[::-1, :, 0] & 0xFFFFFF
        parts = self._part_of_number[numbers]
        depth = _metric_depth(z_buffer[::-1], *self._clip_planes())
        depth[parts < 0] = 0.0
        return depth, parts

    def close(self) -> None:
        """Free the OpenGL context; closing twice is harmless."""
        if self._context is None:
            return
        self._context.make_current()
        self._free_buffers()
        self._context.free()
        self._context = None

    def _free_buffers(self) -> None:
        for buffers in (self._colour, self._exact):
            if buffers is not None:
                buffers.free()
        self._colour = self._exact = None

    def _bind(self, model: Any) -> None:
        """Load a model's meshes and textures into OpenGL."""
        self._context.make_current()
        self._free_buffers()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = _camera_id(model)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)
        self._option = _plain_option()
        self._colour = _buffers(model, self._width, self._height, samples=_COLOUR_SAMPLES)
        self._exact = _buffers(model, self._width, self._height, samples=0)
        self._exact.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._exact.readPixelFormat = _GL_RGBA
        if (self._exact.offWidth, self._exact.offHeight) != (self._width, self._height):
            raise UserError(f"OpenGL gives no {self._width}x{self._height} image: "
                            "ask for a smaller size")
        self._part_of_number: Array = np.empty(0, np.int32)
        self._model = model

    def _update(self, world: World) -> None:
        if self._context is None:
            raise RuntimeError("the renderer is closed")
        self._context.make_current()
        if world.model is not self._model:
            self._bind(world.model)
        mujoco.mjv_updateScene(self._model, world.data, self._option, None, self._camera,
                               mujoco.mjtCatBit.mjCAT_ALL, self._scene)
        if len(self._part_of_number) != self._scene.ngeom + 1:
            self._part_of_number = _part_of_number(self._model, self._scene)

    def _clip_planes(self) -> tuple[float, float]:
        extent, view = self._model.stat.extent, self._model.vis.map
        return view.znear * extent, view.zfar * extent


def _camera_id(model: Any) -> int:
    number = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, "camera"))
    if number < 0:
        raise UserError('the model has no camera "camera": add <camera name="camera" fovy="60"/>')
    return number


def _plain_option() -> Any:
    """Geoms only: what rays do not hit (sites, tendons, skins, frames) is not drawn."""
    option = mujoco.MjvOption()
    option.geomgroup[:] = SHOWN_GEOM_GROUPS
    option.flags[:] = False
    for flag in _SHOWN:
        option.flags[flag] = True
    for groups in (option.sitegroup, option.tendongroup, option.actuatorgroup, option.skingroup,
                   option.flexgroup, option.jointgroup):
        groups[:] = False
    return option


def _buffers(model: Any, width: int, height: int, samples: int) -> Any:
    """An MjrContext of this size, whatever the model's own settings, which stay as they were."""
    view, quality = model.vis.global_, model.vis.quality
    kept = view.offwidth, view.offheight, quality.offsamples
    view.offwidth, view.offheight, quality.offsamples = width, height, samples
    buffers = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    view.offwidth, view.offheight, quality.offsamples = kept
    return buffers


def _draw(rect: Any, scene: Any, buffers: Any) -> None:
    """Render into these buffers; which ones OpenGL draws into is state of the whole context."""
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, buffers)
    mujoco.mjr_render(rect, scene, buffers)


def _part_of_number(model: Any, scene: Any) -> Array:
    """Table from drawn number to body; number 0 is the sky.

    The order of the drawn geoms is the model's and depends on nothing that moves.
    """
    table = np.full(scene.ngeom + 1, -1, np.int32)
    for geom in scene.geoms[:scene.ngeom]:
        if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.segid >= 0:
            table[geom.segid + 1] = model.geom_bodyid[geom.objid]
    return table


def _metric_depth(z_buffer: Array, near: float, far: float) -> Array:
    """Planar z in metres from a reversed z-buffer (1 at the near plane, 0 at the far plane).

    The projection's coefficients are rounded as OpenGL rounds them; the rest is float64.
    """
    n, f = np.float32(near), np.float32(far)
    a = np.float32(-0.5) * (-(f + n) / (f - n)) - np.float32(0.5)
    b = np.float32(0.5) * ((np.float32(2.0) * f * n) / (f - n))
    inverse = z_buffer.astype(np.float64)
    inverse += float(a)
    return np.divide(float(b), inverse, out=inverse).astype(np.float32)


@functools.cache
def _close_all_at_exit() -> None:
    """Free open contexts before the platform frees its display, else it complains at exit.

    Functions at exit run last in, first out, and the platform has entered its own by now.
    """
    atexit.register(_close_all)


def _close_all() -> None:
    for renderer in list(_live):
        renderer.close()
