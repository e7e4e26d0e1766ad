"""The second renderer: the same triangles drawn by pyrender, to check the first by.

Depth and parts agree with MuJoCo's; colours are plain, without textures. pyrender's z-buffer has
24 bits, half of them spent near the camera, so that depth z is known to about z² / near · 2⁻²³.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from simbench.errors import UserError
from simbench.extras import how_to_install
from simbench.render import gl
from simbench.render.geometry import geom_colours, geom_triangles, shown_geoms
from slam.geometry import se3

if TYPE_CHECKING:
    from simbench.world import World
    from slam.geometry.arrays import Array

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_LIGHT = 1.5   # W/m² of the one light, which shines from the camera


class PyrenderRenderer:
    """Draws the boxes, planes and meshes of one world's model."""

    def __init__(self, world: World) -> None:
        """Load the model's triangles.

        Raises:
            NoOpenGL: this machine cannot render.
            UserError: pyrender is not installed, or the model has geoms of another kind.
        """
        intrinsics = world.layout.intrinsics
        self._context: Any = gl.make_context(intrinsics.width, intrinsics.height)
        self._pyrender = _load_pyrender()
        self._renderer = self._pyrender.Renderer(intrinsics.width, intrinsics.height)
        self._intrinsics = intrinsics
        self._load(world.model)

    def rgb(self, world: World) -> Array:
        """(H, W, 3) uint8 in plain colours, lit from the camera."""
        return self._draw(world, self._pyrender.RenderFlags.NONE)[0]

    def depth_and_parts(self, world: World) -> tuple[Array, Array]:
        """(H, W) float32 z-depth in metres, 0 = nothing; (H, W) int32 body, -1 = nothing."""
        colour, depth = self._draw(world, self._pyrender.RenderFlags.SEG)
        geom = colour[..., 0].astype(np.int32) + 256 * colour[..., 1].astype(np.int32) - 1
        body = np.append(self._model.geom_bodyid, -1).astype(np.int32)
        return np.where(geom >= 0, depth, 0.0).astype(np.float32), body[geom]

    def close(self) -> None:
        """Free the OpenGL context; closing twice is harmless."""
        if self._context is not None:
            self._context.make_current()
            self._renderer.delete()
            self._context.free()
            self._context = None

    def _load(self, model: Any) -> None:
        pyrender, intrinsics = self._pyrender, self._intrinsics
        view = model.vis.map
        near, far = view.znear * model.stat.extent, view.zfar * model.stat.extent
        self._scene = pyrender.Scene(ambient_light=(0.3, 0.3, 0.3), bg_color=(0.0, 0.0, 0.0, 1.0))
        # pyrender counts pixels from their corners, as OpenGL does.
        camera = pyrender.IntrinsicsCamera(intrinsics.fx, intrinsics.fy, intrinsics.cx + 0.5,
                                           intrinsics.cy + 0.5, znear=near, zfar=far)
        self._camera = self._scene.add(camera)
        self._light = self._scene.add(pyrender.DirectionalLight(intensity=_LIGHT))
        self._nodes: dict[int, Any] = {}
        colours = geom_colours(model)
        for geom in shown_geoms(model).tolist():
            vertices, faces = geom_triangles(model, geom, far)
            material = pyrender.MetallicRoughnessMaterial(
                baseColorFactor=colours[geom], metallicFactor=0.0, roughnessFactor=1.0)
            corners = vertices[faces]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
            flat = pyrender.Primitive(positions=corners.reshape(-1, 3), material=material,
                                      normals=np.repeat(normals, 3, axis=0))
            self._nodes[geom] = self._scene.add(pyrender.Mesh([flat]))
        self._colour_of_node = {node: ((geom + 1) % 256, (geom + 1) // 256, 0)
                                for geom, node in self._nodes.items()}
        self._model = model

    def _draw(self, world: World, flags: int) -> tuple[Array, Array]:
        if self._context is None:
            raise RuntimeError("the renderer is closed")
        self._context.make_current()
        if world.model is not self._model:
            self._renderer.delete()
            self._renderer = self._pyrender.Renderer(self._intrinsics.width,
                                                     self._intrinsics.height)
            self._load(world.model)
        T_world_geom = se3.from_rotation_translation(
            world.data.geom_xmat.reshape(-1, 3, 3), world.data.geom_xpos)
        for geom, node in self._nodes.items():
            self._scene.set_pose(node, T_world_geom[geom])
        T_world_camera = world.T_world_camera @ _OPENGL_FROM_OPENCV
        self._scene.set_pose(self._camera, T_world_camera)
        self._scene.set_pose(self._light, T_world_camera)
        colour, depth = self._renderer.render(
            self._scene, flags | self._pyrender.RenderFlags.OFFSCREEN, self._colour_of_node)
        return np.array(colour), depth


def _load_pyrender() -> Any:
    """pyrender, imported only after the OpenGL platform is chosen."""
    try:
        import pyglet  # noqa: PLC0415
        pyglet.options["headless"] = True   # else pyrender's viewer asks for a server's X libraries
        import pyrender  # noqa: PLC0415
    except ImportError as error:
        raise UserError("the pyrender renderer is not installed; "
                        f"{how_to_install('pyrender')}") from error
    return pyrender
