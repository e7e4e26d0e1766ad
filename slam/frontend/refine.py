"""Sub-pixel refinement of correspondences: batched Lucas–Kanade with covariances.

Inverse compositional (Baker & Matthews 2004): gradients and normal matrices come from the
template once; an iteration only cuts out the moved patches and takes three dot products.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam.frontend import symmetric
from slam.frontend.patches import extract_patches, fits, spline_image
from slam.frontend.support import patch_support
from slam.frontend.templates import Templates, constrained, dot, make_templates, take_ramps_off
from slam.geometry.arrays import Array, freeze_fields


@dataclass(frozen=True, slots=True)
class RefineConfig:
    """Patch alignment."""

    radius_px: int = 5                # 11×11 patches
    window_sigma_px: float = 3.0      # Gaussian weights over the patch
    blur_sigma_px: float = 0.7        # of both images: less interpolation bias and aliasing
    prior_sigma_px: float = 1.0       # how far the initial flow may be wrong, per axis
    iterations: int = 4
    stop_px: float = 0.08             # a smaller step is the last: it leaves 3 % of itself
    stop_sigmas: float = 0.2          # so is one that is small against what noise does
    max_move_px: float = 3.0          # farther from the initial position is a failure
    min_correlation: float = 0.8      # of template and patch, weighted, in [-1, 1]
    min_support: float = 0.3          # share of the window that lies on the centre's surface
    max_scale: float = 4.0            # of a warp's area; beyond it a patch is not alike
    max_step_px: float = 1.0          # of one iteration
    without_ramps: bool = False       # blind to lighting that changes over a patch, as in far views
    noise_floor_grey: float = 0.15    # σ of patch differences: rounding to 8 bits, blurred


@dataclass(frozen=True, slots=True)
class RefinedMatches:
    """Correspondences after refinement; those not converged keep their initial position."""

    uv_current: Array    # (N, 2) px
    covariance: Array    # (N, 2, 2) px²
    converged: Array     # (N,) bool
    residual: Array      # (N,) grey levels: σ of patch minus template; inf unconverged

    def __post_init__(self) -> None:
        freeze_fields(self, uv_current=("N", 2), covariance=("N", 2, 2), converged=("N",),
                      residual=("N",))


def prepare_image(gray: Array, config: RefineConfig | None = None) -> Array:
    """The (H, W) float32 image that refinement works on; call it once per image."""
    return spline_image(gray, (RefineConfig() if config is None else config).blur_sigma_px)


def refine_matches(previous: Array, current: Array, uv_previous: Array,
                   uv_current_initial: Array, config: RefineConfig | None = None,
                   A: Array | None = None, surface: Array | None = None,
                   direction: Array | None = None) -> RefinedMatches:
    """Move matched points to where their patches agree best.

    The prior holds each point to its initial position with `prior_sigma_px`, so a patch that is
    only an edge moves across the edge and keeps the initial flow, and its large variance, along.

    Args:
        previous, current: (H, W) float32 from `prepare_image`.
        uv_previous: (N, 2) positions in the previous image.
        uv_current_initial: (N, 2) positions in the current one, within 1–2 px.
        config: weights, iterations and gates.
        A: (N, 2, 2) local warps, offsets in the previous image to offsets in the current one;
            None: the patches only shift.
        surface: (H, W) of the previous frame from `support.surface_image`: then of a patch only the
            pixels count that lie on its centre's surface; None: all do.
        direction: (N, 2) unit vectors along which alone the points move, as across a line;
            perpendicular to it their covariance is 0. None: they move freely.
    """
    config = RefineConfig() if config is None else config
    start = np.asarray(uv_current_initial, dtype=np.float64)
    count = len(start)
    uv = start.copy()
    covariance = np.tile(np.eye(2) * config.prior_sigma_px ** 2, (count, 1, 1))
    converged = np.zeros(count, bool)
    residual = np.full(count, np.inf)
    usable = np.array(fits(uv_previous, previous.shape, config.radius_px)
                      & fits(start, current.shape, config.radius_px))
    if A is not None:
        usable &= np.abs(np.log(np.maximum(np.linalg.det(A), 1e-9))) < np.log(config.max_scale)
    index = np.flatnonzero(usable)
    if len(index) == 0:
        return RefinedMatches(uv, covariance, converged, residual)
    blocks = [_align(previous, current, uv_previous[i], start[i], None if A is None else A[i],
                     surface, None if direction is None else direction[i], config)
              for i in np.split(index, range(_BLOCK, len(index), _BLOCK))]
    found = _Alignment(*(np.concatenate(parts) for parts in zip(*blocks, strict=True)))
    good = (found.ended & (found.correlation >= config.min_correlation)
            & (np.linalg.norm(found.uv - start[index], axis=-1) <= config.max_move_px))
    if good.any():
        chosen = index[good]
        converged[chosen] = True
        uv[chosen] = found.uv[good]
        residual[chosen] = found.residual[good]
        covariance[chosen] = _covariance(found.normal[good].T, found.spread[good].T,
                                         found.residual[good], config)
    return RefinedMatches(uv, covariance, converged, residual)


_BLOCK = 512   # patches worked on at a time: their arrays stay in the processor's cache


class _Alignment(NamedTuple):
    """What the iterations give, features first."""

    uv: Array            # (N, 2)
    correlation: Array   # (N,)
    residual: Array      # (N,) grey levels
    ended: Array         # (N,) bool: the steps became small
    normal: Array        # (N, 3): as in Templates
    spread: Array        # (N, 3)


def _align(previous: Array, current: Array, uv_previous: Array, start: Array, A: Array | None,
           surface: Array | None, direction: Array | None, config: RefineConfig) -> _Alignment:
    """One block of patches."""
    window = _window(config)[:, None]
    if surface is None:
        weights = np.broadcast_to(window, (len(window), len(start)))
    else:
        weights = window * patch_support(surface, uv_previous, config.radius_px)
    share = weights.sum(axis=0)
    weights = weights / np.maximum(share, 1e-6)
    templates = make_templates(previous, uv_previous, weights, A, config.radius_px,
                               config.without_ramps)
    if direction is not None:
        templates = constrained(templates, direction)
    uv, correlation, residual, ended = _iterate(current, start, templates, config)
    return _Alignment(uv, correlation, residual, ended & (share >= config.min_support),
                      templates.normal.T, templates.spread.T)


def _window(config: RefineConfig) -> Array:
    """(P,) float32 Gaussian weights that sum to 1."""
    offset = np.arange(-config.radius_px, config.radius_px + 1)
    line = np.exp(-0.5 * (offset / config.window_sigma_px) ** 2)
    weight = np.outer(line, line).reshape(-1)
    return np.asarray(weight / weight.sum(), dtype=np.float32)


def _iterate(current: Array, start: Array, templates: Templates,
             config: RefineConfig) -> tuple[Array, Array, Array, Array]:
    """Positions (N, 2), correlations (N,), residuals (N,) and whether the steps ended (N,)."""
    uv = start.copy()
    count = len(uv)
    correlation, residual, ended = np.zeros(count), np.full(count, np.inf), np.zeros(count, bool)
    active = np.arange(count)
    for _ in range(config.iterations):
        active = active[fits(uv[active], current.shape, config.radius_px)]
        if len(active) == 0:
            break
        own = templates if len(active) == count else templates.of(active)
        patch = extract_patches(current, uv[active], config.radius_px)
        patch = patch.reshape(len(own.weights), -1)
        patch -= dot(own.weights, patch)
        if config.without_ramps:
            take_ramps_off(patch, own.weights, config.radius_px)
        dots = np.einsum("kpn,pn->kn", own.taps, patch).astype(np.float64)
        gain = np.clip(dots[2] / own.energy, 0.3, 3.0)
        right = dots[:2] / gain
        difference, on_edges = _difference(patch, gain, own)
        # What is left of the difference once the best step is made is noise; misfit is not.
        best = symmetric.solve(own.normal + _FLOOR, right)
        noise = np.maximum(difference - gain * gain * (right * best).sum(axis=0),
                           config.noise_floor_grey ** 2)
        noise *= np.maximum(on_edges / np.maximum(difference, 1e-9), 1.0) / gain ** 2
        variance = difference + gain * (2.0 * dots[2] - gain * own.energy)   # of the patch
        correlation[active] = dots[2] / np.sqrt(own.energy * np.maximum(variance, 1e-6))
        residual[active] = np.sqrt(noise)
        prior = _prior_weight(noise, config)
        held = own.normal + prior * symmetric.DIAGONAL
        step = symmetric.solve(held, right + prior * (uv[active] - start[active]).T)
        length = np.hypot(*step)
        squared = np.maximum(symmetric.quadratic(held, step), 0.0)   # rounding may go below
        in_sigmas = np.sqrt(squared / prior) / config.prior_sigma_px
        size = np.minimum(length / config.stop_px, in_sigmas / config.stop_sigmas)
        uv[active] -= (step * np.minimum(1.0, config.max_step_px / np.maximum(length, 1e-12))).T
        ended[active] = size < 2.0
        active = active[size >= 1.0]
    return uv, correlation, residual, ended


_FLOOR = 1e-3 * symmetric.DIAGONAL   # (grey/px)²: keeps flat patches solvable


def _difference(patch: Array, gain: Array, templates: Templates) -> tuple[Array, Array]:
    """Mean square (N,) of patch minus scaled template: over the window, and on its gradients.

    Noise is everywhere; shadows, aliased edges and other surfaces differ just where edges are,
    where it hurts.
    """
    squared = patch - gain.astype(np.float32) * templates.template
    squared *= squared
    return (dot(templates.weights, squared).astype(np.float64),
            dot(templates.edges, squared).astype(np.float64))


def _prior_weight(noise: Array, config: RefineConfig) -> Array:
    """What the prior adds to the diagonal of the normal matrix, (grey/px)².

    Args:
        noise: (N,) variance of a patch difference, grey². The window's weights sum to 1, so the
            noise of the matrix's right-hand side is smaller by Σ w².
    """
    window = _window(config)
    return np.asarray(_noise_gain(config) * float(window @ window) * noise
                      / config.prior_sigma_px ** 2)


def _noise_gain(config: RefineConfig) -> float:
    """Variance that neighbouring pixels' shared noise adds: blurred noise on a blurred gradient.

    About 2.5πσ², found with white noise on several textures: the sum of the noise's
    autocorrelation exp(−d²/4σ²) is 4πσ², and the gradient is alike only nearby.
    """
    return max(1.0, 2.5 * np.pi * config.blur_sigma_px ** 2)


def _covariance(normal: Array, spread: Array, residual: Array, config: RefineConfig) -> Array:
    """(N, 2, 2) of positions: what noise and a wrong prior do to them."""
    # Half a patch's own noise, which is a rough estimate, and half that of most patches.
    noise = 0.5 * (residual ** 2 + np.median(residual) ** 2)
    prior = _prior_weight(noise, config)
    inverse = symmetric.inverse(symmetric.full(normal + prior * symmetric.DIAGONAL))
    inside = symmetric.full(_noise_gain(config) * noise * spread
                            + prior ** 2 * config.prior_sigma_px ** 2 * symmetric.DIAGONAL)
    return np.asarray(np.einsum("ijn,jkn,kln->nil", inverse, inside, inverse))
