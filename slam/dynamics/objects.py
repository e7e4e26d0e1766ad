"""The table of object tracks: which mask is which object, and what is known of its motion."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from slam.config import DynamicConfig
from slam.dynamics.sightings import MaskSightings
from slam.dynamics.smooth_motion import BodyVelocity
from slam.geometry import se3
from slam.geometry.arrays import Array

_SAME_TIME = 1e-6       # relative
_NEW_COLOURS = 0.2     # share of what a whole sighting's colours count for


@dataclass(frozen=True, slots=True)
class ObjectState:
    """One object as it was last seen."""

    track: int
    label: int                       # mask label in the last frame in which it had one
    seen_s: float
    first_s: float                   # when it was first seen
    parked: bool = False             # still for long enough: its features are static ones
    moved_s: float = -np.inf         # when it was last judged to move
    judged_s: float = -np.inf        # when a motion of it was last measured
    suspected: bool = False          # whether it moved when last judged, beyond doubt or not
    suspected_s: float = -np.inf     # when it was last not seen to stand
    H_world: Array | None = None     # (4, 4) its last motion, for prediction
    over_s: float = 1.0              # the time that motion took
    velocity: BodyVelocity | None = None   # all its motions up to the last one say
    mask_s: float = -np.inf          # when it last had a mask that was not carried
    place_s: float = -np.inf         # when it was last located:
    place_world: Array | None = None   # (3,) the middle of what was visible of it, m
    extent_m: float = 0.0            # its largest visible extent
    cut_off: bool = False            # then the image's border cut it
    colours: Array | None = None     # (64,) as MaskSightings has them, of all sightings
    velocity_m_s: Array | None = None   # (3,) of that middle, when it was last known


@dataclass(slots=True)
class ObjectTable:
    """Object tracks alive, by track number."""

    config: DynamicConfig
    states: dict[int, ObjectState] = field(default_factory=dict)
    next_track: int = 1

    def of_label(self, stamp_s: float) -> dict[int, ObjectState]:
        """Mask label -> state of the objects that were seen at `stamp_s`."""
        return {s.label: s for s in self.states.values() if s.seen_s == stamp_s}

    def is_seen(self, track: int, stamp_s: float) -> bool:
        """Whether an object has a mask at `stamp_s`, one that was carried on counting, too."""
        return track in self.states and self.states[track].seen_s == stamp_s

    def relabel(self, pairs: Mapping[int, int], labels: Iterable[int], before_s: float,
                stamp_s: float, again: Mapping[int, int] | None = None,
                carried: Collection[int] = ()) -> dict[int, int]:
        """Give each mask label of the new frame its track: followed, found again, or new.

        Args:
            pairs: label now -> label in the frame at `before_s`.
            labels: all labels now.
            again: label now -> lost track, from `find_again`.
            carried: labels now that no detector gave.
        Returns:
            label now -> track.
        """
        before = self.of_label(before_s)
        again = {} if again is None else again
        tracks: dict[int, int] = {}
        for label in labels:
            old = before.get(pairs.get(label, -1))
            if old is None and label in again:
                old = self.states[again[label]]
            track = self.next_track if old is None else old.track
            if old is None:
                self.next_track += 1
                old = ObjectState(track, label, stamp_s, stamp_s)
            mask_s = old.mask_s if label in carried else stamp_s
            self.states[track] = replace(old, label=label, seen_s=stamp_s, mask_s=mask_s)
            tracks[label] = track
        self.states = {t: s for t, s in self.states.items()
                       if stamp_s - s.seen_s <= self.config.forget_s}
        return tracks

    def missed(self, pairs: Mapping[int, int], before_s: float, stamp_s: float) -> list[int]:
        """Labels at `before_s` of the objects whose mask goes on for a while without a detector."""
        followed = set(pairs.values())
        return [label for label, s in sorted(self.of_label(before_s).items())
                if label not in followed and stamp_s - s.mask_s <= self.config.carry_s]

    def lost(self, tracked: Collection[int], before_s: float) -> list[ObjectState]:
        """The tracks that have been located, and that no mask continues.

        Args:
            tracked: labels in the frame at `before_s` that are followed.
        """
        return [s for s in self.states.values() if s.place_world is not None
                and not (s.seen_s == before_s and s.label in tracked)]

    def locate(self, seen: MaskSightings, stamp_s: float) -> None:
        """Remember where and how each object was seen at `stamp_s`."""
        state = self.of_label(stamp_s)
        for i, label in enumerate(seen.label.tolist()):
            s = state.get(label)
            if s is not None:
                extent_m = float(seen.extent_m[i])
                largest_m = max(s.extent_m, extent_m)
                # What a small part shows says less of the whole.
                new = 1.0 if s.colours is None else _NEW_COLOURS * (extent_m / largest_m) ** 2
                old = 0.0 if s.colours is None else (1.0 - new) * s.colours
                self.states[s.track] = replace(
                    s, place_s=stamp_s, place_world=seen.place_world[i], extent_m=largest_m,
                    cut_off=bool(seen.cut_off[i]), colours=old + new * seen.colours[i])

    def judged(self, track: int, moved: int, stamp_s: float, H_world: Array | None,
               over_s: float, velocity: BodyVelocity | None = None) -> bool:
        """Record a motion; whether the object counts as dynamic, also through a short stop.

        What moves within doubt must do so twice running: matches of a small far thing are wrong
        together now and then, and its depths jump. A new thing need only move beyond such jumps.

        Args:
            moved: as `scene_flow.moving` has it.
            H_world: (4, 4) its motion, or None where it is not to be trusted for prediction.
            over_s: the time between the two frames.
        """
        state = self.states[track]
        new = np.isinf(state.judged_s)
        believed = (moved > (1 if new else 2) or state.suspected
                    or stamp_s - state.moved_s <= self.config.stay_dynamic_s)
        moved_s = stamp_s if moved > 0 and believed else state.moved_s
        dynamic = stamp_s - moved_s <= self.config.stay_dynamic_s
        suspected_s = state.suspected_s if moved == 0 else stamp_s
        still_s = stamp_s - max(state.first_s, suspected_s)
        velocity_m_s = state.velocity_m_s
        if H_world is not None and state.place_world is not None:
            place = state.place_world[None]
            velocity_m_s = (se3.transform_points(H_world, place) - place)[0] / over_s
        self.states[track] = replace(
            state, parked=not dynamic and still_s >= self.config.parked_after_s, moved_s=moved_s,
            suspected=moved > 0, suspected_s=suspected_s, judged_s=stamp_s,
            H_world=H_world, over_s=over_s, velocity=velocity, velocity_m_s=velocity_m_s)
        return dynamic

    def forget_motion(self, track: int) -> None:
        """The object's motion could not be told: nothing is predicted from an older one."""
        self.states[track] = replace(self.states[track], H_world=None, velocity=None)

    def correct(self, track: int, H_world: Array) -> None:
        """Predict from a better estimate of an object's last motion, where it is trusted at all."""
        state = self.states[track]
        if state.H_world is not None:
            self.states[track] = replace(state, H_world=H_world)

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
