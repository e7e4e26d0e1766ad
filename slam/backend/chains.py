"""Normal equations of landmarks that have one variable in every frame, eliminated along the chain.

In the paper's formulation a dynamic point or line is a chain of nodes, one a frame: each is seen
by that frame's camera, and tied to the next one by the object's motion. The chain's block is
block-tridiagonal; its inverse is made by recursion, and every pair of cameras and motions that
touch the chain is coupled through it. A static landmark is a chain of one node.
"""

from __future__ import annotations

import numba
import numpy as np


@numba.njit(cache=True)
def reduce_chains(chain, D, off, c, entry, node, variable, B, S, g):  # type: ignore[no-untyped-def]
    """Take chains out of S (6V, 6V) and g (6V,), to which all variables have added their own.

    Args:
        chain: (C + 1,) where each chain's nodes begin.
        D, off, c: (N, d, d) nodes' own blocks, blocks (node, node before), gradients (N, d).
        entry: (C + 1,) where each chain's couplings begin; sorted by node.
        node, variable: (E,) what a coupling ties; B: (E, d, 6) its block.
    """
    d = D.shape[1]
    T = np.empty((6, 6))
    for p in range(len(chain) - 1):
        first, last = chain[p], chain[p + 1]
        Z = _inverse(D[first:last], off[first:last])
        x = np.zeros((last - first, d))
        for a in range(last - first):
            for b in range(last - first):
                for i in range(d):
                    for j in range(d):
                        x[a, i] += Z[a, b, i, j] * c[first + b, j]
        for e in range(entry[p], entry[p + 1]):
            a, row = node[e] - first, 6 * variable[e]
            for k in range(6):
                for i in range(d):
                    g[row + k] -= B[e, i, k] * x[a, i]
            for f in range(e, entry[p + 1]):
                b, column = node[f] - first, 6 * variable[f]
                _couple(B[e], Z[a, b], B[f], T)
                for k in range(6):
                    for m in range(6):
                        S[row + k, column + m] -= T[k, m]
                        if e != f:
                            S[column + m, row + k] -= T[k, m]


@numba.njit(cache=True)
def _couple(left, Z, right, out):  # type: ignore[no-untyped-def]
    """Fill out (6, 6) with leftᵀ Z right, of (d, 6), (d, d), (d, 6)."""
    d = Z.shape[0]
    out[:] = 0.0
    for i in range(d):
        for m in range(6):
            total = 0.0
            for j in range(d):
                total += Z[i, j] * right[j, m]
            for k in range(6):
                out[k, m] += left[i, k] * total


@numba.njit(cache=True)
def chain_steps(chain, D, off, c, entry, node, variable, B, steps):  # type: ignore[no-untyped-def]
    """Steps (N, d) of the nodes that go with steps (V, 6) of cameras and motions."""
    out = np.zeros(c.shape)
    d = D.shape[1]
    for p in range(len(chain) - 1):
        first, last = chain[p], chain[p + 1]
        Z = _inverse(D[first:last], off[first:last])
        b = c[first:last].copy()
        for e in range(entry[p], entry[p + 1]):
            for i in range(d):
                for k in range(6):
                    b[node[e] - first, i] += B[e, i, k] * steps[variable[e], k]
        for a in range(last - first):
            for other in range(last - first):
                for i in range(d):
                    for j in range(d):
                        out[first + a, i] -= Z[a, other, i, j] * b[other, j]
    return out


@numba.njit(cache=True)
def _inverse(D, off):  # type: ignore[no-untyped-def]
    """All blocks (n, n, d, d) of the inverse of a symmetric block-tridiagonal matrix."""
    n, d = D.shape[0], D.shape[1]
    Z, pivot = np.zeros((n, n, d, d)), np.empty((n, d, d))
    pivot[0] = np.linalg.inv(D[0])
    for a in range(1, n):
        left = np.ascontiguousarray(off[a])
        pivot[a] = np.linalg.inv(D[a] - left @ pivot[a - 1] @ np.ascontiguousarray(left.T))
    Z[n - 1, n - 1] = pivot[n - 1]
    for a in range(n - 2, -1, -1):
        K = pivot[a] @ np.ascontiguousarray(off[a + 1].T)
        for b in range(a + 1, n):
            for i in range(d):
                for j in range(d):
                    total = 0.0
                    for k in range(d):
                        total += K[i, k] * Z[a + 1, b, k, j]
                    Z[a, b, i, j] = -total
                    Z[b, a, j, i] = -total
        for i in range(d):
            for j in range(d):
                total = pivot[a, i, j]
                for k in range(d):
                    total -= K[i, k] * Z[a + 1, a, k, j]
                Z[a, a, i, j] = total
    return Z
