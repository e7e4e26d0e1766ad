"""Sub-pixel refinement of matched segments across their direction.

Patches along a segment are aligned like points; of each only the move across the line counts
(along it the aperture problem rules), and a robust straight fit gives the ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from slam.frontend.refine import RefineConfig, RefinedMatches, refine_matches
from slam.geometry.arrays import Array, freeze_fields


@dataclass(frozen=True, slots=True)
class LineRefineConfig:
    """How a segment is sampled and fitted."""

    samples: int = 8
    patch: RefineConfig = field(default_factory=lambda: RefineConfig(radius_px=3,
                                                                     window_sigma_px=2.0))
    huber_sigmas: float = 1.5         # residuals beyond count linearly
    converged_share: float = 0.6      # of the samples must align
    end_margin_px: float = 3.0        # samples keep off the ends, where other edges meet


@dataclass(frozen=True, slots=True)
class RefinedSegments:
    """Segments after refinement; those not converged keep their initial ends."""

    endpoints_px: Array  # (N, 2, 2) in the current image
    covariance: Array    # (N, 2, 2) px²: of the two ends' offsets across the line
    converged: Array     # (N,) bool

    def __post_init__(self) -> None:
        freeze_fields(self, endpoints_px=("N", 2, 2), covariance=("N", 2, 2), converged=("N",))


def refine_segments(previous: Array, current: Array, endpoints_previous: Array,
                    endpoints_initial: Array,
                    config: LineRefineConfig | None = None) -> RefinedSegments:
    """Move matched segments across their direction to where the images agree best.

    Args:
        previous, current: (H, W) float32 from `refine.prepare_image` with `config.patch`.
        endpoints_previous: (N, 2, 2).
        endpoints_initial: (N, 2, 2) in the current image, within 1–2 px.
    """
    config = LineRefineConfig() if config is None else config
    before = np.asarray(endpoints_previous, dtype=np.float64)
    after = np.asarray(endpoints_initial, dtype=np.float64)
    along = after[:, 1] - after[:, 0]
    length = np.maximum(np.linalg.norm(along, axis=-1), 1e-6)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=-1) / length[:, None]
    t = _parameters(length, config)                                         # (N, K)
    start = _along(after, t)
    matches = refine_matches(previous, current, _along(before, t).reshape(-1, 2),
                             start.reshape(-1, 2), config.patch,
                             direction=np.repeat(normal, config.samples, axis=0))
    return fitted_segments(after, t, start, normal, matches, config)


def fitted_segments(ends: Array, t: Array, start: Array, normal: Array, matches: RefinedMatches,
                    config: LineRefineConfig) -> RefinedSegments:
    """Segments moved across their direction by what patches along them have found.

    Args:
        ends: (N, 2, 2) where they were expected, start: (N, K, 2) patches on them there,
            t: (N, K) positions of those, 0 at the first end and 1 at the second.
        normal: (N, 2) unit vectors across them.
        matches: of the N K patches, moved along the normals.
    """
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
    move = matches.uv_current.reshape(start.shape) - start
    offset = np.einsum("nkc,nc->nk", move, normal)
    spread = np.einsum("ni,nkij,nj->nk", normal,
                       matches.covariance.reshape(*start.shape, 2), normal)
    aligned = matches.converged.reshape(t.shape)
    # Patches that overlap see the same pixels: their information counts by their share.
    spacing = length * (t[:, -1] - t[:, 0]) / max(config.samples - 1, 1)
    own = np.minimum(1.0, spacing / (np.sqrt(4 * np.pi) * config.patch.window_sigma_px))
    at_ends, covariance = _fit(t, offset, aligned * own[:, None] / np.maximum(spread, 1e-8), config)
    converged = aligned.mean(axis=-1) >= config.converged_share
    prior = config.patch.prior_sigma_px ** 2 * np.eye(2)
    moved = ends + at_ends[..., None] * normal[:, None]
    return RefinedSegments(np.where(converged[:, None, None], moved, ends),
                           np.where(converged[:, None, None], covariance, prior), converged)


def _parameters(length: Array, config: LineRefineConfig) -> Array:
    """(N, K) positions along the segments, 0 at the start and 1 at the end."""
    margin = np.minimum(config.end_margin_px / length, 0.25)[:, None]
    return np.asarray(margin + (1.0 - 2.0 * margin) * np.linspace(0.0, 1.0, config.samples))


def _along(endpoints_px: Array, t: Array) -> Array:
    """(N, K, 2) points of segments (N, 2, 2) at t (N, K)."""
    start, end = endpoints_px[:, None, 0], endpoints_px[:, None, 1]
    return np.asarray(start + t[..., None] * (end - start))


def _fit(t: Array, offset: Array, information: Array,
         config: LineRefineConfig) -> tuple[Array, Array]:
    """Robust straight fit: offsets at both ends (N, 2) and their covariance (N, 2, 2).

    Args:
        t: (N, K) positions, offset: (N, K) px there, information: (N, K) 1/px², 0 = no sample.
    """
    basis = np.stack([1.0 - t, t], axis=-1)                                 # (N, K, 2)
    middle = _masked_median(offset, information > 0)
    ends = np.stack([middle, middle], axis=-1)
    # Held weakly to the median, so that a fit through too few samples stays solvable.
    hold = 1e-4 * np.eye(2)
    weight = information
    for _ in range(4):
        sigmas = np.abs(offset - np.einsum("nkc,nc->nk", basis, ends)) * np.sqrt(information)
        weight = information * np.minimum(1.0, config.huber_sigmas / np.maximum(sigmas, 1e-9))
        normal = np.einsum("nk,nki,nkj->nij", weight, basis, basis) + hold
        right = (np.einsum("nk,nki,nk->ni", weight, basis, offset)
                 + 1e-4 * middle[:, None])
        ends = np.linalg.solve(normal, right[..., None])[..., 0]
    squared = (offset - np.einsum("nkc,nc->nk", basis, ends)) ** 2 * weight
    freedom = np.maximum((information > 0).sum(axis=-1) - 2, 1)
    excess = np.maximum(1.0, squared.sum(axis=-1) / freedom)
    return ends, np.linalg.inv(normal) * excess[:, None, None]


def _masked_median(values: Array, mask: Array) -> Array:
    """Lower median (N,) over the masked of (N, K); 0 where there are none."""
    ordered = np.sort(np.where(mask, values, np.inf), axis=-1)
    middle = np.maximum(mask.sum(axis=-1) - 1, 0) // 2
    picked = np.take_along_axis(ordered, middle[..., None], -1)[..., 0]
    return np.where(mask.any(axis=-1), picked, 0.0)
