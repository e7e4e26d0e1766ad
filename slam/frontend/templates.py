"""Templates of patches: what alignment needs of the previous image, computed once.

The feature is the last axis, so that every array operation runs along all features.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.frontend import symmetric
from slam.frontend.patches import extract_patches_and_slopes
from slam.geometry.arrays import Array

_STIFF = 1e8   # (grey/px)²: in such a direction nothing moves


@dataclass(frozen=True, slots=True)
class Templates:
    """N templates of P pixels with their Gauss–Newton filters; g is the gradient."""

    weights: Array       # (P, N) float32: sum to 1 over a patch
    template: Array      # (P, N) float32: T without its mean
    taps: Array          # (3, P, N) float32: w g in u and v, w T
    edges: Array         # (P, N) float32: w² g gᵀ's trace, summing to 1: where noise hurts
    normal: Array        # (3, N): Σ w g gᵀ
    spread: Array        # (3, N): Σ w² g gᵀ, by which noise enters
    energy: Array        # (N,): Σ w T²

    def of(self, chosen: Array) -> Templates:
        """Those of some patches only."""
        return Templates(*(getattr(self, name)[..., chosen] for name in self.__slots__))


def make_templates(spline: Array, uv_px: Array, weights: Array, A: Array | None,
                   radius: int, without_ramps: bool = False) -> Templates:
    """Templates around positions (N, 2), weighted by (P, N), as they look under warps (N, 2, 2).

    Args:
        without_ramps: make alignment blind to linear changes of brightness over a patch.
    """
    basis = extract_patches_and_slopes(spline, uv_px, radius)
    basis = basis.reshape(3, -1, len(uv_px))              # gradient in u and v, template
    if A is not None:
        _warp(basis, A, radius)
    # With the mean taken off here, and the template's share off the gradients, the dot products
    # with a patch are blind to its brightness and contrast.
    for k in range(3):
        basis[k] -= dot(weights, basis[k])
    if without_ramps:
        take_ramps_off(basis, weights, radius)
    taps = basis * weights
    energy = np.maximum(dot(taps[2], basis[2]), np.float32(1e-6))
    for k in range(2):
        share = dot(taps[2], basis[k]) / energy
        basis[k] -= share * basis[2]
        np.multiply(basis[k], weights, out=taps[k])
    pairs = ((0, 0), (0, 1), (1, 1))
    normal = np.stack([dot(taps[i], basis[j]) for i, j in pairs]).astype(np.float64)
    spread = np.stack([dot(taps[i], taps[j]) for i, j in pairs]).astype(np.float64)
    edges = taps[0] * taps[0]
    edges += taps[1] * taps[1]
    edges /= np.maximum(spread[0] + spread[2], 1e-9).astype(np.float32)
    return Templates(weights, basis[2], taps, edges, normal, spread, energy.astype(np.float64))


def constrained(templates: Templates, direction: Array) -> Templates:
    """Templates whose steps go along (N, 2) unit directions only."""
    n = direction.T.astype(np.float32)
    along = n[0] * templates.taps[0] + n[1] * templates.taps[1]
    taps = np.stack([n[0] * along, n[1] * along, templates.taps[2]])
    on = np.stack([n[0] * n[0], n[0] * n[1], n[1] * n[1]])
    off = np.stack([on[2], -on[1], on[0]])
    normal = on * symmetric.quadratic(templates.normal, n) + off * _STIFF
    spread = on * symmetric.quadratic(templates.spread, n)
    return Templates(templates.weights, templates.template, taps, templates.edges, normal, spread,
                     templates.energy)


def dot(a: Array, b: Array) -> Array:
    """(N,) dot products of the columns of (P, N) and (P, N)."""
    return np.asarray(np.einsum("pn,pn->n", a, b))


def take_ramps_off(patches: Array, weights: Array, radius: int) -> None:
    """Take off patches (..., P, N), without a mean, what is linear in u and in v.

    A lamp that moves with the camera, or a surface that shines, changes a patch's brightness by
    a ramp above all, which would pass for a shift.
    """
    offset = np.arange(-radius, radius + 1, dtype=np.float32)
    v, u = (axis.reshape(-1, 1) for axis in np.meshgrid(offset, offset, indexing="ij"))
    for ramp in (u, v):
        weighted = weights * ramp
        size = np.maximum(dot(weighted, np.broadcast_to(ramp, weighted.shape)), np.float32(1e-6))
        flat = patches.reshape(-1, *weighted.shape)
        for k in range(len(flat)):
            flat[k] -= (dot(weighted, flat[k]) / size) * ramp


def _warp(basis: Array, A: Array, radius: int) -> None:
    """Turn gradient and template into what the current image shows under A, to first order."""
    offset = np.arange(-radius, radius + 1, dtype=np.float32)
    v, u = (axis.reshape(-1, 1) for axis in np.meshgrid(offset, offset, indexing="ij"))
    inverse = symmetric.inverse(np.moveaxis(A, 0, -1)).astype(np.float32)   # (2, 2, N)
    for k in range(2):
        back = inverse[k, 0] * u + inverse[k, 1] * v                        # previous offset
        basis[2] += basis[k] * (back - (u, v)[k])
    in_u = inverse[0, 0] * basis[0] + inverse[1, 0] * basis[1]
    basis[1] = inverse[0, 1] * basis[0] + inverse[1, 1] * basis[1]
    basis[0] = in_u
