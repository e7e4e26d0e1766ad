"""The marker room, registered by running this file, with a camera whose path the seed turns."""

import runpy
from pathlib import Path

from simbench.motion import pose
from simbench.scene import register_scene

_HERE = Path(__file__).parent
_motion = runpy.run_path(str(_HERE / "marker_room.py"))["motion"]


def motion(time_s, seed, dials):
    placed = _motion(time_s, seed, dials)
    return placed | {"camera": placed["camera"] @ pose((0.05 * seed, 0.0, 0.0))}


register_scene(name="StoredRoom-v0", description="boxes and meshes of known motion",
               mjcf=_HERE / "marker_room.xml", motion=motion,
               width=96, height=72, fps=10.0, frames=5)
