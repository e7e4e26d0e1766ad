"""Keyframes' poses and their landmarks as one least-squares problem, for the damped descent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam.backend.linearise import linearise
from slam.backend.pose_system import solve_poses
from slam.backend.reduced import landmark_steps, reduce_landmarks
from slam.dpl.sightings import Sightings
from slam.geometry import se3
from slam.geometry.arrays import Array
from slam.residuals import camera_tuple
from slam.types import Intrinsics


@dataclass(frozen=True, slots=True)
class Rows:
    """Whose sightings are whose, by landmark and then by keyframe."""

    pose: Array          # (M,) row of the keyframe
    landmark: Array      # (M,) row of the landmark: points first, then the ends of lines
    feature: Array       # (M,) row of the feature in its keyframe; of an end, its line's
    is_point: Array      # (M,) bool


class MapState(NamedTuple):
    """Keyframes' poses and landmarks."""

    T_world_camera: Array     # (F, 4, 4)
    xyz_world: Array          # (P, 3) m


class _Terms(NamedTuple):
    """Whitened residuals at a state, and their derivatives."""

    residual: Array        # (M, 3)
    by_pose: Array         # (M, 3, 6)
    by_landmark: Array     # (M, 3, 3)


def _room(rows: int) -> _Terms:
    return _Terms(np.zeros((rows, 3)), np.zeros((rows, 3, 6)), np.zeros((rows, 3, 3)))


class MapProblem:
    """Robust errors of all sightings; `slam.backend.descend` lowers them.

    Args:
        held: (F,) bool, keyframes that do not move.
        kernel_width: of Cauchy's kernel, in standard deviations.
    """

    def __init__(self, rows: Rows, seen: Sightings, held: Array, landmarks: int,
                 camera: Intrinsics, kernel_width: float) -> None:
        self.rows, self.seen, self.held = rows, seen, held
        self.camera, self.kernel_width = camera_tuple(camera), kernel_width
        self.start = np.searchsorted(rows.landmark, np.arange(landmarks + 1))
        first = self.start[rows.landmark]
        self.band = int(np.max(rows.pose - rows.pose[first], initial=1)) + 1
        self.fixed = held[rows.pose]
        self._taken, self._tried = _room(len(seen)), _room(len(seen))
        self.chi2 = self._chi2_tried = np.zeros(len(seen))

    def objective(self, state: MapState) -> float:
        """The robust cost of a state."""
        cost, self._chi2_tried = linearise(
            state.T_world_camera, state.xyz_world, self.rows.pose, self.rows.landmark,
            self.seen.uv_px, self.seen.rho, self.seen.whitening, self.camera, self.kernel_width,
            *self._tried)
        self._tried.by_pose[self.fixed] = 0.0
        return float(cost)

    def take_over(self) -> None:
        """Linearise where the objective was asked for last."""
        self._taken, self._tried = self._tried, self._taken
        self.chi2 = self._chi2_tried

    def stepped(self, state: MapState, damping: float) -> MapState | None:
        """The state one damped step on; None where the system is singular."""
        F, P = len(state.T_world_camera), len(state.xyz_world)
        S, g = np.zeros((F, self.band, 6, 6)), np.zeros((F, 6))
        inverse, gradient = np.zeros((P, 3, 3)), np.zeros((P, 3))
        nothing_held = np.zeros((P, 3, 3)), np.zeros((P, 3))
        reduce_landmarks(self.rows.pose, self.start, *self._taken, *nothing_held, damping, S, g,
                         inverse, gradient)
        S[self.held, 0] += np.eye(6)
        step = solve_poses(S, g, damping)
        if step is None:
            return None
        moved = landmark_steps(self.rows.pose, self.start, self._taken.by_pose,
                               self._taken.by_landmark, inverse, gradient, step)
        return MapState(state.T_world_camera @ se3.exp(step), state.xyz_world + moved)
