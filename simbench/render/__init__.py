"""Pixels of a world: colour, exact depth and the part seen at each pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from simbench.errors import UnknownName

if TYPE_CHECKING:
    from simbench.world import World
    from slam.geometry.arrays import Array

RENDERERS = ("mujoco", "pyrender")
SHOWN_GEOM_GROUPS = (1, 1, 1, 0, 0, 0)   # what is drawn, and what rays hit; MuJoCo's default


class Renderer(Protocol):
    """Draws a world as it stands, at the size of its intrinsics."""

    def rgb(self, world: World) -> Array:
        """(H, W, 3) uint8."""
        ...

    def depth_and_parts(self, world: World) -> tuple[Array, Array]:
        """(H, W) float32 z-depth in metres, 0 = nothing; (H, W) int32 part, -1 = nothing."""
        ...

    def close(self) -> None:
        """Free the OpenGL context; the renderer cannot be used afterwards."""
        ...


def make_renderer(name: str, world: World) -> Renderer:
    """A renderer by name, "mujoco" or "pyrender", for worlds of this world's image size.

    Raises:
        UnknownName: no renderer has this name.
        NoOpenGL: this machine cannot render.
        UserError: "pyrender" is asked for and not installed.
    """
    if name == "mujoco":
        from simbench.render.mujoco_renderer import MujocoRenderer  # noqa: PLC0415 (loads OpenGL)
        return MujocoRenderer(world)
    if name == "pyrender":
        from simbench.render.pyrender_renderer import PyrenderRenderer  # noqa: PLC0415
        return PyrenderRenderer(world)
    raise UnknownName(f"no renderer {name!r}; there are {', '.join(RENDERERS)}")
