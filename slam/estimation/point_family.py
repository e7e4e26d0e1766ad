"""Points in the solver, with the flow and the inverse depth of each eliminated in closed form.

A point's flow φ and inverse depth ρ touch its own residual only. Eliminated, they leave the
residual r̃ with the covariance

    S = D Σ_φ Dᵀ + Σ_p + J_ρ σ_ρ² J_ρᵀ             (3×3: u, v, inverse depth in b)

with D = [I; gᵀ], since the inverse depth in b is read where the flow leads, on a surface of
slope g. Minimising Σ ‖r̃‖²_S over the pose has the minimum of eq. (3) over pose, flows and
depths together. The eliminated variables are recovered from the pose.
"""

from __future__ import annotations

import numba
import numpy as np

from slam.config import MotionConfig
from slam.estimation.kernel import robust
from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.matches import PointMatches
from slam.residuals import camera_tuple, point_row, point_terms, pose_rows
from slam.types import Intrinsics

_OFFSET_POINTS = 1000     # are enough to tell a common offset
_PLACE_SIGMA_PX = 0.02    # surfaces bend: of where a depth is read, beside what the flow errs


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
        self.var_place = _PLACE_SIGMA_PX**2 * np.sum(m.rho_slope_b**2, axis=1)
        self.depth_scale2: Array = np.ones(len(m))
        self.flow_scale2: Array = np.ones(len(m))
        self.whitening = np.zeros((len(m), 3, 3))

    def marginal(self, T: Array, index: Array) -> tuple[Array, Array]:
        """Of the points `index`: r̃ (M, 3) at the measured depth, linearised about the current
        one; J_ρ (M, 3)."""
        r, _, j = self._terms(T, index)
        return r, j

    def _terms(self, T: Array, index: Array) -> tuple[Array, Array, Array]:
        """r̃ (M, 3), J_pose (M, 3, 6), J_ρ (M, 3) of the points `index`."""
        m, rho = self.m, self.rho[index]
        t = point_terms(T, self.rays[index], rho, m.uv_b[index], m.rho_b[index], self.camera,
                        m.group[index])
        return t.r + t.J_rho * (m.rho_a[index] - rho)[:, None], t.J_pose, t.J_rho

    def renew(self, T: Array) -> None:
        """Recompute the covariance S at T, then the eliminated inverse depths."""
        m = self.m
        self.whitening, self.rho = _eliminate(
            T, m.group, self.rays, self.rho, m.rho_a, m.uv_b, m.rho_b, camera_tuple(self.camera),
            self.var_a * self.depth_scale2, self.flow_cov, self.flow_scale2,
            self.config.reprojection_sigma_px**2, self.var_b * self.depth_scale2 + self.var_place,
            m.rho_slope_b)

    def depth_innovation(self, r: Array, j: Array, index: Array) -> tuple[Array, Array]:
        """How far (M,) the residuals of the points `index` move their inverse depths, and that
        move's variance (M,)."""
        return _depth_innovation(self.whitening, r, j, index, self.var_a * self.depth_scale2)

    def common_offset(self, T: Array, group: int) -> tuple[float, float]:
        """The offset of all inverse depths of a group, 1/m, with its standard deviation.

        One unknown more beside the pose: what must be added to every measured inverse depth, in
        both frames, for the residuals to be least. A stereo rig whose disparities are off by a
        part of a pixel has one. (0, inf) where it cannot be told.
        """
        own = np.flatnonzero(self.m.group == group)
        own = own[:: max(1, len(own) // _OFFSET_POINTS)]
        r, J_pose, j = self._terms(T, own)
        J = np.concatenate([J_pose, (j - np.array([0.0, 0.0, 1.0]))[:, :, None]], axis=2)
        # The residual as one more column: one product whitens, one makes the normal equations.
        whitened = self.whitening[own] @ np.concatenate([J, r[:, :, None]], axis=2)
        chi2 = np.sum(whitened[:, :, 7] ** 2, axis=1)
        weight = 1.0 / np.sqrt(1.0 + chi2 / self.config.kernel_width**2)
        rows = np.nan_to_num(whitened * np.where(np.isfinite(chi2), weight, 0.0)[:, None, None])
        rows = rows.reshape(-1, 8)
        H, g = rows[:, :7].T @ rows[:, :7], rows[:, :7].T @ rows[:, 7]
        if not np.isfinite(H).all() or np.linalg.matrix_rank(H) < len(H):
            return 0.0, np.inf
        inverse = np.linalg.inv(H)
        step = -inverse @ g
        return float(step[6]), float(np.sqrt(max(inverse[6, 6], 0.0)))

    def accumulate(self, T: Array, cost: Array, H: Array, g: Array, index: Array | None = None,
                   part: Array | None = None) -> Array:
        """Add points to cost (G,), H (G, 6, 6) and g (G, 6); each one's whitened length.

        Args:
            index: (M,) the points that count; None: all.
            part: (N,) which of the G poses and sums is each point's; None: that of its group.
        """
        index = np.arange(len(self.m)) if index is None else index
        return np.asarray(_accumulate_points(
            T, index, self.m.group if part is None else part, self.rays, self.rho, self.m.rho_a,
            self.m.uv_b, self.m.rho_b, self.whitening, camera_tuple(self.camera),
            self.config.kernel == "huber",
            self.config.kernel_width, cost, H, g))

    def refined_uv_b(self, T: Array) -> Array:
        """m + φ with φ = φ̂ + Σ_φ (Σ_φ + Σ_p)⁻¹ (π − m − φ̂): the flow that eq. (3) asks for."""
        if not self.config.optimise_flow:
            return np.array(self.m.uv_b)
        m = self.m
        return np.asarray(_refined_uv(
            T, m.group, self.rays, self.rho, m.uv_b, m.rho_b, camera_tuple(self.camera),
            self.flow_cov, self.flow_scale2, self.config.reprojection_sigma_px**2))


@numba.njit(cache=True, nogil=True)
def _depth_innovation(W, r, j, index, var_a):  # type: ignore[no-untyped-def]
    moved, allowed = np.empty(len(index)), np.empty(len(index))
    for place in range(len(index)):
        n = index[place]
        across = size = 0.0
        for a in range(3):
            rw = jw = 0.0
            for b in range(a + 1):                   # W is lower triangular
                rw += W[n, a, b] * r[place, b]
                jw += W[n, a, b] * j[place, b]
            across += rw * jw
            size += jw * jw
        moved[place], allowed[place] = -var_a[n] * across, var_a[n] * var_a[n] * size
    return moved, allowed


@numba.njit(cache=True, nogil=True)
def _refined_uv(T, group, rays, rho, uv_b, rho_b, camera, flow_cov,  # type: ignore[no-untyped-def]
                scale2, var_p):
    out = np.empty((len(rho), 2))
    for n in range(len(rho)):
        r, _, _ = point_row(T[group[n]], rays[n], rho[n], uv_b[n], rho_b[n], camera)
        a, b, c = (flow_cov[n, 0, 0] * scale2[n], flow_cov[n, 0, 1] * scale2[n],
                   flow_cov[n, 1, 1] * scale2[n])
        det = (a + var_p) * (c + var_p) - b * b
        x = ((c + var_p) * r[0] - b * r[1]) / det       # (Σ_φ + Σ_p)⁻¹ r
        y = ((a + var_p) * r[1] - b * r[0]) / det
        out[n, 0], out[n, 1] = uv_b[n, 0] + a * x + b * y, uv_b[n, 1] + b * x + c * y
    return out


@numba.njit(cache=True, nogil=True)
def _eliminate(T, group, rays, rho, rho_measured, uv_b, rho_b, camera,  # type: ignore[no-untyped-def]
               var_a, flow_cov, scale2, var_p, var_b, slope_b):
    """L⁻¹ (N, 3, 3), lower triangular, of S = L Lᵀ; new ρ (N,)."""
    out, rho_new = np.zeros((len(rho), 3, 3)), np.empty(len(rho))
    for n in range(len(rho)):
        r, _, j = point_row(T[group[n]], rays[n], rho[n], uv_b[n], rho_b[n], camera)
        a, b, c = j[0], j[1], j[2]
        va, s2, gu, gv = var_a[n], scale2[n], slope_b[n, 0], slope_b[n, 1]
        uu, uv, vv = flow_cov[n, 0, 0] * s2, flow_cov[n, 0, 1] * s2, flow_cov[n, 1, 1] * s2
        ug, vg = uu * gu + uv * gv, uv * gu + vv * gv        # Σ_φ g
        l00 = np.sqrt(uu + var_p + a * a * va)
        l10 = (uv + a * b * va) / l00
        l11 = np.sqrt(vv + var_p + b * b * va - l10 * l10)
        l20 = (ug + a * c * va) / l00
        l21 = (vg + b * c * va - l20 * l10) / l11
        l22 = np.sqrt(gu * ug + gv * vg + var_b[n] + c * c * va - l20 * l20 - l21 * l21)
        out[n, 0, 0], out[n, 1, 1], out[n, 2, 2] = 1.0 / l00, 1.0 / l11, 1.0 / l22
        out[n, 1, 0] = -l10 / (l00 * l11)
        out[n, 2, 1] = -l21 / (l11 * l22)
        out[n, 2, 0] = -(l20 / l00 + l21 * out[n, 1, 0]) / l22
        # The inverse depth that the residual at the measured one asks for: −σ² J_ρᵀ S⁻¹ r̃.
        shift, across = rho_measured[n] - rho[n], 0.0
        for i in range(3):
            rw = jw = 0.0
            for k in range(i + 1):                   # L⁻¹ is lower triangular
                rw += out[n, i, k] * (r[k] + j[k] * shift)
                jw += out[n, i, k] * j[k]
            across += rw * jw
        rho_new[n] = rho_measured[n] - va * across
    return out, rho_new


@numba.njit(cache=True, nogil=True)
def _accumulate_points(T, index, group, rays, rho, rho_measured, uv_b,  # type: ignore[no-untyped-def]
                       rho_b, whitening, camera, huber, width, cost, H, g):
    chi = np.empty(len(index))
    A, B, C = np.empty(6), np.empty(6), np.empty(6)     # the whitened rows of J_pose
    for place in range(len(index)):
        i = index[place]
        own, W = group[i], whitening[i]
        r, seen, j = point_row(T[own], rays[i], rho[i], uv_b[i], rho_b[i], camera)
        shift = rho_measured[i] - rho[i]
        r0, r1, r2 = r[0] + j[0] * shift, r[1] + j[1] * shift, r[2] + j[2] * shift
        # W is lower triangular.
        e0 = W[0, 0] * r0
        e1 = W[1, 0] * r0 + W[1, 1] * r1
        e2 = W[2, 0] * r0 + W[2, 1] * r1 + W[2, 2] * r2
        chi2 = e0 * e0 + e1 * e1 + e2 * e2
        chi[place] = np.sqrt(chi2)
        weight, loss = robust(chi2, huber, width)
        cost[own] += loss
        if weight == 0.0:                            # not finite: 0 · NaN would spoil the sums
            continue
        Ju, Jv, Jq = pose_rows(seen, camera)
        for c in range(6):
            A[c] = W[0, 0] * Ju[c]
            B[c] = W[1, 0] * Ju[c] + W[1, 1] * Jv[c]
            C[c] = W[2, 0] * Ju[c] + W[2, 1] * Jv[c] + W[2, 2] * Jq[c]
        for c in range(6):
            w0, w1, w2 = weight * A[c], weight * B[c], weight * C[c]
            g[own, c] += w0 * e0 + w1 * e1 + w2 * e2
            for d in range(c + 1):                   # the lower triangle; mirrored at the end
                H[own, c, d] += w0 * A[d] + w1 * B[d] + w2 * C[d]
    for own in range(len(H)):
        for c in range(6):
            for d in range(c):
                H[own, d, c] = H[own, c, d]
    return chi
