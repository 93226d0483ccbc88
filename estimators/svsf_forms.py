"""Gains of the SVSF's three forms, for the class :class:`estimators.svsf.SVSF`.

With ``E = |e| + gamma |e_post|`` and the ratio ``r = E / psi`` inside the layer, ``E / |e|``
outside (never a division by a small ``e``: inside it is ``psi`` that divides)::

    full       m = n   K = H^-1 diag(r)                                     Habibi 2007
    subspace   m <= n  K = P H' (H P H')^-1 diag(r)                         estimators.kernels.svsf_gain
    reduced    m < n   K = T^-1 [diag(r); diag(r_y) A],  A = Phi22 Phi12+   Habibi 2007

The reduced form sorts the states by a Luenberger-type transform ``T x = [z; y]`` with ``y`` the
unmeasured ones, so that ``H T^-1 = [I 0]``, and splits ``Phi = T F T^-1`` into ``Phi12`` (how
``y`` drives ``z`` in one step) and ``Phi22``. ``Phi12+ e`` is the error of ``y`` that would explain
``e``, ``w = A e`` what became of it, and ``E_y = |w| + gamma |Phi12+ e|`` is set against a layer
``psi_y`` of its own.

Optimal layers, for which each is the Kalman gain (Gadsden and Habibi 2013, doi 10.1115/1.4006628;
generalised to unmeasured states for n = 2 m, where ``A`` is square)::

    psi_z = S (H P H')^-1 diag(E)        psi_y = A S P21^-1 diag(E_y),   P21 = y rows of T P H'
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimators.checks import Array, Mask
from estimators.kernels import svsf_gain
from estimators.linalg import project

# Beyond 1 / sqrt(eps) an inverse leaves less than half of the digits of the error.
CONDITION_LIMIT = 1.0 / float(np.sqrt(np.finfo(float).eps))


@dataclass
class Gain:
    """Gain of one update and what is reported of it.

    Attributes
    ----------
    K : (n, m) over the channels used; None: the Kalman gain is to be applied.
    psi_k, outside, exceeded : (m,) diagonal of the optimal layer, ``|e| > psi``, ``psi_k > psi``.
    forced : True when the measured rows are the SVSF's, which contracts what is outside.
    form : the form that was applied; ``"subspace"`` where the one asked for was not applicable.
    condition : of the matrix that the form inverts, rows and columns scaled; 1 for the subspace form.
    psi_k_y, outside_y, amplification : (n - m,) of the reduced form: optimal layer, ``|w| > psi_y``,
        and the standard deviation of ``w`` in units of ``psi_y``.
    """

    K: Array | None
    psi_k: Array
    outside: Mask
    exceeded: Mask
    forced: bool
    form: str = "subspace"
    condition: float = 1.0
    psi_k_y: Array = field(default_factory=lambda: np.empty(0))
    outside_y: Mask = field(default_factory=lambda: np.empty(0, dtype=bool))
    amplification: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Problem:
    """One update, over the channels used: prior P (n, n), H (m, n), R (m, m), innovation e and
    previous posterior error e_post (m,), memory gamma, layer psi (m,), and whether it is variable."""

    P: Array
    H: Array
    R: Array
    e: Array
    e_post: Array
    gamma: float
    psi: Array
    variable: bool


def correction_ratio(size: Array, error: Array, layer: Array) -> Array:
    """Share of ``error`` to be corrected, ``size sat(error / layer) / error``, without dividing by 0.

    Examples
    --------
    >>> correction_ratio(np.array([0.5, 3.0, 0.1]), np.array([0.5, -2.0, 0.0]), np.ones(3)).tolist()
    [0.5, 1.5, 0.1]
    """
    return np.asarray(size / np.maximum(np.abs(error), layer))


def scaled_condition(A: Array) -> float:
    """Condition number of a matrix whose rows and columns have been scaled, so that units drop out.

    Examples
    --------
    >>> round(scaled_condition(np.diag([1e-12, 1e6])), 6), scaled_condition(np.zeros((1, 1)))
    (1.0, inf)
    """
    balanced = np.array(A, float)
    for axis in (0, 1) * 6:  # Sinkhorn's scaling: rows and columns of the same length
        length = np.sqrt((balanced**2).sum(axis=axis, keepdims=True))
        if not (length > 0.0).all() or not np.isfinite(length).all():
            return float("inf")
        balanced = balanced / length
    values = np.linalg.svd(balanced, compute_uv=False)
    return float(values[0] / values[-1]) if values[-1] > 0.0 else float("inf")


def subspace_gain(problem: Problem) -> Gain:
    """SVSF in the measured subspace, the covariance carries it to the others."""
    p = problem
    n, m = p.P.shape[0], p.e.size
    K, psi_k, outside = np.empty((n, m)), np.empty(m), np.empty(m, dtype=bool)
    PHt, HPHt = np.empty((n, m)), np.empty((m, m))
    project(p.P, p.H, PHt, HPHt)
    switched = m > 0 and svsf_gain(
        PHt, HPHt, p.R, p.e, p.e_post, p.gamma, p.psi, p.variable, K, psi_k, outside
    )
    return Gain(K if switched else None, psi_k, outside, psi_k > p.psi, switched)


def full_gain(problem: Problem) -> Gain:
    """The original form: as many channels as states, no covariance in the gain.

    Where H cannot be inverted, or a channel is missing, the subspace form takes over, of which it
    is a special case: ``P H' (H P H')^-1 = H^-1``.
    """
    p, gain = problem, subspace_gain(problem)
    square = p.H.shape[0] == p.H.shape[1]
    gain.condition = scaled_condition(p.H) if square else float("inf")
    if gain.condition > CONDITION_LIMIT:
        return gain
    gain.form = "full"
    # A fixed layer needs no covariance; the variable one says through the subspace gain when to switch.
    if gain.K is not None or not p.variable:
        size = np.abs(p.e) + p.gamma * np.abs(p.e_post)
        gain.forced = True
        gain.K = np.asarray(np.linalg.solve(p.H, np.diag(correction_ratio(size, p.e, p.psi))), float)
    return gain


def reduced_gain(problem: Problem, F: Array, unmeasured: NDArray[np.intp], psi_y: Array) -> Gain:
    """Luenberger-type transform for fewer channels than states; the blocks of the gain switch separately.

    Parameters
    ----------
    problem : the update.
    F : (n, n) transition of the step that led to it.
    unmeasured : (n - m,) indices of the states y.
    psi_y : (n - m,) their boundary layer (limit, when variable), in their units.

    Returns
    -------
    Gain : of the subspace form where T or Phi12 is not well conditioned (:data:`CONDITION_LIMIT`).
    """
    p, gain = problem, subspace_gain(problem)
    n, m = p.P.shape[0], p.e.size
    T = np.vstack([p.H, np.eye(n)[unmeasured]])
    gain.condition = scaled_condition(T)
    if gain.condition > CONDITION_LIMIT:
        return gain
    Phi = T @ F @ np.linalg.inv(T)
    Phi12, Phi22 = Phi[:m, m:], Phi[m:, m:]
    gain.condition = max(gain.condition, scaled_condition(Phi12))
    if gain.condition > CONDITION_LIMIT:
        return gain
    gain.form = "reduced"
    backward = np.linalg.pinv(Phi12)
    A = Phi22 @ backward
    w = A @ p.e
    size = np.abs(p.e) + p.gamma * np.abs(p.e_post)
    size_y = np.abs(w) + p.gamma * np.abs(backward @ p.e)
    S = p.H @ p.P @ p.H.T + p.R
    PHt = T @ p.P @ p.H.T  # measured rows, then unmeasured ones
    gain.outside_y = np.abs(w) > psi_y
    gain.amplification = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", A, S, A), 0.0)) / psi_y
    gain.psi_k_y = _optimal_layer(A, S, PHt[m:], size_y)
    upper: Array = np.diag(correction_ratio(size, p.e, p.psi))
    lower: Array = correction_ratio(size_y, w, psi_y)[:, None] * A
    if p.variable:
        # As above: where no optimal layer exists, there is nothing to compare, and Kalman's gain stands.
        exists = bool(np.isfinite(gain.psi_k_y).all())
        switched_y = exists and bool((np.abs(gain.psi_k_y) > psi_y).any())
        if not gain.forced and not switched_y:
            return gain
        kalman: Array = np.asarray(np.linalg.solve(S, PHt.T).T, float)
        upper = upper if gain.forced else kalman[:m]
        lower = lower if switched_y else kalman[m:]
    else:
        gain.forced = True
    gain.K = np.asarray(np.linalg.solve(T, np.vstack([upper, lower])), float)
    return gain


def _optimal_layer(A: Array, S: Array, P21: Array, size: Array) -> Array:
    """Diagonal of ``A S P21^-1 diag(size)``; NaN unless n = 2 m, infinite where y and z are uncorrelated."""
    if P21.shape[0] != P21.shape[1]:
        return np.full(size.size, np.nan)
    if scaled_condition(P21) > CONDITION_LIMIT:
        return np.full(size.size, np.inf)
    return np.asarray(np.diag(A @ S @ np.linalg.inv(P21)) * size)
