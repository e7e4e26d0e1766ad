"""Correspondences between the previous frame (a) and the current one (b), with their noise.

Depths are inverse depths ρ = 1/z: there stereo and structured-light noise is nearly constant and
Gaussian, and ρ = 0 is a point at infinity. Unknown values have an infinite standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.geometry.arrays import Array, freeze_fields


@dataclass(frozen=True, slots=True)
class PointMatches:
    uv_a: Array          # (N, 2) px, exact by definition: where the flow was read
    rho_a: Array         # (N,) 1/m
    rho_sigma_a: Array   # (N,) 1/m
    uv_b: Array          # (N, 2) px: m + φ
    flow_cov: Array      # (N, 2, 2) px²
    rho_b: Array         # (N,) 1/m
    rho_sigma_b: Array   # (N,) 1/m; inf where the second frame has no depth
    rho_slope_b: Array   # (N, 2) 1/m/px, of the surface: rho_b is read where a wrong flow leads
    group: Array         # (N,) int: which rigid motion; 0 = camera against the static world
    kind: Array          # (N,) int: correspondences of one kind share one noise scale

    def __post_init__(self) -> None:
        freeze_fields(self, uv_a=("N", 2), rho_a=("N",), rho_sigma_a=("N",), uv_b=("N", 2),
                      flow_cov=("N", 2, 2), rho_b=("N",), rho_sigma_b=("N",), rho_slope_b=("N", 2),
                      group=("N",), kind=("N",))

    def __len__(self) -> int:
        return len(self.uv_a)


@dataclass(frozen=True, slots=True)
class LineMatches:
    endpoints_a: Array   # (L, 2, 2) px
    rho_a: Array         # (L, 2) 1/m
    rho_sigma_a: Array   # (L, 2) 1/m
    endpoints_b: Array   # (L, 2, 2) px: a + φ_a, b + φ_b
    flow_sigma: Array    # (L,) px, of each endpoint perpendicular to the line
    group: Array         # (L,) int

    def __post_init__(self) -> None:
        freeze_fields(self, endpoints_a=("L", 2, 2), rho_a=("L", 2), rho_sigma_a=("L", 2),
                      endpoints_b=("L", 2, 2), flow_sigma=("L",), group=("L",))

    def __len__(self) -> int:
        return len(self.endpoints_a)


def no_lines() -> LineMatches:
    """An empty set of line matches."""
    return LineMatches(np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros((0, 2)),
                       np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0, np.int64))
