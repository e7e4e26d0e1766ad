"""A small room whose motion is a plain function of time, for tests of pixels and truth."""

from pathlib import Path

import numpy as np

from simbench.motion import look_at, pose
from simbench.scene import SceneSpec


def motion(time_s, seed, dials):
    t = time_s
    return {
        "camera": look_at((-1.2 + 0.5 * t, -3.2 + 0.2 * t, 1.5 + 0.2 * np.sin(2 * t)),
                          (0.1, 0.3, 0.9), roll=0.1 * np.sin(t)),
        "box": pose((0.5 * np.sin(2 * t), 0.2 * t, 1.0), yaw=1.1 * t, pitch=0.5 * t),
        "hinge": 0.8 * np.sin(4 * t),
        "ball": pose((1.2 - 0.9 * t, 0.5, 0.8 + 0.2 * np.cos(3 * t)), roll=2.0 * t),
        "wedge": pose((-1.0 + 0.4 * t, 0.3, 0.2), yaw=-0.7 * t, roll=0.3 * t),
        "marker": pose((-0.3 + 0.3 * t, -1.0, 1.2 - 0.2 * t), yaw=t),
    }


SPEC = SceneSpec(
    name="MarkerRoom-v0", description="boxes and meshes of known motion",
    mjcf=Path(__file__).with_name("marker_room.xml"), motion=motion,
    width=320, height=240, fps=10.0, frames=20)
