"""Points and lines of one body in the paper's formulation: their nodes, equations and noise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from slam.backend.chains import chain_steps, reduce_chains
from slam.backend.config import ChainConfig
from slam.backend.linearise import UNSEEN_CHI2, whitening
from slam.backend.settle import misfits, noise_ratios
from slam.factors import (
    back_projected_covariance,
    landmark_terms,
    landmark_terms_metric,
    point_motion_terms,
)
from slam.geometry import camera as pinhole
from slam.geometry import line, se3
from slam.geometry.arrays import Array
from slam.line_factors import (
    across,
    in_camera,
    line_measurement,
    line_measurement_covariance,
    line_measurement_paper,
    line_motion,
    line_motion_paper,
)
from slam.line_sightings import (
    ends_in_metres,
    line_sighting_terms,
    moved_lines,
    packed,
    unpacked,
)
from slam.map import LineObservations, PointObservations
from slam.types import Intrinsics


class _Terms(NamedTuple):
    """Whitened and weighted: residuals (M, R), derivatives by what is tied."""

    r: Array
    by_pose: Array         # (M, R, 6): a camera's, or a motion's
    by_node: Array         # (M, R, d): the node measured; the node after the motion
    by_before: Array | None = None   # (M, R, d): the node before the motion


class Chains(ABC):
    """Landmarks of one kind of one body, each with a node in every frame from first to last sight.

    Variables of the body are numbered 0 … F − 1 for its cameras and F … 2F − 1 for the motions
    that lead to its frames; of a static body each landmark has one node, and no motion.
    """

    size: int              # of a node's parameters

    def __init__(self, sightings: PointObservations | LineObservations, landmarks: int,
                 moving: bool, camera: Intrinsics, config: ChainConfig) -> None:
        s = sightings
        self.camera, self.config, self.frame = camera, config, s.frame
        first, last = np.zeros(landmarks, np.int64), np.zeros(landmarks, np.int64)
        if moving and len(s):
            first[:] = np.iinfo(np.int64).max
            np.minimum.at(first, s.landmark, s.frame)
            np.maximum.at(last, s.landmark, s.frame)
        self.chain = np.concatenate([[0], np.cumsum(last - first + 1)])
        self.owner = np.repeat(np.arange(landmarks), last - first + 1)
        self.node_frame = np.arange(self.chain[-1]) - self.chain[self.owner] + first[self.owner]
        self.node = self.chain[s.landmark] + (s.frame - first[s.landmark] if moving else 0)
        self.after = np.flatnonzero(np.diff(self.owner, prepend=-1) == 0)
        depths = s.rho_sigma[:, None] if s.rho_sigma.ndim == 1 else s.rho_sigma
        self.whitening = whitening(s.covariance, depths)
        self.noise_scale = np.ones(2)      # measured over assumed variance: pixels, inverse depths
        self.start = np.searchsorted(s.landmark, np.arange(landmarks + 1))
        self._fits = np.ones(landmarks, bool)      # the others are left out

    def place(self, landmarks: Array, T_world_body: Array) -> Array:
        """Nodes (N, …) where landmarks of the body start; T_world_body (F, 4, 4)."""
        return self._carried(landmarks[self.owner], T_world_body[self.node_frame])

    def cost(self, X: Array, H: Array, place: Array) -> float:
        """Robust cost of measurements and motions."""
        return sum(self._robust(r)[1] for r in
                   (self._measure(X, place).r, self._tied(self._move(H, place)).r))

    def linearise(self, X: Array, H: Array, place: Array) -> None:
        """Take a new point of linearisation."""
        self._measured = self._weighted(self._measure(X, place))
        self._moved = self._weighted(self._tied(self._move(H, place)))

    def add(self, damping: float, S: Array, g: Array) -> None:
        """Add the current linearisation, nodes eliminated, to S (12F, 12F) and g (12F,)."""
        frames, N, d = len(g) // 12, len(self.owner), self.size
        D, off, c = np.zeros((N, d, d)), np.zeros((N, d, d)), np.zeros((N, d))
        now, before = self.after, self.after - 1
        motion = np.asarray(frames + self.node_frame[now], dtype=np.int64)
        m, h = self._measured, self._moved
        parts = [(np.asarray(self.node, dtype=np.int64), self.frame, m.by_node, m),
                 (now, motion, h.by_node, h)]
        if h.by_before is not None:
            parts.append((before, motion, h.by_before, h))
            off[now] = np.swapaxes(h.by_node, 1, 2) @ h.by_before
        couplings = []
        for node, variable, V, terms in parts:
            Vt = np.swapaxes(V, 1, 2)
            np.add.at(D, node, Vt @ V)
            np.add.at(c, node, (Vt @ terms.r[:, :, None])[:, :, 0])
            couplings.append((node, variable, Vt @ terms.by_pose))
        for variable, terms in ((self.frame, m), (motion, h)):
            Jt = np.swapaxes(terms.by_pose, 1, 2)
            own = np.zeros((2 * frames, 6, 6))
            np.add.at(own, variable, Jt @ terms.by_pose)
            for v in np.unique(variable):
                S[6 * v:6 * v + 6, 6 * v:6 * v + 6] += own[v]
            np.add.at(g.reshape(-1, 6), variable, (Jt @ terms.r[:, :, None])[:, :, 0])
        diagonal = np.einsum("nii->ni", D)
        diagonal += damping * diagonal + 1e-9
        node = np.concatenate([part[0] for part in couplings])
        order = np.argsort(node, kind="stable")
        entry = np.searchsorted(node[order], self.chain)
        self._system = (self.chain, D, off, c, entry, node[order],
                        np.concatenate([part[1] for part in couplings])[order],
                        np.concatenate([part[2] for part in couplings])[order])
        reduce_chains(*self._system, S, g)

    def noise(self, X: Array, place: Array) -> tuple[float, float]:
        """Measured over assumed variance of pixels and of inverse depths."""
        terms = self._sight(X, place)
        weighted = self._weighted(terms)
        return noise_ratios(self.start, np.ascontiguousarray(weighted.r), _chi2(terms.r),
                            self.whitening, self.config.kernel_width)

    def scale_noise(self, uv: float, rho: float) -> None:
        """Multiply the assumed variances."""
        self.noise_scale *= uv, rho
        self.whitening[:, :3] /= np.sqrt(uv)
        self.whitening[:, 3:] /= np.sqrt(rho)

    def drop_misfits(self, X: Array, place: Array, limit: float) -> None:
        """Leave out landmarks most of whose sightings are above a limit of χ²₃."""
        r = self._sight(X, place).r
        wrong = misfits(self.start, _chi2(r), limit * r.shape[1] / 3.0)
        self.whitening[np.repeat(wrong, np.diff(self.start))] = 0.0
        self._fits &= ~wrong

    def steps(self, steps: Array) -> Array:
        """(N, d) steps of the nodes that go with steps (2F, 6) of the body's variables."""
        return np.asarray(chain_steps(*self._system, steps))

    def _tied(self, terms: _Terms) -> _Terms:
        """Motions of the landmarks that are not left out: what nothing measures is singular."""
        fits = self._fits[self.owner[self.after]]

        def kept(part: Array) -> Array:
            return np.where(fits.reshape(-1, *[1] * (part.ndim - 1)), part, 0.0)

        before = None if terms.by_before is None else kept(terms.by_before)
        return _Terms(kept(terms.r), kept(terms.by_pose), kept(terms.by_node), before)

    def _weighted(self, terms: _Terms) -> _Terms:
        weight, _ = self._robust(terms.r)

        def weighted(part: Array) -> Array:
            root = np.sqrt(weight).reshape(-1, *[1] * (part.ndim - 1))
            return np.where(root > 0.0, part * root, 0.0)

        before = None if terms.by_before is None else weighted(terms.by_before)
        return _Terms(weighted(terms.r), weighted(terms.by_pose), weighted(terms.by_node), before)

    def _robust(self, r: Array) -> tuple[Array, float]:
        """Cauchy's weights (M,), 0 where a landmark is not seen, and the cost."""
        width2 = self.config.kernel_width**2
        chi2 = _chi2(r)
        cost = float(np.sum(width2 * np.log1p(np.minimum(chi2, UNSEEN_CHI2) / width2)))
        return 1.0 / (1.0 + chi2 / width2), cost

    def _white(self, r: Array, *derivatives: Array) -> list[Array]:
        """Measurements by their covariances: the pixel's lower triangle, then each depth."""
        w = self.whitening
        W = np.zeros((len(w), r.shape[1], r.shape[1]))
        W[:, 0, 0], W[:, 1, 0], W[:, 1, 1] = w[:, 0], w[:, 1], w[:, 2]
        for k in range(2, r.shape[1]):
            W[:, k, k] = w[:, k + 1]
        return [(W @ r[:, :, None])[:, :, 0], *(W @ J for J in derivatives)]

    def _in_metres(self, uv: Array, rho: Array, covariance: Array, rho_sigma: Array) -> Array:
        """(N, 3, 3) m² of measured places, with the noise as measured so far."""
        sigma = np.where(np.isfinite(rho_sigma), rho_sigma, 1.0)    # its row counts nothing
        uv_scale, rho_scale = self.noise_scale
        return back_projected_covariance(uv, rho, uv_scale * covariance,
                                         np.sqrt(rho_scale) * sigma, self.camera)

    @abstractmethod
    def _sight(self, X: Array, place: Array) -> _Terms:
        """Measurements by cameras X (F, 4, 4) as the sensor makes them, whitened."""

    @abstractmethod
    def _measure(self, X: Array, place: Array) -> _Terms:
        """The same in the form that is set."""

    @abstractmethod
    def _move(self, H: Array, place: Array) -> _Terms:
        """Motions of nodes to the next ones by H (F, 4, 4), whitened."""

    @abstractmethod
    def _carried(self, landmarks: Array, T: Array) -> Array:
        """Landmarks moved by transforms (N, 4, 4)."""

    @abstractmethod
    def moved(self, place: Array, step: Array) -> Array:
        """Nodes after steps (N, d)."""


class PointChains(Chains):
    """Points: 3D measurement and motion of a point (VDO-SLAM's factors)."""

    size = 3

    def __init__(self, sightings: PointObservations, landmarks: int, moving: bool,
                 camera: Intrinsics, config: ChainConfig) -> None:
        super().__init__(sightings, landmarks, moving, camera, config)
        self._s = sightings

    def _sight(self, X: Array, place: Array) -> _Terms:
        s = self._s
        return _Terms(*self._white(*landmark_terms(X[s.frame], place[self.node], s.uv_px, s.rho,
                                                   self.camera)))

    def _measure(self, X: Array, place: Array) -> _Terms:
        if self.config.measured_in == "pixels":
            return self._sight(X, place)
        s, known = self._s, self._s.rho > 0             # without depth there is no place
        rho = np.where(known, s.rho, 1.0)
        t = landmark_terms_metric(X[s.frame], place[self.node],
                                  pinhole.rays(self.camera, s.uv_px) / rho[:, None])
        W = _inverse_root(self._in_metres(s.uv_px, rho, s.covariance, s.rho_sigma))
        W[~known | (self.whitening[:, 0] == 0.0)] = 0.0
        return _Terms((W @ t.r[:, :, None])[:, :, 0], W @ t.J_pose, W @ t.J_point)

    def _move(self, H: Array, place: Array) -> _Terms:
        t = point_motion_terms(H[self.node_frame[self.after]], place[self.after - 1],
                               place[self.after])
        w = 1.0 / self.config.motion_sigma_m
        return _Terms(w * t.r, w * t.J_H, w * t.J_now, w * t.J_before)

    def _carried(self, landmarks: Array, T: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], landmarks) + T[:, :3, 3])

    def moved(self, place: Array, step: Array) -> Array:
        return place + step


class LineChains(Chains):
    """Lines: eq. (5) and (6), as printed or well conditioned."""

    size = 4

    def __init__(self, sightings: LineObservations, landmarks: int, moving: bool,
                 camera: Intrinsics, config: ChainConfig) -> None:
        super().__init__(sightings, landmarks, moving, camera, config)
        s = self._s = sightings
        self._ends_camera, self._sigma_m = ends_in_metres(s.ends_px, s.covariance, s.rho,
                                                          s.rho_sigma, camera)
        self._ends_world = np.zeros((0, 2, 3))

    def place(self, landmarks: Array, T_world_body: Array) -> Array:
        """Nodes where lines start; the ends that eq. (6) is measured at are taken there, too."""
        out = super().place(landmarks, T_world_body)
        plucker = line.plucker_from_orthonormal(unpacked(out))
        foot = line.feet_of_origin(plucker)[:, None]
        half = 0.25 * np.array([-1.0, 1.0])[None, :, None] * plucker.direction[:, None]
        middle = T_world_body[self.node_frame][:, None, :3, 3]     # near the body, along the line
        along = np.sum((middle - foot) * plucker.direction[:, None], axis=2, keepdims=True)
        self._ends_world = foot + along * plucker.direction[:, None] + half
        return out

    def _sight(self, X: Array, place: Array) -> _Terms:
        s = self._s
        if self.config.line_form == "paper":
            return self._measure(X, place)
        return _Terms(*self._white(*line_sighting_terms(X[s.frame], place[self.node], s.ends_px,
                                                        s.rho, self.camera)))

    def _measure(self, X: Array, place: Array) -> _Terms:
        T, lines = X[self._s.frame], unpacked(place[self.node])
        if self.config.line_form == "paper":
            t = line_measurement_paper(T, lines, self._ends_camera)
            w = np.where(self.whitening[:, :1] > 0.0, 1.0 / self._sigma_m, 0.0)
            return _Terms(w * t.r, w[..., None] * t.J_pose, w[..., None] * t.J_line)
        if self.config.measured_in == "pixels":
            return self._sight(X, place)
        direction = in_camera(T, lines)[0].direction
        basis = across(direction)
        t = line_measurement(T, lines, self._ends_camera, basis)
        root = _inverse_root(line_measurement_covariance(direction, basis, self._ends_covariance()))
        W = np.zeros((len(T), 4, 4))
        W[:, :2, :2], W[:, 2:, 2:] = root[:, 0], root[:, 1]
        W[(self._s.rho <= 0).any(axis=1) | (self.whitening[:, 0] == 0.0)] = 0.0
        return _Terms((W @ t.r[:, :, None])[:, :, 0], W @ t.J_pose, W @ t.J_line)

    def _ends_covariance(self) -> Array:
        """(M, 2, 3, 3) m²; as far off along the line as across it, where it does not matter."""
        s = self._s
        rho = np.where(s.rho > 0, s.rho, 1.0)
        across_px = np.einsum("mii->mi", s.covariance)[..., None, None] * np.eye(2)
        return self._in_metres(s.ends_px.reshape(-1, 2), rho.reshape(-1),
                               across_px.reshape(-1, 2, 2), s.rho_sigma.reshape(-1)
                               ).reshape(-1, 2, 3, 3)

    def _move(self, H: Array, place: Array) -> _Terms:
        before, now = unpacked(place[self.after - 1]), unpacked(place[self.after])
        H_now = H[self.node_frame[self.after]]
        if self.config.line_form == "well_conditioned":
            t = line_motion(H_now, before, now, self._ends_world[self.after - 1])
            w = np.full((1, 4), 1.0 / self.config.motion_sigma_m)
        else:
            t = line_motion_paper(H_now, before, now)
            w = 1.0 / np.array([[self.config.motion_sigma_m, self.config.direction_sigma]])
        return _Terms(w * t.r, w[..., None] * t.J_H, w[..., None] * t.J_now,
                      w[..., None] * t.J_before)

    def _carried(self, landmarks: Array, T: Array) -> Array:
        lines = line.plucker_from_orthonormal(unpacked(landmarks))
        R, t = T[:, :3, :3], T[:, :3, 3]
        U = np.einsum("nij,nj->ni", R, lines.direction)
        N = np.einsum("nij,nj->ni", R, lines.moment) + np.cross(t, U)
        return packed(line.orthonormal_from_plucker(line.PluckerLines(N, U)))

    def moved(self, place: Array, step: Array) -> Array:
        return np.asarray(moved_lines(place, step))


def _inverse_root(covariance: Array) -> Array:
    """Lower L⁻¹ (…, d, d) of covariances L Lᵀ."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def _chi2(r: Array) -> Array:
    chi2 = np.einsum("mi,mi->m", r, r)
    return np.asarray(np.where(np.isfinite(chi2), chi2, np.inf))


def identity_motions(frames: int) -> Array:
    """(F, 4, 4) of a body that does not move."""
    return np.broadcast_to(np.eye(4), (frames, 4, 4)).copy()


def motions_of(T_world_body: Array) -> Array:
    """(F, 4, 4) H_k = L_k L_{k−1}⁻¹ that lead to each frame; the first is the identity."""
    H = identity_motions(len(T_world_body))
    H[1:] = T_world_body[1:] @ se3.inverse(T_world_body[:-1])
    return H
