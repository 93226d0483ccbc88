"""Compiled small-matrix algebra for the filters: symmetric products and triangular factors.

Plain loops: at the size of a filter (up to some sixteen states) they beat a call to
LAPACK, and they need no workspace.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators.compiled import njit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A pivot this small, as a share of its diagonal element, is rounding and not information.
PIVOT_FLOOR = 1e-13


@njit()
def symmetrise(P: Array) -> None:
    """Average ``P`` with its transpose, in place."""
    n = P.shape[0]
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = mean
            P[j, i] = mean


@njit()
def project(P: Array, H: Array, PHt: Array, HPHt: Array) -> None:
    """Fill ``PHt = P H'`` (n, m) and ``HPHt = H P H'`` (m, m), the latter exactly symmetric."""
    n, m = P.shape[0], H.shape[0]
    for i in range(n):
        for c in range(m):
            total = 0.0
            for j in range(n):
                total += P[i, j] * H[c, j]
            PHt[i, c] = total
    for c in range(m):
        for d in range(c, m):
            total = 0.0
            for j in range(n):
                total += H[c, j] * PHt[j, d]
            HPHt[c, d] = total
            HPHt[d, c] = total


@njit()
def joseph_update(P: Array, K: Array, H: Array, R: Array) -> None:
    """Posterior covariance of *any* gain, in place: ``(I - K H) P (I - K H)' + K R K'``.

    Examples
    --------
    >>> import numpy as np
    >>> P = np.eye(1)
    >>> joseph_update(P, np.array([[0.25]]), np.eye(1), np.array([[2.0]]))
    >>> P.item()
    0.6875
    """
    n, m = K.shape
    A, AP, KR = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, m))
    for i in range(n):
        A[i, i] = 1.0
        for c in range(m):
            for j in range(n):
                A[i, j] -= K[i, c] * H[c, j]
            for d in range(m):
                KR[i, d] += K[i, c] * R[c, d]
        for k in range(n):
            for j in range(n):
                AP[i, j] += A[i, k] * P[k, j]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += AP[i, k] * A[j, k]
            for c in range(m):
                total += KR[i, c] * K[j, c]
            P[i, j] = total
    symmetrise(P)


@njit()
def cholesky(A: Array, L: Array) -> bool:
    """Lower factor of ``A = L L'`` into ``L``; False when ``A`` is not positive to rounding."""
    n = A.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > PIVOT_FLOOR * A[i, i]:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@njit()
def cholesky_solve(L: Array, b: Array) -> None:
    """Solve ``L L' w = b`` for each row of ``b`` (k, m), in place."""
    rows, m = b.shape
    for row in range(rows):
        for i in range(m):
            for k in range(i):
                b[row, i] -= L[i, k] * b[row, k]
            b[row, i] /= L[i, i]
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                b[row, i] -= L[k, i] * b[row, k]
            b[row, i] /= L[i, i]


@njit()
def decorrelate(W: Array, H: Array, R: Array, mask: Mask) -> None:
    """Make the channels of `mask` independent: with ``R = L D L'``, replace ``W, H`` by ``L^-1 W, L^-1 H``.

    ``D`` is left on the diagonal of ``R``. A semi-definite ``R`` (noise-free combinations) is allowed.
    """
    m = R.shape[0]
    L = np.eye(m)
    for c in range(m):
        if not mask[c]:
            continue
        variance = R[c, c]
        for d in range(c):
            if not mask[d]:
                continue
            L[c, d] = R[c, d]
            for k in range(d):
                if mask[k]:
                    L[c, d] -= L[c, k] * L[d, k] * R[k, k]
            L[c, d] = L[c, d] / R[d, d] if R[d, d] > 0.0 else 0.0
            variance -= L[c, d] * L[c, d] * R[d, d]
            for i in range(m):
                W[c, i] -= L[c, d] * W[d, i]
            for i in range(H.shape[1]):
                H[c, i] -= L[c, d] * H[d, i]
        R[c, c] = variance if variance > PIVOT_FLOOR * R[c, c] else 0.0
