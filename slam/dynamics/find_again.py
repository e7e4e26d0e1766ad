"""Masks that nothing leads to, and lost tracks: which mask is a lost object come back?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.config import DynamicConfig
from slam.dynamics.objects import ObjectState
from slam.dynamics.sightings import MaskSightings, likeness
from slam.geometry.arrays import Array

_LARGEST_GROWTH = 1.6    # of the extent since an object was last seen whole
_DEPTH_SHARE = 0.05      # of the distance: what the middle of a visible part may be off in depth


def find_again(lost: Sequence[ObjectState], new: MaskSightings, T_world_camera: Array,
               stamp_s: float, config: DynamicConfig) -> dict[int, int]:
    """Mask label -> the track that it continues, one to one, the best agreements first.

    A lost object is expected where its last velocity would have carried it. The gate about that
    place is its own size, and grows with what an acceleration could have done since. A mask of
    other colours, or much larger than the object ever was, is another object's.

    Args:
        lost: tracks without a mask in this frame, all with a place.
        new: the masks without a track.
    """
    if not lost or not len(new):
        return {}
    since_s = stamp_s - np.array([s.place_s for s in lost])
    expected = np.array([_expected_place(s, stamp_s) for s in lost])
    still = np.array([s.parked for s in lost])
    extent = np.array([s.extent_m for s in lost])
    distance = np.linalg.norm(expected[:, None] - new.place_world[None], axis=2)
    far = np.linalg.norm(new.place_world - T_world_camera[:3, 3], axis=1)
    drift = np.where(still, 0.0, 0.5 * config.find_again_acceleration_m_s2 * since_s**2)
    gate = np.maximum(extent[:, None], new.extent_m[None]) + drift[:, None] + _DEPTH_SHARE * far
    alike = likeness(np.array([s.colours for s in lost], dtype=np.float64), new.colours)
    whole = ~np.array([s.cut_off for s in lost])[:, None]
    grown = whole & (new.extent_m[None] > _LARGEST_GROWTH * extent[:, None])
    cost = distance / gate + (1.0 - alike)
    possible = (distance <= gate) & (alike >= config.find_again_likeness) & ~grown
    return _best_first(cost, possible, [s.track for s in lost], new.label)


def _expected_place(state: ObjectState, stamp_s: float) -> Array:
    """(3,) where an object is at constant velocity; what is parked stays."""
    place = np.asarray(state.place_world)
    if state.velocity_m_s is None or state.parked:
        return place
    return np.asarray(place + state.velocity_m_s * (stamp_s - state.place_s))


def _best_first(cost: Array, possible: Array, tracks: Sequence[int], labels: Array
                ) -> dict[int, int]:
    rows, columns = np.nonzero(possible)
    found: dict[int, int] = {}
    for i in np.argsort(cost[rows, columns], kind="stable"):
        track, label = tracks[rows[i]], int(labels[columns[i]])
        if label not in found and track not in found.values():
            found[label] = track
    return found
