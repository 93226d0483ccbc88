"""Compiled filter arithmetic: what a loop over millions of samples calls.

Arrays are C-contiguous ``float64`` (``bool`` for masks), and nothing is checked: the classes in
:mod:`estimators.ekf` and :mod:`estimators.svsf` do. Scalar updates and unpivoted Cholesky factors commute
with a change of units, so raw SI (metres beside pascals) costs no digits. The Joseph form holds as long as no
update shrinks a variance by more than 13 decades.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.compiled import njit
from estimators.linalg import Array, Mask, cholesky, cholesky_solve, decorrelate, symmetrise

LOG_2PI = math.log(2.0 * math.pi)
# Share of R that breaks the tie between channels that measure the same thing.
TIE_BREAK = 1e-6


@njit()
def scalar_update(P: Array, h: Array, r: float, k: Array, Ph: Array) -> float:
    """Let one scalar channel ``h`` (n,) of variance ``r`` shrink ``P``, in place, in Joseph form.

    Fills the gain ``k = P h' / s`` (n,); ``Ph`` (n,) is scratch. Returns ``s = h P h' + r``;
    when that is zero the channel can tell nothing, and ``k`` is zero.
    """
    n = P.shape[0]
    s = r
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += P[i, j] * h[j]
        Ph[i] = total
        s += h[i] * total
    if s <= 0.0:
        k[:] = 0.0
        return 0.0
    for i in range(n):
        k[i] = Ph[i] / s
    for i in range(n):  # left factor (I - k h) P, then the right one row by row, and k r k'
        total = 0.0
        for j in range(n):
            P[i, j] -= k[i] * Ph[j]
            total += P[i, j] * h[j]
        for j in range(n):
            P[i, j] += (k[i] * r - total) * k[j]
    symmetrise(P)
    return s


@njit()
def kalman_update_correlated(
    x: Array, P: Array, y: Array, H: Array, R: Array, mask: Mask, K: Array
) -> tuple[float, float]:
    """Kalman update of ``x`` (n,) and ``P`` (n, n), in place, one channel after the other.

    The channels are made independent first (:func:`decorrelate`). Each is then a scalar update in Joseph
    form, so no matrix is inverted and ``P`` stays symmetric and positive (Bierman 1977, Factorization Methods
    for Discrete Sequential Estimation, ch. II).

    ``y`` (m,) is the innovation and ``H`` (m, n) the Jacobian at the prior, ``R`` (m, m) the noise; ``mask``
    (m,) is False for a channel to skip, whose ``y`` may be NaN. ``K`` (n, m) is filled with the gain for the
    original channels, zero where masked.

    Returns the normalised innovation squared ``y' S^-1 y`` of the channels used, chi-square with as many
    degrees of freedom when the filter is consistent, infinite when a channel that can have no error
    (``h P h' + r = 0``) has one; and ``log N(y; 0, S)`` of them, 0 when there are none.

    Examples
    --------
    >>> import numpy as np
    >>> x, P, K = np.zeros(1), np.eye(1), np.empty((1, 2))
    >>> R, both = np.array([[1.0, 0.5], [0.5, 1.0]]), np.ones(2, bool)
    >>> nis, _ = kalman_update_correlated(x, P, np.array([1.0, 1.0]), np.ones((2, 1)), R, both, K)
    >>> K.round(4).tolist(), round(P.item(), 4), round(nis, 4)
    ([[0.2857, 0.2857]], 0.4286, 0.5714)
    """
    n, m = x.shape[0], y.shape[0]
    Hd, D = H.copy(), R.copy()
    W = np.eye(m)  # the independent channels, as combinations of the original ones
    decorrelate(W, Hd, D, mask)
    nis, log_likelihood = 0.0, 0.0
    Ph, k, e_of_y = np.empty(n), np.empty(n), np.empty(m)
    K[:, :] = 0.0
    for c in range(m):
        if not mask[c]:
            continue
        s = scalar_update(P, Hd[c], D[c, c], k, Ph)
        e = 0.0
        for d in range(c + 1):  # what this channel says beyond the earlier ones
            e_of_y[d] = W[c, d]
            for i in range(n):
                e_of_y[d] -= Hd[c, i] * K[i, d]
            if mask[d]:
                e += e_of_y[d] * y[d]
        for i in range(n):
            for d in range(c + 1):
                K[i, d] += k[i] * e_of_y[d]
        if s > 0.0:
            nis += e * e / s
            log_likelihood -= 0.5 * (LOG_2PI + math.log(s) + e * e / s)
        elif e != 0.0:
            nis, log_likelihood = np.inf, -np.inf
    for i in range(n):
        for d in range(m):
            if mask[d]:
                x[i] += K[i, d] * y[d]
    return nis, log_likelihood


@njit()
def svsf_gain(
    PHt: Array, HPHt: Array, R: Array, e: Array, e_post: Array, gamma: float, psi: Array, variable: bool,
    K: Array, psi_k: Array, outside: Mask,
) -> bool:  # fmt: skip
    """Gain of the SVSF (:mod:`estimators.svsf`), fewer channels than states allowed.

    ``K = H+ diag(r)``, ``r = E / psi`` inside the layer (``|e| <= psi``) and ``E / |e|`` outside. The term
    ``(I - H+ H) K_ekf e`` of published forms is zero identically, since ``H+ H K_ekf = K_ekf``: what an EKF
    would tell the unmeasured states arrives through the cross-covariances in ``H+``.

    Channels that measure the same combination of states make ``H P H'`` singular; then a
    share :data:`TIE_BREAK` of ``R`` is added to it, which weighs them by their noise.

    ``PHt`` (n, m) and ``HPHt`` (m, m) are those of :func:`estimators.linalg.project`; ``R`` (m, m) is the
    noise, ``e`` and ``e_post`` (m,) the innovation and the posterior error of the step before, ``psi`` (m,)
    the boundary layer (> 0), ``gamma`` the memory. ``variable`` asks for the Kalman gain as long as every
    ``psi_k <= psi``. Fills the gain ``K`` (n, m), the diagonal ``psi_k`` (m,) of the optimal layer, and
    ``outside`` (m,), ``|e| > psi``.

    Returns False where the Kalman gain is to be used and ``K`` is not filled: inside the limit, or with no
    noise and no uncertainty in ``H P H'``.
    """
    n, m = PHt.shape
    L, S = np.zeros((m, m)), HPHt + R
    solvable = cholesky(HPHt, L) or cholesky(HPHt + TIE_BREAK * R, L)
    exceeded = False
    if solvable:
        cholesky_solve(L, S)  # rows of S (H P H')^-1, which is symmetric
    for c in range(m):
        size = abs(e[c]) + gamma * abs(e_post[c])
        psi_k[c] = S[c, c] * size if solvable else np.inf
        outside[c] = abs(e[c]) > psi[c]
        if psi_k[c] > psi[c]:
            exceeded = True
    if not solvable or (variable and not exceeded):
        return False
    K[:, :] = PHt
    cholesky_solve(L, K)
    for c in range(m):
        size = abs(e[c]) + gamma * abs(e_post[c])
        ratio = size / abs(e[c]) if outside[c] else size / psi[c]
        for i in range(n):
            K[i, c] *= ratio
    return True
