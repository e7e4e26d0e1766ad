"""One frame as the bodies seen in it: their pixels, and the camera's pose in each."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slam.frontend.observe import NO_GROUP, Observation
from slam.frontend.support import surface_image
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.map import STATIC


@dataclass(frozen=True)
class FrameBodies:
    """A frame with its bodies in slots 0 …, the static world first."""

    row: int                 # of the frame in the run
    current: Observation
    smooth: Array            # (H, W) float32 the picture prepared for alignment
    bodies: Array            # (B,) ascending
    T_body_camera: Array     # (B, 4, 4) the tracker's poses of the camera in them
    due: Array               # (B,) bool: whose landmarks are to be found again in this frame
    groups: Array            # (H, W) uint8 slot of each pixel; NO_GROUP where there is none

    @cached_property
    def surface(self) -> Array:
        """(H, W) that tells surfaces apart, as `surface_image` has it."""
        return surface_image(self.current.frame.depth_m, self.groups.astype(np.int32))

    @cached_property
    def _slot_of_body(self) -> Array:
        table = np.full(int(self.bodies.max()) + 2, -1)
        table[self.bodies] = np.arange(len(self.bodies))
        return table

    @cached_property
    def _T_camera_body(self) -> Array:
        return se3.inverse(self.T_body_camera)

    def slot(self, body: Array) -> Array:
        """(N,) slots of bodies; −1 where a body is not in the frame."""
        return np.asarray(self._slot_of_body[np.minimum(body, len(self._slot_of_body) - 1)])

    def has(self, body: Array) -> Array:
        """(N,) bool: which bodies are in the frame."""
        return np.asarray(self.slot(body) >= 0)

    def is_due(self, body: Array) -> Array:
        """(N,) bool: which bodies, all in the frame, are due."""
        return np.asarray(self.due[self.slot(body)])

    def since(self, T_body_first: Array, body: Array) -> Array:
        """(N, 4, 4): from cameras that stood at poses in bodies, to the camera now."""
        return np.asarray(self._T_camera_body[self.slot(body)] @ T_body_first)


def frame_bodies(row: int, current: Observation, smooth: Array,
                 T_body_camera: Mapping[int, Array], body_of_label: Mapping[int, int],
                 due: Collection[int]) -> FrameBodies | None:
    """A frame's bodies, or None where it has too many to tell apart.

    Args:
        T_body_camera: body -> (4, 4), the static world among them.
        body_of_label: mask label in this frame -> body; labels that are not named are left
            out, and the background is the static world.
        due: bodies whose landmarks are to be found again in this frame.
    """
    bodies = sorted(T_body_camera)
    slot = {body: i for i, body in enumerate(bodies)}
    if STATIC not in slot or len(bodies) >= NO_GROUP:
        return None
    groups = current.groups({label: slot[body] for label, body in body_of_label.items()
                             if body in slot})
    return FrameBodies(row, current, smooth, np.array(bodies),
                       np.stack([T_body_camera[b] for b in bodies]),
                       np.array([b in due for b in bodies]), groups)
