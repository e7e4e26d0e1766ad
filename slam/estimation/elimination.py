"""Closed-form elimination of what each correspondence carries for itself.

A point's flow φ and inverse depth ρ, and a segment's two flows and two inverse depths, touch one
residual group only. Eliminated, they leave the residual r̃ with the covariance

    points  S = Σ_φ + Σ_p + J_ρ σ_ρ² J_ρᵀ                  (3×3: u, v, inverse depth in b)
    lines   S = J_φ Σ_φ J_φᵀ + Σ_l + J_ρ Σ_ρ J_ρᵀ          (2×2)

and minimising Σ ‖r̃‖²_S over the pose has the minimum of eq. (3) over pose, flows and depths
together. The eliminated variables are recovered from the pose.
"""

from __future__ import annotations

import numpy as np

from slam.config import MotionConfig
from slam.geometry import camera as pinhole
from slam.geometry.arrays import Array
from slam.matches import LineMatches, PointMatches
from slam.residuals import LineTerms, feature_last, line_terms, point_terms
from slam.types import Intrinsics


def _cholesky_inverse_3(S00: Array, S10: Array, S11: Array, S20: Array, S21: Array,
                        S22: Array) -> tuple[Array, ...]:
    """Rows of L⁻¹ for S = L Lᵀ, elementwise over N symmetric 3×3 matrices."""
    l00 = np.sqrt(S00)
    l10 = S10 / l00
    l11 = np.sqrt(S11 - l10 * l10)
    l20 = S20 / l00
    l21 = (S21 - l20 * l10) / l11
    l22 = np.sqrt(S22 - l20 * l20 - l21 * l21)
    i00, i11, i22 = 1.0 / l00, 1.0 / l11, 1.0 / l22
    i10 = -l10 * i00 * i11
    i21 = -l21 * i11 * i22
    i20 = -(l20 * i00 + l21 * i10) * i22
    return i00, i10, i11, i20, i21, i22


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
        self.rays = np.asfortranarray(pinhole.rays(camera, m.uv_a))
        self.rho = m.rho_a.copy()          # current estimate of the eliminated inverse depth
        self.known_b = np.isfinite(m.rho_sigma_b)
        if config.optimise_flow:
            cov = m.flow_cov
        else:   # φ = φ̂: what each flow is worth is not asked, all weigh alike within a kind
            cov = _alike_within_kinds(m)
        self.uu, self.uv, self.vv = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
        self.var_a = m.rho_sigma_a**2
        # A row without a measurement is made harmless by a huge variance, not by branching.
        self.var_b = np.where(self.known_b, m.rho_sigma_b, 1e6) ** 2
        self.depth_scale2: Array = np.ones(len(m))
        self.flow_scale2: Array = np.ones(len(m))
        self.inverse: tuple[Array, ...] = ()

    def marginal(self, T: Array) -> tuple[Array, Array, Array]:
        """r̃ (N, 3) at the measured depth, linearised about the current one; J_pose; J_ρ."""
        t = point_terms(T, self.rays, self.rho, self.m.uv_b, self.m.rho_b, self.camera)
        return t.r + t.J_rho * (self.m.rho_a - self.rho)[:, None], t.J_pose, t.J_rho

    def renew(self, T: Array) -> None:
        """Recompute the covariance S at T, then the eliminated inverse depths."""
        r, _, j = self.marginal(T)
        va = self.var_a * self.depth_scale2
        s2 = self.flow_scale2
        floor = self.config.reprojection_sigma_px**2      # Σ_p
        self.inverse = _cholesky_inverse_3(
            self.uu * s2 + floor + j[:, 0] * j[:, 0] * va,
            self.uv * s2 + j[:, 0] * j[:, 1] * va,
            self.vv * s2 + floor + j[:, 1] * j[:, 1] * va,
            j[:, 2] * j[:, 0] * va,
            j[:, 2] * j[:, 1] * va,
            self.var_b * self.depth_scale2 + j[:, 2] * j[:, 2] * va)
        rw, jw = self._whiten_vector(r), self._whiten_vector(j)
        self.rho = self.m.rho_a - va * np.sum(rw * jw, axis=1)

    def _whiten_vector(self, r: Array) -> Array:
        i00, i10, i11, i20, i21, i22 = self.inverse
        out = feature_last(*r.shape)
        out[:, 0] = i00 * r[:, 0]
        out[:, 1] = i10 * r[:, 0] + i11 * r[:, 1]
        out[:, 2] = i20 * r[:, 0] + i21 * r[:, 1] + i22 * r[:, 2]
        return out

    def depth_innovation(self, r: Array, j: Array) -> tuple[Array, Array]:
        """How far (N,) the residuals move each inverse depth, and that move's variance (N,)."""
        rw, jw = self._whiten_vector(r), self._whiten_vector(j)
        va = self.var_a * self.depth_scale2
        return -va * np.sum(rw * jw, axis=1), va * va * np.sum(jw * jw, axis=1)

    def whitened(self, T: Array) -> tuple[Array, Array]:
        r, J, _ = self.marginal(T)
        i00, i10, i11, i20, i21, i22 = (i[:, None] for i in self.inverse)
        Jw = feature_last(*J.shape)
        Jw[:, 0] = i00 * J[:, 0]
        Jw[:, 1] = i10 * J[:, 0] + i11 * J[:, 1]
        Jw[:, 2] = i20 * J[:, 0] + i21 * J[:, 1] + i22 * J[:, 2]
        return self._whiten_vector(r), Jw

    def refined_uv_b(self, T: Array) -> Array:
        """m + φ with φ = φ̂ + Σ_φ (Σ_φ + Σ_p)⁻¹ (π − m − φ̂): the flow that eq. (3) asks for."""
        if not self.config.optimise_flow:
            return np.array(self.m.uv_b)
        t = point_terms(T, self.rays, self.rho, self.m.uv_b, self.m.rho_b, self.camera)
        s2, p = self.flow_scale2, self.config.reprojection_sigma_px**2
        a, b, d = self.uu * s2, self.uv * s2, self.vv * s2
        det = (a + p) * (d + p) - b * b
        r0, r1 = t.r[:, 0], t.r[:, 1]
        w0, w1 = ((d + p) * r0 - b * r1) / det, ((a + p) * r1 - b * r0) / det
        return self.m.uv_b + np.stack([a * w0 + b * w1, b * w0 + d * w1], axis=1)


class LineFamily:
    """The line family: residuals, noise, and its eliminated variables."""

    def __init__(self, m: LineMatches, camera: Intrinsics, config: MotionConfig) -> None:
        self.m, self.camera, self.config = m, camera, config
        self.rays = pinhole.rays(camera, m.endpoints_a)
        self.inverse = np.zeros((len(m), 2, 2))
        self.scale2: Array = np.ones(len(m))
        self.depth_scale2: Array = np.ones(len(m))

    def renew(self, T: Array) -> None:
        t = self._terms(T)
        flow = (self.m.flow_sigma**2 * self.scale2)[:, None, None]
        S = flow * (t.J_flow @ np.swapaxes(t.J_flow, 1, 2))
        S += np.eye(2) * self.config.line_sigma_px**2                        # Σ_l
        S += (t.J_rho * (self.m.rho_sigma_a**2 * self.depth_scale2[:, None])[:, None, :]
              ) @ np.swapaxes(t.J_rho, 1, 2)
        l00 = np.sqrt(S[:, 0, 0])
        l10 = S[:, 1, 0] / l00
        l11 = np.sqrt(S[:, 1, 1] - l10 * l10)
        self.inverse[:, 0, 0] = 1.0 / l00
        self.inverse[:, 1, 0] = -l10 / (l00 * l11)
        self.inverse[:, 1, 1] = 1.0 / l11

    def _terms(self, T: Array) -> LineTerms:
        return line_terms(T, self.rays, self.m.rho_a, self.m.endpoints_b, self.camera,
                          self.config.line_normalisation)

    def whitened(self, T: Array) -> tuple[Array, Array]:
        t = self._terms(T)
        return (self.inverse @ t.r[:, :, None])[:, :, 0], self.inverse @ t.J_pose
