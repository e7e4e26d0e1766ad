"""Small pieces of many pictures kept in one, so that patches of all of them align in one call."""

from __future__ import annotations

import numpy as np

from slam.geometry.arrays import Array

_ACROSS = 32      # pieces in a row


class Atlas:
    """Square pieces cut from prepared images; their memory is as large as the most at one time."""

    def __init__(self, radius_px: int) -> None:
        """For patches of this radius, with what their interpolation reads around them."""
        self._before = radius_px + 2                     # pixels before the middle one
        self.side = 2 * radius_px + 5
        self.image = np.zeros((0, _ACROSS * self.side), np.float32)
        self._free = np.zeros(0, np.int64)

    def put(self, image: Array, uv_px: Array) -> Array:
        """Keep the pieces of an image around positions (N, 2) well inside it; their slots (N,)."""
        n = len(uv_px)
        while len(self._free) < n:
            self._grow()
        slots, self._free = self._free[:n], self._free[n:]
        corner = np.floor(uv_px).astype(np.intp) - self._before
        offset = np.arange(self.side)
        rows, columns = corner[:, 1, None] + offset, corner[:, 0, None] + offset
        pieces = self.image.reshape(-1, self.side, _ACROSS, self.side)
        pieces[slots // _ACROSS, :, slots % _ACROSS] = image[rows[:, :, None], columns[:, None]]
        return slots

    def positions(self, slots: Array, uv_px: Array) -> Array:
        """(N, 2): where in `image` the positions lie around which pieces were kept."""
        corner = np.stack([slots % _ACROSS, slots // _ACROSS], axis=-1) * self.side
        return np.asarray(corner + self._before + (uv_px - np.floor(uv_px)))

    def release(self, slots: Array) -> None:
        """Let pieces go; their slots are used again."""
        self._free = np.concatenate([self._free, slots])

    def _grow(self) -> None:
        rows = len(self.image) // self.side
        more = max(rows, 8)
        self._free = np.concatenate([self._free, np.arange(rows * _ACROSS,
                                                           (rows + more) * _ACROSS)])
        self.image = np.concatenate([self.image, np.zeros((more * self.side, self.image.shape[1]),
                                                          np.float32)])
