"""Dense flow as a grid of point correspondences: each is the mean over one cell of the image.

A given flow field has noise of its own at each pixel. The flow, the inverse depth and the pixel
of a rigid surface are, over a few pixels, linear in each other, so that their means over a cell
obey the same equations with the noise divided by the root of the number of pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from slam.config import GridConfig, NoiseConfig
from slam.geometry.arrays import Array
from slam.matches import PointMatches, join
from slam.types import FlowField

GRID_KIND = 0      # PointMatches.kind of cells on the static world
OBJECT_GRID_KIND = 1   # of the smaller cells on objects


@dataclass(frozen=True, slots=True)
class _Sums:
    """Sums over cells, channel last: count, u, v, flow u, flow v, ρ_a; count_b, ρ_b."""

    a: Array           # (h, w, 6)
    b: Array           # (h, w, 2)
    label: Array       # (h, w)

    def doubled(self) -> _Sums:
        """Cells of twice the size; those that mix labels are emptied."""
        h, w = self.label.shape[0] // 2 * 2, self.label.shape[1] // 2 * 2
        quarters = self.label[:h, :w].reshape(h // 2, 2, w // 2, 2)
        first = quarters[:, 0, :, 0]
        same = (quarters == first[:, None, :, None]).all(axis=(1, 3))

        def summed(x: Array) -> Array:
            x = x[:h, :w].reshape(h // 2, 2, w // 2, 2, -1).sum(axis=(1, 3))
            return np.where(same[:, :, None], x, 0.0)

        return _Sums(summed(self.a), summed(self.b), first)


def grid_matches(flow: FlowField, rho_a: Array, rho_b: Array, group_a: Array, group_b: Array,
                 config: GridConfig, noise: NoiseConfig) -> PointMatches:
    """Cell means of a dense flow field as point matches.

    Args:
        flow: from a to b on a's pixels.
        rho_a, rho_b: (H, W) float32 inverse depths, 0 where unknown.
        group_a, group_b: (H, W) uint8 motion group of each pixel in its own frame, 0 = static,
            255 = to be left out. A pixel counts if it stays in its group.
    """
    sums = _cell_sums(flow, rho_a, rho_b, group_a, group_b, config)
    static = sums
    for _ in range(int(np.log2(config.static_cell_px / config.object_cell_px))):
        static = static.doubled()
    return join(_matches(static, static.label == 0, config.static_cell_px, GRID_KIND, config, noise),
                _matches(sums, sums.label > 0, config.object_cell_px, OBJECT_GRID_KIND, config,
                         noise))


def _cell_sums(flow: FlowField, rho_a: Array, rho_b: Array, group_a: Array, group_b: Array,
               config: GridConfig) -> _Sums:
    cell = config.object_cell_px
    h, w = (n // cell * cell for n in rho_a.shape)
    f = np.asarray(flow.flow_px, dtype=np.float32)[:h, :w]
    rho_a, group_a = rho_a[:h, :w], group_a[:h, :w]
    u, v = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
    map_u, map_v = cv2.add(u, f[..., 0]), cv2.add(v, f[..., 1])
    seen_rho = cv2.remap(rho_b, map_u, map_v, cv2.INTER_NEAREST, borderValue=0)
    seen_group = cv2.remap(group_b, map_u, map_v, cv2.INTER_NEAREST, borderValue=255)

    label = group_a[cell // 2 :: cell, cell // 2 :: cell]
    label_everywhere = cv2.resize(label, (w, h), interpolation=cv2.INTER_NEAREST)
    usable = (seen_group == label_everywhere) & (group_a == label_everywhere) & (rho_a > 0)
    if flow.valid is not None:
        usable &= flow.valid[:h, :w]
    change = cv2.absdiff(seen_rho, rho_a) < config.max_depth_change * rho_a
    usable &= change | (seen_rho == 0)
    weight = usable.astype(np.float32)
    weight_b = (usable & (seen_rho > 0)).astype(np.float32)
    f = np.where(usable[..., None], f, np.float32(0))
    a = cv2.merge([weight, weight * u, weight * v, f[..., 0], f[..., 1], weight * rho_a])
    b = cv2.merge([weight_b, weight_b * seen_rho])
    size = (w // cell, h // cell)
    area = float(cell * cell)
    # cv2.resize takes at most four channels on its fast path.
    return _Sums(np.concatenate([cv2.resize(np.ascontiguousarray(a[..., i:i + 3]), size,
                                            interpolation=cv2.INTER_AREA) for i in (0, 3)],
                                axis=-1).astype(np.float64) * area,
                 cv2.resize(b, size, interpolation=cv2.INTER_AREA).astype(np.float64) * area,
                 label)


def _matches(sums: _Sums, wanted: Array, cell_px: int, kind: int, config: GridConfig,
             noise: NoiseConfig) -> PointMatches:
    keep = wanted & (sums.label < 255) & (sums.a[..., 0] >= config.min_filled * cell_px**2)
    a, b = sums.a[keep], sums.b[keep]
    n = a[:, 0]
    mean = a[:, 1:] / n[:, None]
    count_b = b[:, 1 - 1]
    # Depth in b must be of nearly all the pixels, or its mean is of another place.
    known_b = count_b > 0.9 * n
    rho_b = np.where(known_b, b[:, 1] / np.maximum(count_b, 1.0), 0.0)
    sigma_rho = noise.inverse_depth_sigma / np.sqrt(n)
    variance = noise.flow_sigma_px**2 / n
    uv = mean[:, 0:2]
    return PointMatches(
        uv_a=uv, rho_a=mean[:, 4], rho_sigma_a=sigma_rho, uv_b=uv + mean[:, 2:4],
        flow_cov=variance[:, None, None] * np.eye(2), rho_b=rho_b,
        rho_sigma_b=np.where(known_b, sigma_rho, np.inf),
        group=sums.label[keep].astype(np.int64), kind=np.full(len(n), kind))
