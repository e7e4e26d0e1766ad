"""Whose track is it: track numbers are the system's own and mean nothing to the truth."""

from __future__ import annotations

import numpy as np

from simbench.metrics.estimates import NO_OBJECT, ObjectMotions
from simbench.types import Trajectories
from slam.geometry.arrays import Array


def owners(track: Array, stands_on: Array) -> dict[int, int]:
    """Each track with the true object it stood on most often; NO_OBJECT if it never did.

    Args:
        track, stands_on: (M,) int, one row for each track and frame. Between objects on which a
            track stood equally often the lower number decides.
    """
    out: dict[int, int] = {}
    for number in np.unique(track):
        stood, count = np.unique(stands_on[(track == number) & (stands_on != NO_OBJECT)],
                                 return_counts=True)
        out[int(number)] = int(stood[np.argmax(count)]) if len(stood) else NO_OBJECT
    return out


def nearest_objects(motions: ObjectMotions, truth: Trajectories) -> Array:
    """(M,) the true object nearest to each motion's centroid at the frame before.

    The centroid is seen from the estimated camera and placed before the true one, so that drift
    of the camera does not decide. NO_OBJECT where no object's pose is known there.
    """
    before = motions.frame - 1
    if not truth.objects or not len(motions):
        return np.full(len(motions), NO_OBJECT, dtype=np.int64)
    names = np.array(sorted(truth.objects), dtype=np.int64)
    to_camera = np.linalg.inv(motions.T_world_camera)
    to_truth = truth.T_world_camera[before] @ to_camera
    centroid = (to_truth[:, :3, :3] @ motions.centroid_world[..., None])[..., 0] \
        + to_truth[:, :3, 3]
    origins = np.stack([truth.objects[n].T_world_object[:, :3, 3] for n in names], axis=1)
    valid = np.stack([truth.objects[n].valid for n in names], axis=1)
    valid = valid[before] & truth.camera_valid[before][:, None]
    distance = np.linalg.norm(origins[before] - centroid[:, None], axis=-1)
    distance = np.where(valid, distance, np.inf)
    nearest = names[np.argmin(distance, axis=1)]
    return np.asarray(np.where(valid.any(axis=1), nearest, NO_OBJECT))


def scored_rows(motions: ObjectMotions, owner: dict[int, int], true_id: int) -> Array:
    """Rows of `motions` that count for a true object: one for each frame, in order.

    Of several tracks of the object in one frame, the one that stands on it there counts, then
    the one that was estimated in most frames, then the lower number.
    """
    mine = np.array([owner[int(t)] == true_id for t in motions.track], dtype=bool)
    rows = np.flatnonzero(mine)
    tracks, inverse, count = np.unique(motions.track[rows], return_inverse=True,
                                       return_counts=True)
    if not len(tracks):
        return rows
    elsewhere = motions.stands_on[rows] != true_id
    order = np.lexsort((motions.track[rows], -count[inverse], elsewhere, motions.frame[rows]))
    rows = rows[order]
    first = np.r_[True, np.diff(motions.frame[rows]) > 0]
    return np.asarray(rows[first])


def identity_switches(motions: ObjectMotions, true_id: int) -> int:
    """How often the track that stands on a true object changes from one estimate to the next.

    While a track goes on standing there it is the one that counts, whatever else stands there.
    """
    rows = np.flatnonzero(motions.stands_on == true_id)
    switches, current = 0, None
    for frame in np.unique(motions.frame[rows]):
        standing = motions.track[rows[motions.frame[rows] == frame]]
        if current in standing:
            continue
        switches += current is not None
        current = int(standing.min())
    return switches
