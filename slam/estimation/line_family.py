"""Segments in the solver, with the flows and inverse depths of their ends eliminated.

A segment's two flows and two inverse depths touch its own residual only. Eliminated, they leave
its two distances with the covariance

    S = J_φ Σ_φ J_φᵀ + Σ_l + J_ρ Σ_ρ J_ρᵀ          (2×2)

and minimising Σ ‖r‖²_S over the pose has the minimum of eq. (3) over pose, flows and depths.
"""

from __future__ import annotations

import numba
import numpy as np

from slam.config import MotionConfig
from slam.estimation.kernel import robust
from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.matches import LineMatches
from slam.residuals import LineTerms, camera_tuple, is_pixel, line_row, line_terms
from slam.types import Intrinsics


class LineFamily:
    """The line family: residuals, noise, and its eliminated variables."""

    def __init__(self, m: LineMatches, camera: Intrinsics, config: MotionConfig) -> None:
        self.m, self.camera, self.config = m, camera, config
        self.rays = pinhole.rays(camera, m.endpoints_a)
        self.whitening = np.zeros((len(m), 2, 2))
        self.depth_scale2: Array = np.ones(len(m))
        self.flow_scale2 = 1.0

    def renew(self, T: Array) -> None:
        """Recompute the covariance S at T."""
        t = self._terms(T)
        self.whitening = _whitening_of_lines(
            t.J_flow, t.J_rho, self.flow_scale2 * self.m.flow_sigma**2,
            self.m.rho_sigma_a**2 * self.depth_scale2[:, None], self.config.line_sigma_px**2)

    def marginal(self, T: Array) -> tuple[Array, Array, Array]:
        """Distances (L, 2) at T, their variances (L, 2) by the flow as stated, and by the rest."""
        t, m = self._terms(T), self.m
        flow = m.flow_sigma[:, None] ** 2 * np.sum(t.J_flow**2, axis=2)
        depth = m.rho_sigma_a**2 * self.depth_scale2[:, None] * np.sum(t.J_rho**2, axis=2)
        return t.r, flow, depth + self.config.line_sigma_px**2

    def _terms(self, T: Array) -> LineTerms:
        return line_terms(T, self.rays, self.m.rho_a, self.m.endpoints_b, self.camera,
                          self.config.line_normalisation, self.m.group)

    def refined_endpoints_b(self, T: Array) -> Array:
        """(L, 2, 2) a + φ_a, b + φ_b with φ = φ̂ − Σ_φ J_φᵀ S⁻¹ e_l: the flows of eq. (3)."""
        if not self.config.optimise_flow:
            return np.array(self.m.endpoints_b)
        t = self._terms(T)
        pull = np.swapaxes(self.whitening, 1, 2) @ (self.whitening @ t.r[:, :, None])
        variance = self.flow_scale2 * self.m.flow_sigma[:, None] ** 2
        moved = variance * np.einsum("lij,li->lj", t.J_flow, pull[:, :, 0])
        return np.asarray(self.m.endpoints_b - moved.reshape(-1, 2, 2))

    def accumulate(self, T: Array, cost: Array, H: Array, g: Array,
                   part: Array | None = None) -> Array:
        """Add this family to cost (G,), H (G, 6, 6) and g (G, 6); each line's whitened length.

        Args:
            part: (L,) which of the G poses and sums is each line's; None: that of its group.
        """
        return np.asarray(_accumulate_lines(
            T, self.m.group if part is None else part, self.rays, self.m.rho_a,
            self.m.endpoints_b, self.whitening, camera_tuple(self.camera),
            is_pixel(self.config.line_normalisation),
            self.config.kernel == "huber", self.config.kernel_width, cost, H, g))


@numba.njit(cache=True, nogil=True)
def _whitening_of_lines(J_flow, J_rho, var_flow, var_rho, var_l):  # type: ignore[no-untyped-def]
    """L⁻¹ (N, 2, 2), lower triangular, for S = L Lᵀ."""
    out = np.zeros((len(J_flow), 2, 2))
    for n in range(len(J_flow)):
        s00, s10, s11 = var_l, 0.0, var_l
        for c in range(4):
            s00 += var_flow[n] * J_flow[n, 0, c] ** 2
            s10 += var_flow[n] * J_flow[n, 0, c] * J_flow[n, 1, c]
            s11 += var_flow[n] * J_flow[n, 1, c] ** 2
        s00 += J_rho[n, 0, 0] ** 2 * var_rho[n, 0]       # each end's depth moves its own row only
        s11 += J_rho[n, 1, 1] ** 2 * var_rho[n, 1]
        l00 = np.sqrt(s00)
        l10 = s10 / l00
        l11 = np.sqrt(s11 - l10 * l10)
        out[n, 0, 0], out[n, 1, 0], out[n, 1, 1] = 1.0 / l00, -l10 / (l00 * l11), 1.0 / l11
    return out


@numba.njit(cache=True, nogil=True)
def _accumulate_lines(T, group, rays, rho, ends_b, whitening, camera,  # type: ignore[no-untyped-def]
                      pixel, huber, width, cost, H, g):
    chi = np.empty(len(rays))
    r, J, j, J_flow = np.empty(2), np.empty((2, 6)), np.empty(2), np.empty((2, 4))
    line, line_J = np.empty(3), np.empty((3, 4))
    for i in range(len(rays)):
        own, W = group[i], whitening[i]
        line_row(T[own], rays[i], rho[i], ends_b[i], camera, pixel, r, J, j, J_flow,
                 line, line_J)
        r0, r1 = W[0, 0] * r[0], W[1, 0] * r[0] + W[1, 1] * r[1]
        chi2 = r0 * r0 + r1 * r1
        chi[i] = np.sqrt(chi2)
        weight, loss = robust(chi2, huber, width)
        cost[own] += loss
        if weight == 0.0:
            continue
        for c in range(6):
            J[1, c] = W[1, 0] * J[0, c] + W[1, 1] * J[1, c]
            J[0, c] *= W[0, 0]
        for c in range(6):
            w0, w1 = weight * J[0, c], weight * J[1, c]
            g[own, c] += w0 * r0 + w1 * r1
            for d in range(6):
                H[own, c, d] += w0 * J[0, d] + w1 * J[1, d]
    return chi
