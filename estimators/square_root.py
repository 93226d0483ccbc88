"""Covariances kept as factors, ``P = U diag(D) U'``: positive by construction, whatever the scales.

In double precision an update cannot shrink a variance by more than some fifteen decades: what is
left is the difference of large numbers, and rounding decides its sign, in the Joseph form too.
That happens where a near-perfect channel sees a *sum* of states, or meets a diffuse prior: two exact
positions then give the speed as a difference. (Units of states and channels are no such case:
they cancel.) The factors resolve twice as many decades, and beyond those err on the positive side:
``U`` (n, n) is unit upper triangular, ``D`` (n,) never negative, because only sums and quotients of
positive numbers are formed.

* update: Bierman 1976, Automatica 12(4), 375-382, doi 10.1016/0005-1098(76)90057-8
* prediction: Thornton's modified weighted Gram-Schmidt, in Bierman 1977, Factorization Methods
  for Discrete Sequential Estimation, Academic Press, ch. VI

Compiled, in place, C-contiguous ``float64``, as :mod:`estimators.kernels`, which names the symbols.
"""

from __future__ import annotations

import numpy as np

from estimators.compiled import njit
from estimators.kernels import channel_likelihood
from estimators.linalg import PIVOT_FLOOR, Array, Mask, apply_gain, decorrelate, innovation_after


@njit(error_model="numpy")
def ud_factors(P: Array, U: Array, D: Array) -> bool:
    """Factor a covariance: ``P = U diag(D) U'``.

    Parameters
    ----------
    P : (n, n) symmetric, positive semi-definite to rounding. Not changed.
    U, D : (n, n), (n,) results. Pivots below rounding are set to 0.

    Returns
    -------
    False when a pivot is negative beyond rounding: then P is no covariance.

    Examples
    --------
    >>> import numpy as np
    >>> U, D = np.empty((2, 2)), np.empty(2)
    >>> ud_factors(np.array([[3.0, 2.0], [2.0, 2.0]]), U, D), U.tolist(), D.tolist()
    (True, [[1.0, 1.0], [0.0, 1.0]], [1.0, 2.0])
    """
    n = P.shape[0]
    positive = True
    for j in range(n - 1, -1, -1):
        for i in range(j, -1, -1):
            total = P[i, j]
            for k in range(j + 1, n):
                total -= U[i, k] * D[k] * U[j, k]
            if i == j:
                floor = n * PIVOT_FLOOR * P[j, j]
                if total < -floor:
                    positive = False
                D[j] = total if total > floor else 0.0
                U[j, j] = 1.0
            else:
                U[j, i] = 0.0
                U[i, j] = total / D[j] if D[j] > 0.0 else 0.0
    return positive


@njit(error_model="numpy")
def ud_covariance(U: Array, D: Array, P: Array) -> None:
    """Fill ``P = U diag(D) U'``, exactly symmetric."""
    n = D.shape[0]
    for i in range(n):
        for j in range(i, n):
            total = 0.0
            for k in range(j, n):
                total += U[i, k] * D[k] * U[j, k]
            P[i, j] = total
            P[j, i] = total


@njit(error_model="numpy")
def weighted_gram_schmidt(W: Array, weights: Array, U: Array, D: Array) -> None:
    """Factors of ``W diag(weights) W'``, without forming it: rows of ``W`` made orthogonal, last first.

    Parameters
    ----------
    W : (n, k) overwritten.
    weights : (k,) >= 0.
    U, D : (n, n), (n,) results.

    Examples
    --------
    >>> import numpy as np
    >>> U, D = np.empty((1, 1)), np.empty(1)
    >>> weighted_gram_schmidt(np.array([[1.0, 2.0]]), np.array([3.0, 1.0]), U, D)
    >>> D.tolist()
    [7.0]
    """
    n, columns = W.shape
    scaled = np.empty(columns)
    for j in range(n - 1, -1, -1):
        total = 0.0
        for k in range(columns):
            scaled[k] = weights[k] * W[j, k]
            total += W[j, k] * scaled[k]
        D[j] = total
        U[j, j] = 1.0
        for i in range(j):
            U[j, i] = 0.0
            dot = 0.0
            for k in range(columns):
                dot += W[i, k] * scaled[k]
            factor = dot / total if total > 0.0 else 0.0
            U[i, j] = factor
            for k in range(columns):
                W[i, k] -= factor * W[j, k]


@njit(error_model="numpy")
def ud_predict(U: Array, D: Array, F: Array, Q_diag: Array) -> None:
    """Carry the factors over one step: those of ``F P F' + diag(Q_diag)``, in place.

    Examples
    --------
    >>> import numpy as np
    >>> U, D, P = np.eye(2), np.ones(2), np.empty((2, 2))
    >>> ud_predict(U, D, np.array([[1.0, 0.5], [0.0, 1.0]]), np.array([0.0, 0.1]))
    >>> ud_covariance(U, D, P)
    >>> P.round(6).tolist()
    [[1.25, 0.5], [0.5, 1.1]]
    """
    n = D.shape[0]
    W = np.zeros((n, 2 * n))
    weights = np.empty(2 * n)
    for i in range(n):
        for k in range(n):
            f = F[i, k]
            if f != 0.0:
                for j in range(k, n):
                    W[i, j] += f * U[k, j]
        W[i, n + i] = 1.0
        weights[i] = D[i]
        weights[n + i] = Q_diag[i]
    weighted_gram_schmidt(W, weights, U, D)


@njit(error_model="numpy")
def ud_scalar_update(U: Array, D: Array, h: Array, r: float, k: Array, f: Array) -> float:
    """Let one scalar channel ``h`` (n,) of variance ``r`` shrink the factors, in place (Bierman).

    Fills the gain ``k = P h' / s`` (n,); ``f`` (n,) is scratch. Returns ``s = h P h' + r``;
    when that is zero the channel can tell nothing, and ``k`` is zero.
    """
    n = D.shape[0]
    for j in range(n):
        total = h[j]
        for i in range(j):
            total += U[i, j] * h[i]
        f[j] = total
    s = r
    for j in range(n):
        g = D[j] * f[j]
        before = s
        s += f[j] * g
        k[j] = g
        if s <= 0.0:
            continue
        D[j] *= before / s
        slope = -f[j] / before if before > 0.0 else 0.0
        for i in range(j):
            old = U[i, j]
            U[i, j] = old + k[i] * slope
            k[i] += g * old
    for i in range(n):
        k[i] = k[i] / s if s > 0.0 else 0.0
    return s


@njit(error_model="numpy")
def ud_update(
    x: Array, U: Array, D: Array, y: Array, H: Array, R_diag: Array, mask: Mask
) -> tuple[float, float]:
    """Kalman update with independent channels, in place, on factors.

    As :func:`estimators.kernels.kalman_update`, with ``U`` (n, n) and ``D`` (n,) for ``P``.

    Examples
    --------
    >>> import numpy as np
    >>> x, U, D = np.zeros(2), np.eye(2), np.ones(2)
    >>> nis, _ = ud_update(x, U, D, np.array([2.0, np.nan]), np.eye(2), np.ones(2), np.array([True, False]))
    >>> nis, x.tolist(), D.tolist()
    (2.0, [1.0, 0.0], [0.5, 1.0])
    """
    n = x.shape[0]
    nis = 0.0
    log_likelihood = 0.0
    shift = np.zeros(n)  # x - prior: later channels see what earlier ones corrected
    k = np.empty(n)
    f = np.empty(n)
    for c in range(y.shape[0]):
        if not mask[c]:
            continue
        s = ud_scalar_update(U, D, H[c], R_diag[c], k, f)
        e = y[c]
        for i in range(n):
            e -= H[c, i] * shift[i]
        squared, likelihood = channel_likelihood(e, s)
        nis += squared
        log_likelihood += likelihood
        for i in range(n):
            shift[i] += k[i] * e
    for i in range(n):
        x[i] += shift[i]
    return nis, log_likelihood


@njit(error_model="numpy")
def ud_update_correlated(
    x: Array, U: Array, D: Array, y: Array, H: Array, R: Array, K: Array
) -> tuple[float, float]:
    """Kalman update with a full ``R`` (m, m), in place, on factors; all channels are used.

    As :func:`estimators.kernels.kalman_update_correlated`, with ``U`` and ``D`` for ``P``.
    """
    n = x.shape[0]
    m = y.shape[0]
    yd, Hd, Rd, L = y.copy(), H.copy(), R.copy(), np.zeros((m, m))
    decorrelate(yd, Hd, Rd, L)
    nis = 0.0
    log_likelihood = 0.0
    k = np.empty(n)
    f = np.empty(n)
    for c in range(m):
        s = ud_scalar_update(U, D, Hd[c], Rd[c, c], k, f)
        e = innovation_after(K, k, Hd[c], yd, c)
        squared, likelihood = channel_likelihood(e, s)
        nis += squared
        log_likelihood += likelihood
    apply_gain(x, K, L, y)
    return nis, log_likelihood


@njit(error_model="numpy")
def ud_transform(U: Array, D: Array, A: Array, B: Array, C: Array) -> bool:
    """Factors of ``A P A' + B C B'``, in place.

    Parameters
    ----------
    U, D : (n, n), (n,) factors of P on entry, of the result on return.
    A : (n, n), e.g. a transition, or ``I - K H`` for the Joseph form of any gain.
    B, C : (n, k), (k, k) covariance, e.g. the identity and Q, or K and R.

    Returns
    -------
    False when ``C`` is no covariance; the factors are unchanged then.
    """
    n = D.shape[0]
    m = C.shape[0]
    UC, DC = np.empty((m, m)), np.empty(m)
    if not ud_factors(C, UC, DC):
        return False
    W = np.zeros((n, n + m))
    weights = np.empty(n + m)
    for i in range(n):
        for k in range(n):
            for j in range(k, n):
                W[i, j] += A[i, k] * U[k, j]
        for k in range(m):
            for j in range(k, m):
                W[i, n + j] += B[i, k] * UC[k, j]
    weights[:n] = D
    weights[n:] = DC
    weighted_gram_schmidt(W, weights, U, D)
    return True
