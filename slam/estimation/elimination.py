"""Closed-form elimination of what each correspondence carries for itself.

A point's flow φ and inverse depth ρ, and a segment's two flows and two inverse depths, touch one
residual group only. Eliminated, they leave the residual r̃ with the covariance

    points  S = Σ_φ + Σ_p + J_ρ σ_ρ² J_ρᵀ                  (3×3: u, v, inverse depth in b)
    lines   S = J_φ Σ_φ J_φᵀ + Σ_l + J_ρ Σ_ρ J_ρᵀ          (2×2)

and minimising Σ ‖r̃‖²_S over the pose has the minimum of eq. (3) over pose, flows and depths
together. The eliminated variables are recovered from the pose.
"""

from __future__ import annotations

import numba
import numpy as np

from slam.config import MotionConfig
from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.matches import LineMatches, PointMatches
from slam.residuals import LineTerms, camera_tuple, line_terms, point_row, point_terms
from slam.types import Intrinsics

_OFFSET_POINTS = 1000     # are enough to tell a common offset


def _alike_within_kinds(m: PointMatches) -> Array:
    """(N, 2, 2) isotropic covariances, the median of each kind."""
    variance = 0.5 * (m.flow_cov[:, 0, 0] + m.flow_cov[:, 1, 1])
    for kind in np.unique(m.kind):
        of_kind = m.kind == kind
        variance[of_kind] = np.median(variance[of_kind])
    return variance[:, None, None] * np.eye(2)


class PointFamily:
    """The point family: residuals, noise, and its eliminated variables."""

    def __init__(self, m: PointMatches, camera: Intrinsics, config: MotionConfig) -> None:
        self.m, self.camera, self.config = m, camera, config
        self.rays = pinhole.rays(camera, m.uv_a)
        self.rho = m.rho_a.copy()          # current estimate of the eliminated inverse depth
        self.known_b = np.isfinite(m.rho_sigma_b)
        # φ = φ̂: what each flow is worth is not asked then, all weigh alike within a kind.
        self.flow_cov = m.flow_cov if config.optimise_flow else _alike_within_kinds(m)
        self.var_a = m.rho_sigma_a**2
        # A row without a measurement is made harmless by a huge variance, not by branching.
        self.var_b = np.where(self.known_b, m.rho_sigma_b, 1e6) ** 2
        self.depth_scale2: Array = np.ones(len(m))
        self.flow_scale2: Array = np.ones(len(m))
        self.whitening = np.zeros((len(m), 3, 3))

    def marginal(self, T: Array) -> tuple[Array, Array]:
        """r̃ (N, 3) at the measured depth, linearised about the current one; J_ρ (N, 3)."""
        t = point_terms(T, self.rays, self.rho, self.m.uv_b, self.m.rho_b, self.camera,
                        self.m.group)
        return t.r + t.J_rho * (self.m.rho_a - self.rho)[:, None], t.J_rho

    def renew(self, T: Array) -> None:
        """Recompute the covariance S at T, then the eliminated inverse depths."""
        r, j = self.marginal(T)
        va = self.var_a * self.depth_scale2
        self.whitening = _whitening_of_points(
            j, va, self.flow_cov, self.flow_scale2, self.config.reprojection_sigma_px**2,
            self.var_b * self.depth_scale2)
        moved, _ = self.depth_innovation(r, j)
        self.rho = self.m.rho_a + moved

    def depth_innovation(self, r: Array, j: Array) -> tuple[Array, Array]:
        """How far (N,) the residuals move each inverse depth, and that move's variance (N,)."""
        return _depth_innovation(self.whitening, r, j, self.var_a * self.depth_scale2)

    def common_offset(self, T: Array, group: int) -> tuple[float, float]:
        """The offset of all inverse depths of a group, 1/m, with its standard deviation.

        One unknown more beside the pose: what must be added to every measured inverse depth, in
        both frames, for the residuals to be least. A stereo rig whose disparities are off by a
        part of a pixel has one. (0, inf) where it cannot be told.
        """
        own = np.flatnonzero(self.m.group == group)
        own = own[:: max(1, len(own) // _OFFSET_POINTS)]
        t = point_terms(T[group], self.rays[own], self.rho[own], self.m.uv_b[own],
                        self.m.rho_b[own], self.camera)
        r = t.r + t.J_rho * (self.m.rho_a[own] - self.rho[own])[:, None]
        J = np.concatenate([t.J_pose, (t.J_rho - np.array([0.0, 0.0, 1.0]))[:, :, None]], axis=2)
        r = np.einsum("nij,nj->ni", self.whitening[own], r)
        J = self.whitening[own] @ J
        chi2 = np.einsum("ni,ni->n", r, r)
        weight = 1.0 / (1.0 + chi2 / self.config.kernel_width**2)
        weight = np.where(np.isfinite(chi2), weight, 0.0)
        r, J = np.nan_to_num(r), np.nan_to_num(J)
        H = np.einsum("n,nki,nkj->ij", weight, J, J)
        if not np.isfinite(H).all() or np.linalg.matrix_rank(H) < len(H):
            return 0.0, np.inf
        inverse = np.linalg.inv(H)
        step = -inverse @ np.einsum("n,nki,nk->i", weight, J, r)
        return float(step[6]), float(np.sqrt(max(inverse[6, 6], 0.0)))

    def accumulate(self, T: Array, cost: Array, H: Array, g: Array) -> Array:
        """Add this family to cost (G,), H (G, 6, 6) and g (G, 6); each point's whitened length."""
        return _accumulate_points(
            T, self.m.group, self.rays, self.rho, self.m.rho_a, self.m.uv_b, self.m.rho_b,
            self.whitening, camera_tuple(self.camera), self.config.kernel == "huber",
            self.config.kernel_width, cost, H, g)

    def refined_uv_b(self, T: Array) -> Array:
        """m + φ with φ = φ̂ + Σ_φ (Σ_φ + Σ_p)⁻¹ (π − m − φ̂): the flow that eq. (3) asks for."""
        if not self.config.optimise_flow:
            return np.array(self.m.uv_b)
        t = point_terms(T, self.rays, self.rho, self.m.uv_b, self.m.rho_b, self.camera,
                        self.m.group)
        flow = self.flow_cov * self.flow_scale2[:, None, None]
        total = flow + np.eye(2) * self.config.reprojection_sigma_px**2
        moved = flow @ np.linalg.solve(total, t.r[:, :2, None])
        return np.asarray(self.m.uv_b + moved[:, :, 0])


@numba.njit(cache=True)
def _depth_innovation(W, r, j, var_a):  # type: ignore[no-untyped-def]
    moved, allowed = np.empty(len(r)), np.empty(len(r))
    for n in range(len(r)):
        across = size = 0.0
        for a in range(3):
            rw = jw = 0.0
            for b in range(a + 1):                   # W is lower triangular
                rw += W[n, a, b] * r[n, b]
                jw += W[n, a, b] * j[n, b]
            across += rw * jw
            size += jw * jw
        moved[n] = -var_a[n] * across
        allowed[n] = var_a[n] * var_a[n] * size
    return moved, allowed


@numba.njit(cache=True)
def _whitening_of_points(j, var_a, flow_cov, scale2, var_p, var_b):  # type: ignore[no-untyped-def]
    """L⁻¹ (N, 3, 3), lower triangular, for S = Σ_φ + Σ_p + J_ρ σ_ρ² J_ρᵀ = L Lᵀ."""
    out = np.zeros((len(j), 3, 3))
    for n in range(len(j)):
        a, b, c = j[n, 0], j[n, 1], j[n, 2]
        va, s2 = var_a[n], scale2[n]
        l00 = np.sqrt(flow_cov[n, 0, 0] * s2 + var_p + a * a * va)
        l10 = (flow_cov[n, 0, 1] * s2 + a * b * va) / l00
        l11 = np.sqrt(flow_cov[n, 1, 1] * s2 + var_p + b * b * va - l10 * l10)
        l20 = a * c * va / l00
        l21 = (b * c * va - l20 * l10) / l11
        l22 = np.sqrt(var_b[n] + c * c * va - l20 * l20 - l21 * l21)
        out[n, 0, 0], out[n, 1, 1], out[n, 2, 2] = 1.0 / l00, 1.0 / l11, 1.0 / l22
        out[n, 1, 0] = -l10 / (l00 * l11)
        out[n, 2, 1] = -l21 / (l11 * l22)
        out[n, 2, 0] = -(l20 / l00 + l21 * out[n, 1, 0]) / l22
    return out


@numba.njit(cache=True)
def _accumulate_points(T, group, rays, rho, rho_measured, uv_b, rho_b, whitening,  # type: ignore[no-untyped-def]
                       camera, huber, width, cost, H, g):
    n = len(rho)
    chi = np.empty(n)
    r, J, j = np.empty(3), np.empty((3, 6)), np.empty(3)
    rw, Jw = np.empty(3), np.empty((3, 6))
    for i in range(n):
        own = group[i]
        point_row(T[own], rays[i], rho[i], uv_b[i], rho_b[i], camera, r, J, j)
        W, shift = whitening[i], rho_measured[i] - rho[i]
        chi2 = 0.0
        for a in range(3):
            rw[a] = 0.0
            Jw[a] = 0.0
            for b in range(a + 1):                   # W is lower triangular
                rw[a] += W[a, b] * (r[b] + j[b] * shift)
                for c in range(6):
                    Jw[a, c] += W[a, b] * J[b, c]
            chi2 += rw[a] * rw[a]
        chi[i] = np.sqrt(chi2)
        weight, loss = robust(chi2, huber, width)
        cost[own] += loss
        if weight == 0.0:                            # not finite: 0 · NaN would spoil the sums
            continue
        for c in range(6):
            w0, w1, w2 = weight * Jw[0, c], weight * Jw[1, c], weight * Jw[2, c]
            g[own, c] += w0 * rw[0] + w1 * rw[1] + w2 * rw[2]
            for d in range(c + 1):                   # the lower triangle; mirrored at the end
                H[own, c, d] += w0 * Jw[0, d] + w1 * Jw[1, d] + w2 * Jw[2, d]
    for own in range(len(H)):
        for c in range(6):
            for d in range(c):
                H[own, d, c] = H[own, c, d]
    return chi


@numba.njit(cache=True)
def robust(chi2, huber, width):  # type: ignore[no-untyped-def]
    """Weight and loss of a squared whitened length: Huber's kernel, or Cauchy's."""
    if not np.isfinite(chi2):
        return 0.0, 1e12
    if huber:
        if chi2 <= width * width:
            return 1.0, chi2
        chi = np.sqrt(chi2)
        return width / chi, 2.0 * width * chi - width * width
    ratio = chi2 / (width * width)
    return 1.0 / (1.0 + ratio), width * width * np.log1p(ratio)


class LineFamily:
    """The line family: residuals, noise, and its eliminated variables."""

    def __init__(self, m: LineMatches, camera: Intrinsics, config: MotionConfig) -> None:
        self.m, self.camera, self.config = m, camera, config
        self.rays = pinhole.rays(camera, m.endpoints_a)
        self.inverse = np.zeros((len(m), 2, 2))
        self.depth_scale2: Array = np.ones(len(m))

    def renew(self, T: Array) -> None:
        t = self._terms(T)
        S = self.m.flow_sigma[:, None, None] ** 2 * (t.J_flow @ np.swapaxes(t.J_flow, 1, 2))
        S += np.eye(2) * self.config.line_sigma_px**2                        # Σ_l
        S += (t.J_rho * (self.m.rho_sigma_a**2 * self.depth_scale2[:, None])[:, None, :]
              ) @ np.swapaxes(t.J_rho, 1, 2)
        l00 = np.sqrt(S[:, 0, 0])
        l10 = S[:, 1, 0] / l00
        l11 = np.sqrt(S[:, 1, 1] - l10 * l10)
        self.inverse[:, 0, 0] = 1.0 / l00
        self.inverse[:, 1, 0] = -l10 / (l00 * l11)
        self.inverse[:, 1, 1] = 1.0 / l11

    def refined_endpoints_b(self, T: Array) -> Array:
        """(L, 2, 2) a + φ_a, b + φ_b with φ = φ̂ − Σ_φ J_φᵀ S⁻¹ e_l: the flows of eq. (3)."""
        if not self.config.optimise_flow:
            return np.array(self.m.endpoints_b)
        t = self._terms(T)
        pull = np.swapaxes(self.inverse, 1, 2) @ (self.inverse @ t.r[:, :, None])
        moved = self.m.flow_sigma[:, None] ** 2 * np.einsum("lij,li->lj", t.J_flow, pull[:, :, 0])
        return np.asarray(self.m.endpoints_b - moved.reshape(-1, 2, 2))

    def _terms(self, T: Array) -> LineTerms:
        return line_terms(T, self.rays, self.m.rho_a, self.m.endpoints_b, self.camera,
                          self.config.line_normalisation, self.m.group)

    def accumulate(self, T: Array, cost: Array, H: Array, g: Array) -> Array:
        """Add this family to cost (G,), H (G, 6, 6) and g (G, 6); each line's whitened length."""
        t = self._terms(T)
        r = (self.inverse @ t.r[:, :, None])[:, :, 0]
        return _accumulate_lines(self.m.group, r, self.inverse @ t.J_pose,
                                 self.config.kernel == "huber", self.config.kernel_width,
                                 cost, H, g)


@numba.njit(cache=True)
def _accumulate_lines(group, r, J, huber, width, cost, H, g):  # type: ignore[no-untyped-def]
    chi = np.empty(len(r))
    for i in range(len(r)):
        chi2 = r[i, 0] * r[i, 0] + r[i, 1] * r[i, 1]
        chi[i] = np.sqrt(chi2)
        weight, loss = robust(chi2, huber, width)
        cost[group[i]] += loss
        if weight == 0.0:
            continue
        for a in range(2):
            for c in range(6):
                weighted = weight * J[i, a, c]
                g[group[i], c] += weighted * r[i, a]
                for d in range(6):
                    H[group[i], c, d] += weighted * J[i, a, d]
    return chi
