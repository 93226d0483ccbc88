"""Outliers: channels whose innovation is larger than their noise explains are believed less.

With ``t = |y| / sqrt(S)`` the innovation of a channel in its own standard deviations,
Huber's influence function lets it count in full up to a limit c and no more than c beyond::

    w = min(1, c / t)                         weight
    R <- R + S (1 / w - 1)                    so that S becomes S / w; for a single channel
    K y = P H' S^-1 (w y)                     the correction of an innovation of c standard deviations

Widening the noise, rather than clipping the innovation, lets the covariance grow too: what was
hardly used has hardly informed. A single outlier moves the estimate by at most c standard
deviations' worth, however large it is.

c = 1.345 keeps 95 % of the efficiency for Gaussian noise; 3 touches 0.3 % of good samples.

Sources: Huber 1964, doi 10.1214/aoms/1177703732; equivalent weights on the noise of single
channels: Koch and Yang 1998, doi 10.1007/s001900050183.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.compiled import njit
from estimators.kernels import kalman_update
from estimators.linalg import Array, Mask


@njit(error_model="numpy")
def huber_weights(P: Array, y: Array, H: Array, R_diag: Array, mask: Mask, limit: float, out: Array) -> bool:
    """Fill ``out`` (m,) with each channel's weight ``min(1, limit / t)``; NaN where masked.

    Parameters
    ----------
    P, y, H, R_diag, mask : (n, n), (m,), (m, n), (m,), (m,) as in
        :func:`estimators.kernels.kalman_update`, at the prior.
    limit : Huber's c, in standard deviations of the innovation.

    Returns
    -------
    True when any channel is weighed down.

    Examples
    --------
    >>> import numpy as np
    >>> w = np.empty(2)
    >>> huber_weights(np.eye(1), np.array([10.0, 1.0]), np.ones((2, 1)), np.full(2, 3.0),
    ...               np.ones(2, bool), 2.0, w), w.tolist()
    (True, [0.4, 1.0])
    """
    n = P.shape[0]
    any_down = False
    for c in range(y.shape[0]):
        out[c] = np.nan
        if not mask[c]:
            continue
        s = R_diag[c]
        for i in range(n):
            if H[c, i] != 0.0:
                for j in range(n):
                    s += H[c, i] * P[i, j] * H[c, j]
        t = abs(y[c]) / math.sqrt(s) if s > 0.0 else 0.0
        out[c] = 1.0
        if t > limit:
            out[c] = limit / t
            any_down = True
    return any_down


@njit(error_model="numpy")
def widen_noise(P: Array, H: Array, R_diag: Array, weights: Array, out: Array) -> None:
    """Noise variances ``out = R + S (1 / w - 1)`` (m,) that give each channel its weight; NaN counts as 1."""
    n = P.shape[0]
    for c in range(R_diag.shape[0]):
        out[c] = R_diag[c]
        if weights[c] < 1.0:
            s = R_diag[c]
            for i in range(n):
                for j in range(n):
                    s += H[c, i] * P[i, j] * H[c, j]
            out[c] += s * (1.0 / weights[c] - 1.0)


@njit(error_model="numpy")
def robust_update(
    x: Array, P: Array, y: Array, H: Array, R_diag: Array, mask: Mask, limit: float, weights: Array
) -> tuple[float, float]:
    """Kalman update with independent channels that is robust against outliers, in place.

    Parameters
    ----------
    x, P, y, H, R_diag, mask : as in :func:`estimators.kernels.kalman_update`.
    limit : Huber's c, in standard deviations of the innovation; infinity gives ``kalman_update``.
    weights : (m,) filled as by :func:`huber_weights`.

    Returns
    -------
    nis, log_likelihood : as in ``kalman_update``, with the noise as given, not as widened: so
        an outlier shows there.

    Examples
    --------
    >>> import numpy as np
    >>> x, P, w = np.zeros(1), np.eye(1), np.empty(1)
    >>> nis, _ = robust_update(x, P, np.array([100.0]), np.eye(1), np.ones(1), np.ones(1, np.bool_), 2.0, w)
    >>> x.round(4).tolist(), round(nis), w.round(4).tolist()  # as for y = 2 sqrt(2)
    ([1.4142], 5000, [0.0283])
    """
    if not huber_weights(P, y, H, R_diag, mask, limit, weights):
        return kalman_update(x, P, y, H, R_diag, mask)
    R_wide = np.empty_like(R_diag)
    widen_noise(P, H, R_diag, weights, R_wide)
    x_plain = x.copy()
    P_plain = P.copy()
    nis, log_likelihood = kalman_update(x_plain, P_plain, y, H, R_diag, mask)
    kalman_update(x, P, y, H, R_wide, mask)
    return nis, log_likelihood
