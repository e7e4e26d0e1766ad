"""Lucas–Kanade alignment of one patch after another, compiled.

Inverse compositional (Baker & Matthews 2004): gradients and normal matrix come from the template
once; an iteration cuts out the moved patch and takes three dot products. Each patch is aligned
for itself, so that halves of them run on two threads with equal results.

Symmetric 2×2 matrices are three numbers: uu, uv, vv.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numba
import numpy as np

from slam.frontend.patches import cut_patch, cut_patch_and_slopes, patch_fits
from slam.frontend.support import SAME_SURFACE
from slam.geometry.arrays import Array

_STIFF = 1e8          # (grey/px)²: in such a direction nothing moves
_FLOOR = 1e-3         # (grey/px)²: keeps flat patches solvable
_WORTH_A_THREAD = 64  # patches


class Steps(NamedTuple):
    """What the iterations are told."""

    radius: int
    iterations: int
    without_ramps: bool
    noise_floor: float    # grey²
    prior: float          # what the prior adds to the normal matrix, for each grey² of noise
    prior_sigma: float    # px
    stop_px: float
    stop_sigmas: float
    max_step_px: float


class Alignment(NamedTuple):
    """What the iterations give."""

    uv: Array            # (N, 2)
    correlation: Array   # (N,)
    residual: Array      # (N,) grey levels
    ended: Array         # (N,) bool: the steps became small
    share: Array         # (N,) of the window that lies on the centre's surface
    normal: Array        # (N, 3): Σ w g gᵀ, g the gradient
    spread: Array        # (N, 3): Σ w² g gᵀ, by which noise enters


def align_patches(previous: Array, current: Array, uv_previous: Array, start: Array, A: Array,
                  surface: Array, direction: Array, window: Array, steps: Steps) -> Alignment:
    """Align patches that fit into the previous image.

    Args:
        previous, current: (H, W) float32 from `spline_image`.
        uv_previous, start: (N, 2).
        A: (N, 2, 2) warps.
        surface: (H, W) from `surface_image`, or (0, 0): all pixels of a patch count.
        direction: (N, 2) unit vectors along which alone the patches move, or (0, 2): freely.
        window: (P,) float32 weights that sum to 1.
    """
    n = len(start)
    out = Alignment(start.copy(), np.zeros(n), np.full(n, np.inf), np.zeros(n, np.bool_),
                    np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)))
    arguments = (previous, current, uv_previous, A, surface, direction, window, steps, out)
    half = n // 2 if n >= _WORTH_A_THREAD else n
    with ThreadPoolExecutor(1) as beside:
        other = beside.submit(_align, half, n, *arguments) if half < n else None
        _align(0, half, *arguments)
        if other is not None:
            other.result()
    return out


@numba.njit(cache=True, nogil=True)
def _align(first, last, previous, current, uv_previous, A, surface,  # type: ignore[no-untyped-def]
           direction, window, steps, out):
    side = 2 * steps.radius + 1
    # Gradient in u and v and template, then the filters w g and w T.
    basis, taps = np.empty((3, side * side), np.float32), np.empty((3, side * side), np.float32)
    weights, edges = np.empty(side * side, np.float32), np.empty(side * side, np.float32)
    room = np.empty((2, side, side + 3), np.float32)
    patch = np.empty(side * side, np.float32)
    # u and v of each pixel, then weighted.
    ramps = np.empty((4, side * side if steps.without_ramps else 0), np.float32)
    normal, spread = np.empty(3), np.empty(3)
    for n in range(first, last):
        out.share[n] = _weigh(surface, uv_previous[n], window, steps.radius, weights)
        _ramp(weights, steps.radius, ramps)
        cut_patch_and_slopes(previous, uv_previous[n], steps.radius, room, basis)
        _warp(basis, A[n], steps.radius)
        energy = _prepare(basis, taps, weights, edges, ramps, normal, spread)
        if len(direction) > 0:
            _constrain(taps, normal, spread, direction[n])
        for k in range(3):
            out.normal[n, k], out.spread[n, k] = normal[k], spread[k]
        _iterate(current, n, basis[2], taps, weights, edges, ramps, normal, energy, patch, room,
                 steps, out)


@numba.njit(cache=True, nogil=True)
def _weigh(surface, uv, window, radius, weights):  # type: ignore[no-untyped-def]
    """The window on the centre's surface, made to sum to 1; the share of it that is there."""
    if surface.size == 0:
        weights[:] = window
        return 1.0
    row, column = int(np.rint(uv[1])), int(np.rint(uv[0]))
    middle, side = surface[row, column], 2 * radius + 1
    share = np.float32(0.0)
    for i in range(side):
        for j in range(side):
            p = i * side + j
            there = surface[row - radius + i, column - radius + j]
            # Not true of NaN, which marks the pixels beside a step.
            weights[p] = window[p] if abs(there - middle) <= SAME_SURFACE else np.float32(0.0)
            share += weights[p]
    weights /= max(share, np.float32(1e-6))
    return float(share)


@numba.njit(cache=True, nogil=True)
def _warp(basis, A, radius):  # type: ignore[no-untyped-def]
    """Turn gradient and template into what the current image shows under A, to first order."""
    det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    a, b = np.float32(A[1, 1] / det), np.float32(-A[0, 1] / det)     # A⁻¹ = [[a, b], [c, d]]
    c, d = np.float32(-A[1, 0] / det), np.float32(A[0, 0] / det)
    side = 2 * radius + 1
    for i in range(side):
        v = np.float32(i - radius)
        for j in range(side):
            u, p = np.float32(j - radius), i * side + j
            gu, gv = basis[0, p], basis[1, p]
            basis[2, p] += gu * (a * u + b * v - u) + gv * (c * u + d * v - v)
            basis[0, p], basis[1, p] = a * gu + c * gv, b * gu + d * gv


@numba.njit(cache=True, nogil=True)
def _prepare(basis, taps, weights, edges, ramps, normal, spread):  # type: ignore[no-untyped-def]
    """Make the filters of a template; its energy Σ w T².

    The mean is taken off here, and the template's share off the gradients: so the dot products
    with a patch are blind to its brightness and contrast.
    """
    for k in range(3):
        _take_mean_off(basis[k], weights)
        _take_ramps_off(basis[k], ramps)
    for p in range(len(weights)):
        taps[2, p] = weights[p] * basis[2, p]
    energy = max(_dot(taps[2], basis[2]), np.float32(1e-6))
    for k in range(2):
        share = _dot(taps[2], basis[k]) / energy
        for p in range(len(weights)):
            basis[k, p] -= share * basis[2, p]
            taps[k, p] = weights[p] * basis[k, p]
    normal[0], normal[1], normal[2] = (_dot(taps[0], basis[0]), _dot(taps[0], basis[1]),
                                       _dot(taps[1], basis[1]))
    spread[0], spread[1], spread[2] = (_dot(taps[0], taps[0]), _dot(taps[0], taps[1]),
                                       _dot(taps[1], taps[1]))
    # w² gᵀg, summing to 1: where noise hurts.
    size = np.float32(max(spread[0] + spread[2], 1e-9))
    for p in range(len(weights)):
        edges[p] = (taps[0, p] * taps[0, p] + taps[1, p] * taps[1, p]) / size
    return float(energy)


@numba.njit(cache=True, nogil=True)
def _constrain(taps, normal, spread, direction):  # type: ignore[no-untyped-def]
    """Let steps go along a unit direction only."""
    u, v = np.float32(direction[0]), np.float32(direction[1])
    for p in range(taps.shape[1]):
        along = u * taps[0, p] + v * taps[1, p]
        taps[0, p], taps[1, p] = u * along, v * along
    x, y = direction[0], direction[1]
    inside = normal[0] * x * x + 2.0 * normal[1] * x * y + normal[2] * y * y
    normal[0], normal[1], normal[2] = (x * x * inside + y * y * _STIFF, x * y * (inside - _STIFF),
                                       y * y * inside + x * x * _STIFF)
    inside = spread[0] * x * x + 2.0 * spread[1] * x * y + spread[2] * y * y
    spread[0], spread[1], spread[2] = x * x * inside, x * y * inside, y * y * inside


@numba.njit(cache=True, nogil=True)
def _iterate(current, n, template, taps, weights, edges, ramps,  # type: ignore[no-untyped-def]
             normal, energy, patch, room, steps, out):
    start_u, start_v = out.uv[n, 0], out.uv[n, 1]
    for _ in range(steps.iterations):
        if not patch_fits(out.uv[n], current.shape, steps.radius):
            out.ended[n] = False
            return
        cut_patch(current, out.uv[n], steps.radius, room, patch)
        _take_mean_off(patch, weights)
        _take_ramps_off(patch, ramps)
        common = float(_dot(taps[2], patch))
        gain = min(max(common / energy, 0.3), 3.0)
        right_u, right_v = _dot(taps[0], patch) / gain, _dot(taps[1], patch) / gain
        difference, on_edges = _difference(patch, np.float32(gain), template, weights, edges)
        # What is left of the difference once the best step is made is noise; misfit is not.
        u, v = _solve(normal[0] + _FLOOR, normal[1], normal[2] + _FLOOR, right_u, right_v)
        noise = max(difference - gain * gain * (right_u * u + right_v * v), steps.noise_floor)
        noise *= max(on_edges / max(difference, 1e-9), 1.0) / (gain * gain)
        variance = difference + gain * (2.0 * common - gain * energy)        # of the patch
        out.correlation[n] = common / np.sqrt(energy * max(variance, 1e-6))
        out.residual[n] = np.sqrt(noise)
        prior = steps.prior * noise
        uu, uv, vv = normal[0] + prior, normal[1], normal[2] + prior
        u, v = _solve(uu, uv, vv, right_u + prior * (out.uv[n, 0] - start_u),
                      right_v + prior * (out.uv[n, 1] - start_v))
        length = np.sqrt(u * u + v * v)
        squared = max(uu * u * u + 2.0 * uv * u * v + vv * v * v, 0.0)       # rounding
        in_sigmas = np.sqrt(squared / prior) / steps.prior_sigma
        size = min(length / steps.stop_px, in_sigmas / steps.stop_sigmas)
        shrink = min(1.0, steps.max_step_px / max(length, 1e-12))
        out.uv[n, 0] -= u * shrink
        out.uv[n, 1] -= v * shrink
        out.ended[n] = size < 2.0
        if not size >= 1.0:
            return


@numba.njit(cache=True, nogil=True)
def _difference(patch, gain, template, weights, edges):  # type: ignore[no-untyped-def]
    """Mean square of patch minus scaled template: over the window, and on its gradients.

    Noise is everywhere; shadows, aliased edges and other surfaces differ just where edges are,
    where it hurts. The patch is used up: it holds the squares.
    """
    for p in range(len(patch)):
        gap = patch[p] - gain * template[p]
        patch[p] = gap * gap
    return float(_dot(weights, patch)), float(_dot(edges, patch))


@numba.njit(cache=True, nogil=True, inline="always")
def _solve(uu, uv, vv, right_u, right_v):  # type: ignore[no-untyped-def]
    determinant = max(uu * vv - uv * uv, 1e-12)
    return ((vv * right_u - uv * right_v) / determinant,
            (uu * right_v - uv * right_u) / determinant)


@numba.njit(cache=True, nogil=True)
def _dot(a, b):  # type: ignore[no-untyped-def]
    """Dot product in eight lanes that are added in one order, whatever a compiler makes of it.

    A compiler allowed to choose the order chooses another one when code comes from its cache.
    """
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = np.float32(0.0)
    whole = len(a) // 8 * 8
    for p in range(0, whole, 8):
        s0 += a[p] * b[p]
        s1 += a[p + 1] * b[p + 1]
        s2 += a[p + 2] * b[p + 2]
        s3 += a[p + 3] * b[p + 3]
        s4 += a[p + 4] * b[p + 4]
        s5 += a[p + 5] * b[p + 5]
        s6 += a[p + 6] * b[p + 6]
        s7 += a[p + 7] * b[p + 7]
    for p in range(whole, len(a)):
        s0 += a[p] * b[p]
    return ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7))


@numba.njit(cache=True, nogil=True)
def _take_mean_off(values, weights):  # type: ignore[no-untyped-def]
    mean = _dot(weights, values)
    for p in range(len(values)):
        values[p] -= mean


@numba.njit(cache=True, nogil=True)
def _ramp(weights, radius, ramps):  # type: ignore[no-untyped-def]
    """Fill u and v of a patch's pixels (4, P), and both times their weights; (4, 0): not wanted."""
    side = 2 * radius + 1 if ramps.shape[1] > 0 else 0
    for i in range(side):
        for j in range(side):
            p = i * side + j
            ramps[0, p], ramps[1, p] = np.float32(j - radius), np.float32(i - radius)
            ramps[2, p], ramps[3, p] = weights[p] * ramps[0, p], weights[p] * ramps[1, p]


@numba.njit(cache=True, nogil=True)
def _take_ramps_off(values, ramps):  # type: ignore[no-untyped-def]
    """Take off what is linear in u, then in v, where `ramps` are wanted.

    A lamp that moves with the camera, or a surface that shines, changes a patch's brightness by
    a ramp above all, which would pass for a shift.
    """
    if ramps.shape[1] == 0:
        return
    for axis in range(2):
        ramp, weighted = ramps[axis], ramps[2 + axis]
        slope = _dot(weighted, values) / max(_dot(weighted, ramp), np.float32(1e-6))
        for p in range(len(values)):
            values[p] -= slope * ramp[p]
