"""Line band descriptors (Zhang and Koch 2013), as cv2's BinaryDescriptor computes them.

The neighbourhood of a segment is cut into bands along it. Of each band four sums over the pixels'
gradients are taken, to both senses along and across the segment, with their spread over the band's
rows; two bands compared in these eight numbers give a byte. Compiled here, since cv2's
takes four times as long.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np

from slam.geometry.arrays import Array

_BANDS, _WIDTH = 9, 7                # rows of pixels to each band
_ROWS = _BANDS * _WIDTH
_LARGEST = 0.4                       # of an element: less weight to non-linear lighting
_LONGEST = 2800                      # px of a segment, about its middle; the sums stay in 32 bits
# Bands that are compared: all pairs but those farthest apart, which makes 32.
_PAIRS = np.array([(a, b) for a in range(_BANDS) for b in range(a + 1, _BANDS)
                   if (a, b) not in ((0, 7), (0, 8), (1, 7), (1, 8))])


def describe_lines(gray: Array, ends_px: Array) -> Array:
    """(L, 32) uint8 descriptors of segments (L, 2, 2) in an image (H, W) uint8.

    A segment and its reverse have different ones.
    """
    smooth = cv2.GaussianBlur(gray, (5, 5), 1.0)
    rows = _row_sums(cv2.Sobel(smooth, cv2.CV_16S, 1, 0), cv2.Sobel(smooth, cv2.CV_16S, 0, 1),
                     np.ascontiguousarray(ends_px, dtype=np.float64))
    return _bits(rows)


@numba.njit(cache=True, nogil=True)
def _row_sums(gu, gv, ends):  # type: ignore[no-untyped-def]
    """(L, rows, 4): the gradients' positive and negative parts along and across segments.

    Beyond the image its border repeats. In integers, which processors add several at a time:
    positions in 2⁻¹⁶ px, directions in 2⁻⁹.
    """
    n, right, low = len(ends), np.int32(gu.shape[1] - 1), np.int32(gu.shape[0] - 1)
    out = np.zeros((n, _ROWS, 4))
    zero, binary = np.int32(0), np.int32(16)
    for i in range(n):
        du, dv = ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1]
        length = max(np.hypot(du, dv), 1e-9)
        cosine, sine = du / length, dv / length
        pixels = min(int(max(abs(du), abs(dv))) + 1, _LONGEST)
        reach, above = (pixels - 1) // 2, (_ROWS - 1) // 2
        u = np.int32((0.5 * (ends[i, 0, 0] + ends[i, 1, 0]) - cosine * reach + sine * above + 0.5)
                     * 65536.0)
        v = np.int32((0.5 * (ends[i, 0, 1] + ends[i, 1, 1]) - sine * reach - cosine * above + 0.5)
                     * 65536.0)
        step_u, step_v = np.int32(round(cosine * 65536.0)), np.int32(round(sine * 65536.0))
        c, s = np.int32(round(cosine * 512.0)), np.int32(round(sine * 512.0))
        for row in range(_ROWS):
            ahead, back, left_of, right_of = zero, zero, zero, zero
            for k in range(pixels):
                x = min(max((u + np.int32(k) * step_u) >> binary, zero), right)
                y = min(max((v + np.int32(k) * step_v) >> binary, zero), low)
                gx, gy = np.int32(gu[y, x]), np.int32(gv[y, x])
                along, across = np.int32(gx * c + gy * s), np.int32(gy * c - gx * s)
                ahead += max(along, zero)
                back -= min(along, zero)
                left_of += max(across, zero)
                right_of -= min(across, zero)
            out[i, row, 0], out[i, row, 1] = ahead, back
            out[i, row, 2], out[i, row, 3] = left_of, right_of
            u -= step_v
            v += step_u
    return out


def _bits(rows: Array) -> Array:
    """(L, 32) uint8 from the sums of the rows (L, rows, 4)."""
    rows = rows * _global_weight()[:, None]
    weight = _band_weights()
    pixels = np.where((np.arange(_BANDS) % (_BANDS - 1)) == 0, 2.0, 3.0)[:, None] * _WIDTH
    mean = weight @ rows / pixels                                            # (L, bands, 4)
    spread = np.sqrt(np.maximum(weight**2 @ rows**2 / pixels - mean**2, 0.0))
    whole = np.concatenate([_unit(mean), _unit(spread)], axis=2)             # (L, bands, 8)
    whole = np.minimum(whole, _LARGEST)
    greater = whole[:, _PAIRS[:, 0]] > whole[:, _PAIRS[:, 1]]                # (L, 32, 8)
    return np.packbits(greater, axis=2, bitorder="little")[:, :, 0]


def _unit(values: Array) -> Array:
    """(L, bands, 4) with a norm of 1 for each segment; one without any gradient stays 0."""
    norm = np.sqrt(np.sum(values**2, axis=(1, 2), keepdims=True))
    return values / np.maximum(norm, 1e-12)


def _global_weight() -> Array:
    """(rows,) a Gaussian across the whole neighbourhood."""
    middle = (_ROWS - 1) // 2
    return np.exp(-0.5 * ((np.arange(_ROWS) - middle) / middle) ** 2)


def _band_weights() -> Array:
    """(bands, rows) a Gaussian across each band and its neighbours: no hard borders."""
    middle = (np.arange(_BANDS) + 0.5) * _WIDTH - 0.5
    off = np.arange(_ROWS) - middle[:, None]
    near = np.abs(off) <= 1.5 * _WIDTH
    return np.where(near, np.exp(-0.5 * (off / _WIDTH) ** 2), 0.0)
