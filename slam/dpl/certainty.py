"""How well the map knows each of its landmarks.

A landmark from one depth reading is off by that reading's error, along the ray. A pose that took it
for exact would follow that error; so the fit of a pose adds it to what the pixel's noise is
(slam.dpl.pose), as eliminating the landmark would.
"""

from __future__ import annotations

import numpy as np

from slam.dpl.sightings import Sightings
from slam.factors import landmark_terms
from slam.geometry.arrays import Array
from slam.types import Intrinsics

_PRIOR_SHARE = 0.3       # standard deviation of a landmark that nothing is known of, of its depth


class Certainty:
    """Information of positions (3, 3), 1/m², by row: a sum over the keyframes that see them."""

    def __init__(self) -> None:
        self._information = np.zeros((1024, 3, 3))

    def add(self, rows: Array, xyz_world: Array, seen: Sightings, T_world_camera: Array,
            camera: Intrinsics, kernel_width: float) -> None:
        """Add a keyframe's sightings of the landmarks `rows` (N,) at (N, 3)."""
        if not len(rows):
            return
        size = len(self._information)
        if rows.max() >= size:
            grown = np.zeros((max(2 * size, int(rows.max()) + 1), 3, 3))
            grown[:size] = self._information
            self._information = grown
        terms = landmark_terms(np.broadcast_to(T_world_camera, (len(rows), 4, 4)), xyz_world,
                               seen.uv_px, seen.rho, camera)
        L = np.zeros((len(rows), 3, 3))
        L[:, [0, 1, 1, 2], [0, 0, 1, 2]] = seen.whitening
        V = L @ terms.J_point
        r = np.einsum("nij,nj->ni", L, terms.r)
        weight = 1.0 / (1.0 + np.sum(r * r, axis=1) / kernel_width**2)
        fresh = weight[:, None, None] * (np.swapaxes(V, 1, 2) @ V)
        good = np.isfinite(fresh).all(axis=(1, 2))
        self._information[rows[good]] += fresh[good]

    def forget(self, rows: Array) -> None:
        """Rows that are other landmarks' now: nothing is known of these."""
        self._information[rows[rows < len(self._information)]] = 0.0

    def covariance(self, rows: Array, distance_m: Array) -> Array:
        """(N, 3, 3) m² of landmarks that a camera sees at distances (N,)."""
        held = np.zeros((len(rows), 3, 3))
        there = rows < len(self._information)
        held[there] = self._information[rows[there]]
        prior = 1.0 / np.maximum(_PRIOR_SHARE * distance_m, 1e-3) ** 2
        return np.linalg.inv(held + prior[:, None, None] * np.eye(3))
