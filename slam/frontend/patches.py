"""Square image patches at sub-pixel positions.

Images are interpolated by cubic B-splines (Unser 1999), whose phase error at the frequencies of
sharp texture is a tenth of Catmull–Rom's. All pixels of a patch have the same fraction of a
pixel, so a patch is a window of whole pixels and one separable kernel of four taps.
"""

from __future__ import annotations

import cv2
import numba
import numpy as np

from slam.geometry.arrays import Array


def fits(uv_px: Array, shape: tuple[int, ...], radius: int) -> Array:
    """(N,) bool: the patch of that radius and its kernel lie wholly inside the image."""
    return np.asarray(_all_fit(np.asarray(uv_px, np.float64), shape[0], shape[1], radius))


@numba.njit(cache=True, nogil=True)
def _all_fit(uv, height, width, radius):  # type: ignore[no-untyped-def]
    out = np.empty(len(uv), np.bool_)
    for n in range(len(uv)):
        out[n] = patch_fits(uv[n], (height, width), radius)
    return out


@numba.njit(cache=True, nogil=True)
def patch_fits(uv, shape, radius):  # type: ignore[no-untyped-def]
    """`fits` for one position."""
    u, v = uv[0], uv[1]
    low = radius + 1.0
    return (low <= u < shape[1] - radius - 2.0) and (low <= v < shape[0] - radius - 2.0)


def spline_image(gray: Array, blur_sigma_px: float) -> Array:
    """(H, W) float32 coefficients of the cubic spline through the blurred image.

    Args:
        gray: (H, W) uint8 or float.
        blur_sigma_px: of a Gaussian on the image; 0: none.
    """
    kernel = _spline_prefilter()
    if blur_sigma_px > 0:
        reach = int(np.ceil(3.0 * blur_sigma_px))
        blur = np.exp(-0.5 * (np.arange(-reach, reach + 1) / blur_sigma_px) ** 2)
        # The prefilter's tails meet the blur and vanish: past its reach little is left.
        kernel = np.convolve(kernel, blur / blur.sum(), mode="same")
        kernel /= kernel.sum()
    return np.asarray(cv2.sepFilter2D(gray, cv2.CV_32F, kernel, kernel,
                                      borderType=cv2.BORDER_REFLECT_101))


def _spline_prefilter() -> Array:
    """Inverse of the sampled cubic B-spline (1, 4, 1)/6: a two-sided power of √3 − 2."""
    pole = np.sqrt(3.0) - 2.0
    reach = 5   # what is cut off is 4e-4 of the whole
    kernel = pole ** np.abs(np.arange(-reach, reach + 1))
    return np.asarray(kernel / kernel.sum())


@numba.njit(cache=True, nogil=True, inline="always")
def _weights(f):  # type: ignore[no-untyped-def]
    """Weights of the coefficients at −1, 0, 1, 2 for a fraction in [0, 1), float32."""
    f = np.float32(f)
    one, half, sixth = np.float32(1.0), np.float32(0.5), np.float32(1.0 / 6.0)
    middle = np.float32(2.0 / 3.0)
    g = one - f
    return (sixth * g * g * g, middle - half * f * f * (one + g),
            middle - half * g * g * (one + f), sixth * f * f * f)


@numba.njit(cache=True, nogil=True, inline="always")
def _slopes(f):  # type: ignore[no-untyped-def]
    """Derivatives of `_weights`."""
    f = np.float32(f)
    one, half, three, four = np.float32(1.0), np.float32(0.5), np.float32(3.0), np.float32(4.0)
    g = one - f
    return (-half * g * g, half * f * (three * f - four), half * g * (four - three * g),
            half * f * f)


@numba.njit(cache=True, nogil=True)
def cut_patch(spline, uv, radius, room, out):  # type: ignore[no-untyped-def]
    """One patch around a position that `patch_fits`.

    Args:
        spline: (H, W) float32 from `spline_image`.
        uv: (2,).
        room: (2, side, side + 3) float32 to work in, side = 2 radius + 1.
        out: (side²,) float32, filled.
    """
    column, row = int(np.floor(uv[0])), int(np.floor(uv[1]))
    _down(spline, row - radius - 1, column - radius - 1, _weights(uv[1] - row), room[0])
    _across(room[0], _weights(uv[0] - column), out)


@numba.njit(cache=True, nogil=True)
def cut_patch_and_slopes(spline, uv, radius, room, out):  # type: ignore[no-untyped-def]
    """As `cut_patch`, into (3, side²): the spline's derivatives in u and v, and its values.

    Exact derivatives: differences of neighbouring pixels are 12 % short on sharp texture, by
    which every Gauss–Newton step would be too long.
    """
    column, row = int(np.floor(uv[0])), int(np.floor(uv[1]))
    top, left = row - radius - 1, column - radius - 1
    _down(spline, top, left, _weights(uv[1] - row), room[0])
    _down(spline, top, left, _slopes(uv[1] - row), room[1])
    _across(room[0], _slopes(uv[0] - column), out[0])
    _across(room[1], _weights(uv[0] - column), out[1])
    _across(room[0], _weights(uv[0] - column), out[2])


@numba.njit(cache=True, nogil=True)
def _down(spline, top, left, weights, rows):  # type: ignore[no-untyped-def]
    w0, w1, w2, w3 = weights
    for i in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            v, u = top + i, left + j
            rows[i, j] = (w0 * spline[v, u] + w1 * spline[v + 1, u]
                          + w2 * spline[v + 2, u] + w3 * spline[v + 3, u])


@numba.njit(cache=True, nogil=True)
def _across(rows, weights, out):  # type: ignore[no-untyped-def]
    w0, w1, w2, w3 = weights
    side = rows.shape[0]
    for i in range(side):
        for j in range(side):
            out[i * side + j] = (w0 * rows[i, j] + w1 * rows[i, j + 1]
                                 + w2 * rows[i, j + 2] + w3 * rows[i, j + 3])
