"""Which OpenGL platform this machine can render with: EGL, else OSMesa, found by trying."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

from simbench.errors import UserError

_PLATFORMS = ("egl", "osmesa")
_PROBED = "SIMBENCH_GL"   # set for child processes, so that each does not probe again
_PROBE_TIMEOUT_S = 60.0
_PROBE = """
import importlib, os
context = importlib.import_module("mujoco." + os.environ["MUJOCO_GL"]).GLContext(16, 16)
context.make_current()
from OpenGL import GL
print(GL.glGetString(GL.GL_RENDERER).decode())
context.free()
"""


class NoOpenGL(UserError):
    """Neither EGL nor OSMesa can be loaded on this machine."""


def choose_platform() -> str:
    """Name the platform to render with, "egl" or "osmesa", and set the variables that select it.

    The choice is made once, in child processes that may crash without harm, and is handed to
    this process's own children by the environment. `MUJOCO_GL=egl` or `osmesa` set by the user
    limits the choice to that one.

    Raises:
        NoOpenGL: no platform works; the message names the system packages to install.
    """
    chosen = os.environ.get(_PROBED)
    if chosen not in _PLATFORMS:
        wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
        candidates = (wanted,) if wanted in _PLATFORMS else _PLATFORMS
        chosen = next((name for name in candidates if platform_works(name)), None)
        if chosen is None:
            raise NoOpenGL(
                f"no OpenGL to render with ({' and '.join(candidates)} cannot be loaded): "
                "install libegl1 libgl1-mesa-dri libgles2 (or libosmesa6) with apt-get")
    _select(os.environ, chosen)
    return chosen


def platform_works(name: str) -> bool:
    """True when a child process makes a context on the platform "egl" or "osmesa"."""
    environment = dict(os.environ)
    _select(environment, name)
    try:
        answer = subprocess.run([sys.executable, "-c", _PROBE], env=environment, check=False,
                                capture_output=True, timeout=_PROBE_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return False
    return answer.returncode == 0


def _select(environment: Any, name: str) -> None:
    environment.update({"MUJOCO_GL": name, "PYOPENGL_PLATFORM": name, _PROBED: name})


def make_context(width: int, height: int) -> Any:
    """A current OpenGL context of the chosen platform, with `make_current()` and `free()`.

    The platform's module is imported here and not through `mujoco.GLContext`, which is fixed by
    the variables that stood when mujoco was first imported.

    Raises:
        NoOpenGL: there is no platform, or it refuses a context.
    """
    platform = choose_platform()
    try:
        if platform == "egl":
            from mujoco.egl import GLContext  # noqa: PLC0415 (only after the platform is chosen)
        else:
            from mujoco.osmesa import GLContext  # noqa: PLC0415
        context = GLContext(width, height)
        context.make_current()
    except (ImportError, AttributeError, RuntimeError) as error:
        raise NoOpenGL(f"OpenGL platform {platform} refuses a {width}x{height} context ({error}): "
                       "unset MUJOCO_GL and PYOPENGL_PLATFORM, or install libegl1 libgl1-mesa-dri "
                       "libgles2 (or libosmesa6) with apt-get") from error
    return context


def gl_renderer_name() -> str:
    """Vendor, renderer and version of the OpenGL that draws here, for certificates.

    Raises:
        NoOpenGL: no platform works.
    """
    context = make_context(16, 16)
    from OpenGL import GL  # noqa: PLC0415 (only after the platform is chosen)
    names = (GL.GL_VENDOR, GL.GL_RENDERER, GL.GL_VERSION)
    text = ", ".join(GL.glGetString(name).decode() for name in names)
    context.free()
    return f"{choose_platform()}: {text}"
