"""The table of object tracks: which mask is which object, and what is known of its motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from slam.config import DynamicConfig
from slam.geometry import se3
from slam.geometry.arrays import Array

_SAME_TIME = 1e-6    # relative


@dataclass(frozen=True, slots=True)
class ObjectState:
    """One object as it was last seen."""

    track: int
    label: int                       # mask label in the last frame in which it had one
    seen_s: float
    first_s: float                   # when it was first seen
    parked: bool = False             # still for long enough: its features are static ones
    moved_s: float = -np.inf         # when it was last judged to move
    H_world: Array | None = None     # (4, 4) its last motion, for prediction
    over_s: float = 1.0              # the time that motion took


@dataclass(slots=True)
class ObjectTable:
    """Object tracks alive, by track number."""

    config: DynamicConfig
    states: dict[int, ObjectState] = field(default_factory=dict)
    next_track: int = 1

    def of_label(self, stamp_s: float) -> dict[int, ObjectState]:
        """Mask label -> state of the objects that were seen at `stamp_s`."""
        return {s.label: s for s in self.states.values() if s.seen_s == stamp_s}

    def relabel(self, pairs: dict[int, int], labels: Iterable[int], before_s: float,
                stamp_s: float) -> dict[int, int]:
        """Give each mask label of the new frame its track: followed, or new.

        Args:
            pairs: label now -> label in the frame at `before_s`.
            labels: all labels now.
        Returns:
            label now -> track.
        """
        before = self.of_label(before_s)
        tracks: dict[int, int] = {}
        for label in labels:
            old = before.get(pairs.get(label, -1))
            track = self.next_track if old is None else old.track
            if old is None:
                self.next_track += 1
                old = ObjectState(track, label, stamp_s, stamp_s)
            self.states[track] = replace(old, label=label, seen_s=stamp_s)
            tracks[label] = track
        self.states = {t: s for t, s in self.states.items()
                       if stamp_s - s.seen_s <= self.config.forget_s}
        return tracks

    def judged(self, track: int, moving: bool, stamp_s: float, H_world: Array | None,
               over_s: float) -> bool:
        """Record a motion; whether the object counts as dynamic, also through a short stop.

        Args:
            H_world: (4, 4) its motion, or None where it is not to be trusted for prediction.
            over_s: the time between the two frames.
        """
        state = self.states[track]
        moved_s = stamp_s if moving else state.moved_s
        dynamic = stamp_s - moved_s <= self.config.stay_dynamic_s
        still_s = stamp_s - max(state.first_s, moved_s)
        self.states[track] = replace(
            state, parked=not dynamic and still_s >= self.config.parked_after_s, moved_s=moved_s,
            H_world=H_world, over_s=over_s)
        return dynamic

    def forget_motion(self, track: int) -> None:
        """The object's motion could not be told: nothing is predicted from an older one."""
        self.states[track] = replace(self.states[track], H_world=None)

    def predicted_relative(self, track: int, T_world_previous: Array, dt_s: float) -> Array:
        """(4, 4) motion expected of an object against the static world, in the previous camera."""
        state = self.states.get(track)
        if state is None or state.H_world is None or state.parked:
            return np.eye(4)
        in_camera = se3.inverse(T_world_previous) @ state.H_world @ T_world_previous
        times = dt_s / state.over_s
        if abs(times - 1.0) < _SAME_TIME:
            return in_camera
        return np.asarray(se3.exp(se3.log(in_camera) * times))
