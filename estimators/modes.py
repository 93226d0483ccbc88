"""Modes of a plant: how they follow each other, and the arithmetic of interacting multiple models.

One step of a bank of r mode-matched filters (Blom and Bar-Shalom 1988, doi 10.1109/9.1299)::

    predicted mode      cbar_j    = sum_i M_ij mu_i
    mixing weights      omega_ij  = M_ij mu_i / cbar_j
    mixed state         x0_j      = sum_i omega_ij x_i
    mixed covariance    P0_j      = sum_i omega_ij (P_i + (x_i - x0_j)(x_i - x0_j)')
    each filter         predicts and updates from x0_j, P0_j; log-likelihood l_j
    mode probability    mu_j      = cbar_j exp(l_j) / sum_k cbar_k exp(l_k)
    estimate            x         = sum_j mu_j x_j,  P likewise with the spread of the means

=================== ======================================================= ============
symbol              meaning                                                 shape
=================== ======================================================= ============
``mu``              probability of each mode                                (r,)
``M``               ``M[i, j]``: probability of going from mode i to j      (r, r)
``cbar``            mode probabilities before the measurement               (r,)
``omega``           ``omega[i, j]``: share of filter i in what j starts at  (r, r)
``x, P``            estimates of the filters and their covariances          (r, n), (r, n, n)
``log_likelihood``  of the filters' last measurement                        (r,)
=================== ======================================================= ============

:class:`estimators.imm.IMM` checks what comes in, these functions nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from estimators.linalg import Array

# What a mode keeps when the data speak against it as strongly as a float can say: then later data
# can bring it back, also where M has no transition that would.
LEAST_PROBABILITY = 1e-300


def mixing_weights(mu: Array, M: Array) -> tuple[Array, Array]:
    """Predicted mode probabilities ``cbar`` (r,) and mixing weights ``omega`` (r, r), columns summing to 1.

    A mode that cannot be reached (``cbar_j = 0``) keeps its own filter.

    Examples
    --------
    >>> cbar, omega = mixing_weights(np.array([0.5, 0.5]), np.array([[0.75, 0.25], [0.0, 1.0]]))
    >>> cbar.tolist(), omega.tolist()
    ([0.375, 0.625], [[1.0, 0.2], [0.0, 0.8]])
    """
    joint = M * mu[:, None]
    cbar = joint.sum(axis=0)
    return cbar, np.divide(joint, cbar, out=np.eye(mu.size), where=cbar > 0.0)


def moments(x: Array, P: Array, weights: Array) -> tuple[Array, Array]:
    """Mean (n,) and covariance (n, n) of a Gaussian mixture of components (r, n), (r, n, n).

    The covariance is that within the components plus that between their means.

    Examples
    --------
    >>> mean, covariance = moments(np.array([[0.0], [4.0]]), np.ones((2, 1, 1)), np.array([0.75, 0.25]))
    >>> mean.item(), covariance.item()
    (1.0, 4.0)
    """
    mean = (weights[:, None] * x).sum(axis=0)
    away = x - mean
    spread = P + away[:, :, None] * away[:, None, :]
    return mean, (weights[:, None, None] * spread).sum(axis=0)


def mix(x: Array, P: Array, omega: Array) -> tuple[Array, Array]:
    """What each filter starts its step from, (r, n) and (r, n, n): mixture j has the weights ``omega[:, j]``.

    Mean and covariance of the whole mixture are the same before and after:
    ``sum_j cbar_j x0_j = sum_i mu_i x_i``, and the second moments likewise.
    """
    x0, P0 = zip(*(moments(x, P, weights) for weights in omega.T), strict=True)
    return np.array(x0), np.array(P0)


def update_modes(cbar: Array, log_likelihood: Array) -> tuple[Array, float]:
    """Bayes' rule for the modes, in logarithms relative to the largest, so that no likelihood underflows.

    Parameters
    ----------
    cbar : (r,) probabilities before the measurement.
    log_likelihood : (r,) of the measurement under each mode; minus infinity rules a mode out.

    Returns
    -------
    mu (r,), sum 1, and the log-likelihood of the whole bank, ``log sum_j cbar_j exp(l_j)``. A mode that was
    possible keeps at least :data:`LEAST_PROBABILITY`; when every mode is ruled out ``mu`` is ``cbar``.

    Examples
    --------
    >>> mu, total = update_modes(np.array([0.5, 0.5]), np.array([-9000.0, -9000.0 - np.log(3.0)]))
    >>> mu.round(12).tolist(), round(total, 4)
    ([0.75, 0.25], -9000.4055)
    """
    possible = cbar > 0.0
    peak = float(log_likelihood[possible].max())
    if peak == -math.inf:
        return cbar.copy(), peak
    mu = np.where(possible, cbar * np.exp(np.minimum(log_likelihood - peak, 0.0)), 0.0)
    total = float(mu.sum())
    mu /= total
    return np.where(possible, np.maximum(mu, LEAST_PROBABILITY), mu), peak + math.log(total)


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
    from scipy.linalg import expm  # seldom needed, and slow to import

    M = np.maximum(expm(rates * dt), 0.0)
    return np.asarray(M / M.sum(axis=1, keepdims=True))


def check_distribution(mu: ArrayLike, size: int) -> Array:
    """Mode probabilities as a fresh (size,) array scaled to sum 1.

    Raises
    ------
    ValueError : another size, negative or not finite, or all zero.
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
