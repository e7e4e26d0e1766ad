"""Corners and segments carried from the previous frame to the current one by dense flow (III-B)."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np

from slam.config import NoiseConfig
from slam.frontend.flow import sample_flow
from slam.frontend.observe import Observation
from slam.frontend.refine import RefineConfig, refine_matches
from slam.frontend.refine_lines import refine_segments
from slam.frontend.sampling import inside, nearest
from slam.frontend.surface import fit_surfaces
from slam.geometry.arrays import Array
from slam.matches import LineMatches, PointMatches
from slam.tables import taken
from slam.types import FlowField, Points2D, Segments2D

CORNER_KIND = 2          # PointMatches.kind of corners that dense flow carried
REFINED_KIND = 3         # of corners aligned on the images
_MAX_DEPTH_CHANGE = 0.5  # of inverse depth between two frames: a car that comes at us has 0.2
_SAMPLES = 8             # positions along a segment where the flow is read


def inverse_depth(depth_m: Array) -> Array:
    """1/z, and 0 where there is no depth."""
    depth = np.asarray(depth_m)
    return np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)


def follow_points(points: Points2D, group_a: Array, flow: FlowField, a: Observation,
                  b: Observation, group_b: Array,
                  noise: NoiseConfig) -> tuple[PointMatches, Array, Array]:
    """Corners of frame a where the flow carries them, if they stay on their own motion's pixels.

    Args:
        group_a: (N,) motion group of each point; < 0 = none.
        group_b: (H, W) uint8 motion group of each pixel of b, 255 = none.
    Returns:
        the matches, the slopes (M, 2) of their inverse depth in a, which points they are (M,).
    """
    flow_at, known = sample_flow(flow, points.uv_px, a.label_index)
    uv_b = points.uv_px + flow_at
    known &= (group_a >= 0) & inside(uv_b, group_b.shape, 2.0)
    index = np.flatnonzero(known)
    index = index[nearest(group_b, uv_b[index]) == group_a[index]]
    sigma = noise.inverse_depth_sigma
    here = fit_surfaces(a.rho, a.label_index, points.uv_px[index], sigma)
    there = fit_surfaces(b.rho, b.label_index, uv_b[index], sigma)
    # A depth that changes as no motion changes it: the flow went to something else.
    change = np.where(there.rho > 0, np.abs(there.rho - here.rho), 0.0)
    kept = (here.rho > 0) & (change <= _MAX_DEPTH_CHANGE * here.rho + 8.0 * sigma)
    index = index[kept]
    n = len(index)
    return PointMatches(
        uv_a=points.uv_px[index], rho_a=here.rho[kept], rho_sigma_a=sigma * here.gain[kept],
        uv_b=uv_b[index],
        flow_cov=np.broadcast_to(np.eye(2) * noise.flow_sigma_px**2, (n, 2, 2)),
        rho_b=there.rho[kept],
        rho_sigma_b=np.where(there.rho > 0, sigma * there.gain, np.inf)[kept],
        rho_slope_b=there.slope[kept],
        group=group_a[index], kind=np.full(n, CORNER_KIND)), here.slope[kept], index


def align_points(matches: PointMatches, expected_uv_b: Array, warps: Array, smooth_a: Array,
                 smooth_b: Array, surface_a: Array, b: Observation, noise: NoiseConfig,
                 config: RefineConfig) -> tuple[PointMatches, Array]:
    """The matches aligned on the images, with the covariance that their patches give.

    Args:
        expected_uv_b: (N, 2) where the motions found so far put the points.
        warps: (N, 2, 2) how the motions deform each patch.
        surface_a: (H, W) from `support.surface_image`: patches keep to one surface.
    Returns:
        the matches that converged, and which they are (M,).
    """
    aligned = refine_matches(smooth_a, smooth_b, matches.uv_a, expected_uv_b, config, warps,
                             surface_a)
    index = np.flatnonzero(aligned.converged)
    uv_b = aligned.uv_current[index]
    there = fit_surfaces(b.rho, b.label_index, uv_b, noise.inverse_depth_sigma)
    return PointMatches(
        uv_a=matches.uv_a[index], rho_a=matches.rho_a[index],
        rho_sigma_a=matches.rho_sigma_a[index], uv_b=uv_b, flow_cov=aligned.covariance[index],
        rho_b=there.rho,
        rho_sigma_b=np.where(there.rho > 0, noise.inverse_depth_sigma * there.gain, np.inf),
        rho_slope_b=there.slope,
        group=matches.group[index], kind=np.full(len(index), REFINED_KIND)), index


def sample_positions(endpoints_px: Array) -> Array:
    """(L, S, 2) positions evenly along segments (L, 2, 2), half a spacing from the ends."""
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    return (endpoints_px[:, None, 0] * (1 - t)[:, None] + endpoints_px[:, None, 1] * t[:, None])


def follow_segments(segments: Segments2D, group_a: Array, flow: FlowField, labels_a: Array,
                    group_b: Array, noise: NoiseConfig) -> tuple[LineMatches, Array]:
    """Segments of frame a where the flow carries them: a' = a + φ_a, b' = b + φ_b.

    The flow is read along the whole segment and fitted by a line, so that both endpoints have
    the flow of many pixels.

    Returns:
        the matches, and which segments they belong to (M,).
    """
    positions = sample_positions(segments.endpoints_px)
    flat = positions.reshape(-1, 2)
    flow_at, known = sample_flow(flow, flat, labels_a)
    there = flat + flow_at
    known &= inside(there, group_b.shape, 1.0)
    known &= nearest(group_b, there) == np.repeat(group_a, _SAMPLES)
    known = known.reshape(-1, _SAMPLES)
    index = np.flatnonzero((known.sum(axis=1) >= 0.75 * _SAMPLES)
                           & (segments.depth_m > 0).all(axis=1) & (group_a >= 0))
    endpoints_b, sigma = fit_endpoints(segments.endpoints_px[index],
                                       flow_at.reshape(-1, _SAMPLES, 2)[index],
                                       known[index].astype(np.float64))
    rho_a = inverse_depth(segments.depth_m[index])
    return LineMatches(
        endpoints_a=segments.endpoints_px[index], rho_a=rho_a,
        rho_sigma_a=np.full(rho_a.shape, noise.inverse_depth_sigma / 2.0),   # a fit of 16 depths
        endpoints_b=endpoints_b, flow_sigma=noise.flow_sigma_px * sigma,
        group=group_a[index]), index


def align_segments(lines: LineMatches, expected_b: Array, smooth_a: Array,
                   smooth_b: Array) -> tuple[LineMatches, Array]:
    """Segments aligned on the images across their direction.

    Args:
        expected_b: (L, 2, 2) where the motions found so far put the endpoints.
    Returns:
        the matches that converged, and which they are (M,).
    """
    refined = refine_segments(smooth_a, smooth_b, lines.endpoints_a, expected_b)
    index = np.flatnonzero(refined.converged)
    variance = np.einsum("lii->l", refined.covariance[index]) / 2.0
    return replace(taken(lines, index), endpoints_b=refined.endpoints_px[index],
                   flow_sigma=np.sqrt(variance)), index


def fit_endpoints(endpoints_px: Array, shift: Array, weight: Array) -> tuple[Array, Array]:
    """Endpoints moved by the straight line that fits shifts read along each segment.

    Args:
        endpoints_px: (L, 2, 2).
        shift: (L, S, 2) at `sample_positions`.
        weight: (L, S) inverse variances, 0 = unknown.
    Returns:
        endpoints (L, 2, 2), and the standard deviation (L,) of each end per axis for shifts of
        those variances.
    """
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    s0 = np.maximum(weight.sum(axis=1), 1e-12)
    mean_t = (weight * t).sum(axis=1) / s0
    s2 = np.maximum((weight * t * t).sum(axis=1) - s0 * mean_t**2, 1e-12)
    mean = np.einsum("ls,lsi->li", weight, shift) / s0[:, None]
    slope = np.einsum("ls,lsi->li", weight * (t - mean_t[:, None]), shift) / s2[:, None]
    ends_t = np.array([-0.5, 0.5])[None, :] - mean_t[:, None]
    moved = endpoints_px + mean[:, None] + ends_t[:, :, None] * slope[:, None]
    variance = 1.0 / s0 + np.mean(ends_t**2, axis=1) / s2
    return moved, np.sqrt(variance)


def match_segments(carried: Array, detected: Array, max_distance_px: float = 2.0,
                   min_overlap: float = 0.5) -> Array:
    """For each carried segment (C, 2, 2) the detected one (D, 2, 2) it lies on, or −1.

    Both ends of the carried segment lie near the detected line, and at least `min_overlap` of
    the shorter one's length is shared. Each detected segment is given to one carried one.
    """
    best, distance = _nearest_line(np.ascontiguousarray(carried), np.ascontiguousarray(detected),
                                   max_distance_px, min_overlap)
    found = np.full(len(carried), -1)
    candidates = np.flatnonzero(best >= 0)
    order = candidates[np.argsort(distance[candidates], kind="stable")]
    _, first = np.unique(best[order], return_index=True)
    found[order[first]] = best[order[first]]
    return found


@numba.njit(cache=True)
def _nearest_line(carried, detected, max_distance, min_overlap):  # type: ignore[no-untyped-def]
    best = np.full(len(carried), -1)
    distance = np.full(len(carried), np.inf)
    for d in range(len(detected)):
        (u0, v0), (u1, v1) = detected[d]
        length = np.hypot(u1 - u0, v1 - v0)
        du, dv = (u1 - u0) / length, (v1 - v0) / length
        for c in range(len(carried)):
            au, av = carried[c, 0, 0] - u0, carried[c, 0, 1] - v0
            gap = abs(au * dv - av * du)
            if gap > max_distance:
                continue
            bu, bv = carried[c, 1, 0] - u0, carried[c, 1, 1] - v0
            gap = max(gap, abs(bu * dv - bv * du))
            if gap > max_distance or gap >= distance[c]:
                continue
            s, t = au * du + av * dv, bu * du + bv * dv
            low, high = min(s, t), max(s, t)
            shared = min(high, length) - max(low, 0.0)
            if shared >= min_overlap * min(high - low, length):
                best[c], distance[c] = d, gap
    return best, distance
