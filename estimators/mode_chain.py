"""The chain that the modes of a plant move by: transition probabilities, and what counts as such."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from estimators.imm_kernels import transitions_over
from estimators.linalg import Array


def transition_matrix(sojourn: ArrayLike, dt: float, share: ArrayLike | None = None) -> Array:
    """Mode transition probabilities of a step from how long the plant stays in each mode.

    The modes are a Markov chain in continuous time: mode i is left at the rate ``1/sojourn_i``.
    Hence ``M_ii = 1 - dt/sojourn_i`` for short steps, steps of any length agree with each other
    (``M(a) M(b) = M(a + b)``), and a long gap leads to the long-run shares of the modes.

    Parameters
    ----------
    sojourn : (r,) s, mean time in each mode before it is left; infinity for a fault that stays.
    dt : s, length of the step.
    share : (r, r) where mode i goes when it is left: row i, relative, the diagonal is ignored.
        None: to all others alike.

    Returns
    -------
    (r, r) array; ``M[i, j]`` is the probability of going from i to j, rows sum to 1.

    Raises
    ------
    ValueError : a time that is not positive, shares that are negative or of another shape.

    Notes
    -----
    0.98 on the diagonal, usual in tracking, means 50 ms at 1 kHz: far too short for wear. Choose
    the sojourn time by the plant; the odds that data must bring up before the bank
    changes its mind are about ``sojourn/dt``.

    Examples
    --------
    Healthy for an hour, a fault for ever:

    >>> transition_matrix([3600.0, np.inf], dt=1e-3).round(10).tolist()
    [[0.9999997222, 2.778e-07], [0.0, 1.0]]
    """
    times = np.asarray(sojourn, float).reshape(-1)
    r = times.size
    if r == 0 or not (times > 0.0).all():
        raise ValueError(f"sojourn is {times.tolist()}; give a time above 0 for each mode")
    if not (math.isfinite(dt) and dt >= 0.0):
        raise ValueError(f"dt is {dt!r}; give a step of at least 0 s")
    leaving = np.ones((r, r)) if share is None else np.array(share, float)
    if leaving.shape != (r, r) or not (np.isfinite(leaving) & (leaving >= 0.0)).all():
        raise ValueError(f"share has shape {leaving.shape}; give ({r}, {r}) values of at least 0")
    np.fill_diagonal(leaving, 0.0)
    total = leaving.sum(axis=1, keepdims=True)
    rates = leaving / np.where(total > 0.0, total, 1.0) / times[:, None]
    rates -= np.diag(rates.sum(axis=1))
    M = np.empty((r, r))
    transitions_over(rates, float(dt), M)
    return M


def check_distribution(mu: ArrayLike, size: int) -> Array:
    """Mode probabilities as a fresh (size,) array scaled to sum 1.

    Raises
    ------
    ValueError : another size, negative or not finite, or all zero.

    Examples
    --------
    >>> check_distribution([1, 3], 2).tolist()
    [0.25, 0.75]
    """
    values = np.array(mu, float).reshape(-1)
    if values.size != size:
        raise ValueError(f"mu has {values.size} values for {size} filters; give one for each")
    total = values.sum()
    if not (math.isfinite(total) and (values >= 0.0).all() and total > 0.0):
        raise ValueError(f"mu is {values.tolist()}; give probabilities of at least 0, not all of them 0")
    return np.asarray(values / total)


def check_transitions(M: ArrayLike, size: int) -> Array:
    """Mode transition probabilities as a fresh (size, size) array.

    Raises
    ------
    ValueError : another shape, negative, or rows that do not sum to 1.

    Examples
    --------
    >>> check_transitions([[0.9, 0.2], [0.1, 0.8]], 2)
    Traceback (most recent call last):
        ...
    ValueError: M has rows that sum to [1.1, 0.9], least value 0.1; M[i, j] is the probability of going \
from mode i to mode j, so each row sums to 1
    """
    values = np.ascontiguousarray(np.array(M, float))
    if values.shape != (size, size):
        raise ValueError(f"M has shape {values.shape} for {size} filters; give {(size, size)}")
    sums = values.sum(axis=1)
    # Rows written to six digits pass; update_modes scales the sum to 1.
    if not ((values >= 0.0).all() and (np.abs(sums - 1.0) <= 1e-6).all()):
        raise ValueError(
            f"M has rows that sum to {sums.round(6).tolist()}, least value {values.min():g}; "
            "M[i, j] is the probability of going from mode i to mode j, so each row sums to 1"
        )
    return values
