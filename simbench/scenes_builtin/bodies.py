"""Bodies on joints that a script turns: no physics, no collisions."""

from __future__ import annotations

import mujoco
from numpy.typing import ArrayLike


def add_hinged(parent: mujoco.MjsBody, name: str, place: ArrayLike,
               hinges: dict[str, ArrayLike]) -> mujoco.MjsBody:
    """A body at `place` (3,) m in its parent, on hinges through its own origin.

    Args:
        hinges: axis (3,) of each joint by its name, the first one turning all that follow.
    """
    body = parent.add_body(name=name, pos=place)
    make_weightless(body)
    for joint, axis in hinges.items():
        body.add_joint(name=joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    return body


def make_weightless(body: mujoco.MjsBody) -> None:
    """MuJoCo wants a mass of every jointed body; these are moved by script alone."""
    body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
    body.ipos, body.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
