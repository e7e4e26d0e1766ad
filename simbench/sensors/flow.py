"""Noise of optical flow, pairwise or by where features are seen in each frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from simbench.errors import UserError
from simbench.sensors.fields import noise_field
from simbench.sensors.streams import Stage, generator
from simbench.sensors.structure import follow_structure, structure_sigmas
from simbench.types import FlowTruth
from slam.geometry.arrays import Array, freeze_fields
from slam.types import FlowField

KINDS = ("pairwise", "localisation")
SHAPES = ("isotropic", "structure")


@dataclass(frozen=True, slots=True)
class FlowNoise:
    """σ is that of the flow vector in both kinds, so that both are of equal strength.

    pairwise: every flow field has noise of its own.
    localisation: a feature is seen beside where it is, by n_k in frame k, so that the flow to k
    errs by n_k − n_{k−1} and errors along a chained track telescope; n has σ / √2.
    """

    sigma_px: float = 0.3
    kind: str = "pairwise"
    shape: str = "isotropic"          # structure: σ_px at a good corner, more along edges
    correlation_px: float = 0.0       # smoothing of the noise over the image; 0: white
    structure_window_px: float = 2.0  # σ of the structure tensor's window
    structure_reference_dn: float = 8.0   # gradient, grey levels per pixel, of a good corner
    structure_cap: float = 20.0       # σ is never more than this times sigma_px
    occluded_share: float = 0.5       # share of occluded pixels whose noise is …
    occluded_scale: float = 10.0      # … this times larger

    def __post_init__(self) -> None:
        for name, value, known in (("kind", self.kind, KINDS), ("shape", self.shape, SHAPES)):
            if value not in known:
                raise UserError(f"flow noise: {name} {value!r} is not one of {', '.join(known)}")
        if not self.sigma_px >= 0:
            raise UserError(f"flow noise: sigma_px must be 0 or more, got {self.sigma_px}")


@dataclass(frozen=True, slots=True)
class NoiseField:
    """Noise on the pixels of one frame."""

    offset_px: Array      # (H, W, 2) float32
    sigma_px: Array       # (H, W) float32: RMS σ over both axes

    def __post_init__(self) -> None:
        freeze_fields(self, offset_px=("H", "W", 2), sigma_px=("H", "W"))


def draw_noise(noise: FlowNoise, seed: int, frame: int, size: tuple[int, int],
               rgb: Array | None = None) -> NoiseField:
    """The noise field of one frame: n_k (localisation), or of the flow to it (pairwise).

    Args:
        frame: k.
        size: H and W.
        rgb: (H, W, 3) uint8 that the pixels belong to; needed by shape `structure`.
    """
    stage = Stage.FLOW if noise.kind == "pairwise" else Stage.LOCALISATION
    white = noise_field(generator(seed, stage, frame), size, 2, noise.correlation_px)
    strength = noise.sigma_px if noise.kind == "pairwise" else noise.sigma_px / np.sqrt(2.0)
    white *= np.float32(strength)
    if noise.shape == "isotropic":
        return NoiseField(white, np.full(size, strength, np.float32))
    if rgb is None:
        raise UserError("flow noise: shape 'structure' needs the image of the frame")
    along, across, axis = structure_sigmas(rgb, noise.structure_window_px,
                                           noise.structure_reference_dn, noise.structure_cap)
    sigma = np.float32(strength) * np.sqrt(0.5 * (along**2 + across**2))
    return NoiseField(follow_structure(white, along, across, axis), sigma)


def flow_noise(flow: FlowTruth, noise: FlowNoise, seed: int, frame: int, source: NoiseField,
               target: NoiseField | None = None) -> FlowField:
    """True flow k−1 → k with noise, valid where a surface is seen that stays in the image.

    `sigma_px` of the answer is the nominal σ: it knows the image, not what is occluded.

    Args:
        frame: k.
        source: pairwise: `draw_noise(noise, seed, k, …)`; localisation: that of frame k−1.
        target: localisation only: `draw_noise(noise, seed, k, …)`.
    """
    error, sigma = source.offset_px, source.sigma_px
    if target is not None:
        at_target = _at_target(target, flow.flow_px, smooth=noise.correlation_px > 0)
        error = at_target[..., :2] - error
        sigma = np.sqrt(at_target[..., 2] ** 2 + sigma**2)
    error = _with_tail(error, flow.occluded, noise, generator(seed, Stage.FLOW_TAIL, frame))
    return FlowField(flow.flow_px + error, flow.valid & ~flow.leaving, sigma)


def _at_target(field: NoiseField, flow_px: Array, smooth: bool) -> Array:
    """(H, W, 3) offset and σ of the target frame's field where each source pixel lands."""
    height, width = flow_px.shape[:2]
    u = np.arange(width, dtype=np.float32) + flow_px[..., 0]
    v = np.arange(height, dtype=np.float32)[:, None] + flow_px[..., 1]
    values = np.dstack([field.offset_px, field.sigma_px])
    # White noise belongs to a pixel: interpolating it would take away its variance.
    how = cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
    if not smooth:
        u, v = np.rint(u), np.rint(v)
    return np.asarray(cv2.remap(values, u, v, how, borderMode=cv2.BORDER_REPLICATE))


def _with_tail(error: Array, occluded: Array, noise: FlowNoise,
               rng: np.random.Generator) -> Array:
    rows, columns = np.nonzero(occluded)
    chosen = rng.random(len(rows)) < noise.occluded_share
    out = np.array(error)
    out[rows[chosen], columns[chosen]] *= np.float32(noise.occluded_scale)
    return out
