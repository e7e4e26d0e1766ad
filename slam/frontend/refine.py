"""Sub-pixel refinement of correspondences: Lucas–Kanade with gates and covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.frontend.alignment import Steps, align_patches
from slam.frontend.patches import fits, spline_image
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
    found = align_patches(
        previous, current, np.asarray(uv_previous, np.float64)[index], start[index],
        np.tile(np.eye(2), (len(index), 1, 1)) if A is None else np.asarray(A, np.float64)[index],
        np.zeros((0, 0), np.float32) if surface is None else surface,
        np.zeros((0, 2)) if direction is None else np.asarray(direction, np.float64)[index],
        _window(config), _steps(config))
    good = (found.ended & (found.share >= config.min_support)
            & (found.correlation >= config.min_correlation)
            & (np.linalg.norm(found.uv - start[index], axis=-1) <= config.max_move_px))
    if good.any():
        chosen = index[good]
        converged[chosen] = True
        uv[chosen] = found.uv[good]
        residual[chosen] = found.residual[good]
        covariance[chosen] = _covariance(found.normal[good], found.spread[good],
                                         found.residual[good], config)
    return RefinedMatches(uv, covariance, converged, residual)


def _window(config: RefineConfig) -> Array:
    """(P,) float32 Gaussian weights that sum to 1."""
    offset = np.arange(-config.radius_px, config.radius_px + 1)
    line = np.exp(-0.5 * (offset / config.window_sigma_px) ** 2)
    weight = np.outer(line, line).reshape(-1)
    return np.asarray(weight / weight.sum(), dtype=np.float32)


def _steps(config: RefineConfig) -> Steps:
    return Steps(config.radius_px, config.iterations, config.without_ramps,
                 config.noise_floor_grey**2, _prior_per_noise(config), config.prior_sigma_px,
                 config.stop_px, config.stop_sigmas, config.max_step_px)


def _prior_per_noise(config: RefineConfig) -> float:
    """What the prior adds to the diagonal of the normal matrix for each grey² of noise.

    The window's weights sum to 1, so the noise of the matrix's right-hand side is smaller than a
    patch difference's by Σ w².
    """
    window = _window(config)
    return _noise_gain(config) * float(window @ window) / config.prior_sigma_px**2


def _noise_gain(config: RefineConfig) -> float:
    """Variance that neighbouring pixels' shared noise adds: blurred noise on a blurred gradient.

    About 2.5πσ², found with white noise on several textures: the sum of the noise's
    autocorrelation exp(−d²/4σ²) is 4πσ², and the gradient is alike only nearby.
    """
    return max(1.0, 2.5 * np.pi * config.blur_sigma_px ** 2)


def _covariance(normal: Array, spread: Array, residual: Array, config: RefineConfig) -> Array:
    """(N, 2, 2) of positions: what noise and a wrong prior do to them."""
    # Half a patch's own noise, which is a rough estimate, and half that of most patches.
    noise = 0.5 * (residual**2 + np.median(residual) ** 2)
    prior = _prior_per_noise(config) * noise
    n_uu, n_uv, n_vv = normal[:, 0] + prior, normal[:, 1], normal[:, 2] + prior
    gain, held = _noise_gain(config) * noise, (prior * config.prior_sigma_px) ** 2
    s_uu, s_uv, s_vv = gain * spread[:, 0] + held, gain * spread[:, 1], gain * spread[:, 2] + held
    # N⁻¹ S N⁻¹, element by element: NumPy's own 2×2 products take ten times as long.
    a, b, c = n_vv, -n_uv, n_uu                        # the adjugate of N
    a_s, b_s = a * s_uu + b * s_uv, a * s_uv + b * s_vv
    c_s, d_s = b * s_uu + c * s_uv, b * s_uv + c * s_vv
    out = np.empty((len(noise), 2, 2))
    out[:, 0, 0] = a_s * a + b_s * b
    out[:, 0, 1] = out[:, 1, 0] = a_s * b + b_s * c
    out[:, 1, 1] = c_s * b + d_s * c
    out /= ((n_uu * n_vv - n_uv * n_uv) ** 2)[:, None, None]
    return out
