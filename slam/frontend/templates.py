"""Templates of patches: what alignment needs of the previous image, computed once.

Gradients, normal matrices and filters of all patches, with the feature on the last axis so that
every array operation runs along all features.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.frontend.patches import extract_patches_and_slopes
from slam.geometry.arrays import Array

@dataclass(frozen=True, slots=True)
class _Filters:
    """What the templates contribute, the same in all iterations; features on the last axis."""

    weights: Array       # (P, N) float32: sum to 1 over a patch
    template: Array      # (P, N) float32: without its mean
    taps: Array          # (3, P, N) float32: weighted gradients in u and v, weighted template
    normal: Array        # (3, N): Σ w g gᵀ as uu, uv, vv
    spread: Array        # (3, N): Σ w² g gᵀ, by which noise enters
    energy: Array        # (N,): Σ w T²

    def of(self, chosen: Array) -> _Filters:
        """Those of some patches only."""
        return _Filters(*(getattr(self, each)[..., chosen] for each in self.__slots__))


def _window(config: RefineConfig) -> Array:
    """(P,) float32 Gaussian weights that sum to 1."""
    offset = np.arange(-config.radius_px, config.radius_px + 1)
    line = np.exp(-0.5 * (offset / config.window_sigma_px) ** 2)
    weight = np.outer(line, line).reshape(-1)
    return np.asarray(weight / weight.sum(), dtype=np.float32)


def _filters(previous: Array, uv_previous: Array, weights: Array, A: Array | None,
             config: RefineConfig) -> _Filters:
    """Templates, their gradients and everything that follows from them alone."""
    count = len(uv_previous)
    basis = extract_patches_and_slopes(previous, uv_previous, config.radius_px)
    basis = basis.reshape(3, -1, count)                   # gradient in u and v, template
    if A is not None:
        _warp(basis, A, config)
    # With the mean taken off here, and the template's share off the gradients, the dot products
    # with a patch are blind to its brightness and contrast.
    for k in range(3):
        basis[k] -= _dot(weights, basis[k])
    taps = basis * weights
    energy = np.maximum(_dot(taps[2], basis[2]), np.float32(1e-6))
    for k in range(2):
        share = _dot(taps[2], basis[k]) / energy
        basis[k] -= share * basis[2]
        np.multiply(basis[k], weights, out=taps[k])
    pairs = ((0, 0), (0, 1), (1, 1))
    normal = np.stack([_dot(taps[i], basis[j]) for i, j in pairs])
    spread = np.stack([_dot(taps[i], taps[j]) for i, j in pairs])
    return _Filters(weights, basis[2], taps, normal.astype(np.float64), spread.astype(np.float64),
                    energy.astype(np.float64))


def _constrained(filters: _Filters, direction: Array) -> _Filters:
    """Filters whose steps go along (N, 2) directions only."""
    n = direction.T.astype(np.float32)
    taps = filters.taps.copy()
    along = n[0] * taps[0] + n[1] * taps[1]
    taps[0], taps[1] = n[0] * along, n[1] * along

    def projected(upper: Array, across: float) -> Array:
        uu, uv, vv = n[0] * n[0], n[0] * n[1], n[1] * n[1]
        share = uu * upper[0] + 2 * uv * upper[1] + vv * upper[2]
        return np.stack([share * uu + across * vv, (share - across) * uv, share * vv + across * uu])

    return _Filters(filters.weights, filters.template, taps,
                    projected(filters.normal, _STIFF), projected(filters.spread, 0.0),
                    filters.energy)


_STIFF = 1e8   # (grey/px)²: in this direction nothing moves


def _dot(a: Array, b: Array) -> Array:
    """(N,) dot products of the columns of (P, N) and (P, N)."""
    return np.asarray(np.einsum("pn,pn->n", a, b))


def _warp(basis: Array, A: Array, config: RefineConfig) -> None:
    """Turn gradient and template into what the current image shows under A, to first order."""
    offset = np.arange(-config.radius_px, config.radius_px + 1, dtype=np.float32)
    v, u = (axis.reshape(-1, 1) for axis in np.meshgrid(offset, offset, indexing="ij"))
    inverse = _inverse(np.moveaxis(A, 0, -1)).astype(np.float32)            # (2, 2, N)
    for k in range(2):
        back = inverse[k, 0] * u + inverse[k, 1] * v                        # previous offset
        basis[2] += basis[k] * (back - (u, v)[k])
    in_u = inverse[0, 0] * basis[0] + inverse[1, 0] * basis[1]
    basis[1] = inverse[0, 1] * basis[0] + inverse[1, 1] * basis[1]
    basis[0] = in_u


def _inverse(matrix: Array) -> Array:
    """Inverses of well-conditioned 2×2 matrices (2, 2, N)."""
    (a, b), (c, d) = matrix
    return np.array([[d, -b], [-c, a]]) / (a * d - b * c)
