"""Covariance step and measurement updates of the EHA tracker, Kalman's and the SVSF's, for its structure.

What makes them cheap, and exact:

- Friction and load, the states from `eha.FRIC` on, learn from the mean force alone (`estimators.eha.walk`).
  They are never correlated with the others: ``P`` has two blocks, and all here but `compare_sensors` works on
  the first, the ``COUPLED`` states.
- Only the first ``MOVING`` rows of ``F`` differ from the identity, and most of their entries are zero.
- A channel is one state, or the difference of two: ``P h'`` is a row of ``P``, or the difference of two.

The Joseph form ``(I - k h) P (I - k h)' + k r k'`` with ``k = P h' / s``, ``s = h P h' + r``, equals
``P - k s k'`` in exact arithmetic, and so ``P h' = k r`` after the update. In floating point ``P - k s k'``
loses just this product, which is where a precise channel drives a variance negative; Joseph's form saves it.
Here ``P - u u'`` with ``u = P h' / √s`` is formed, which is symmetric to the bit, and then ``P h' = k r`` is
*imposed* on the rows that `h` selects. What remains, the covariance given the measured state, is the same
before and after: ``P`` stays positive as long as Joseph's would. (Bierman 1977, Factorization Methods for
Discrete Sequential Estimation, ch. II and V.)
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators.compiled import njit
from estimators.eha import model as eha
from estimators.eha.layout import Memory
from estimators.kernels import TIE_BREAK, svsf_gain
from estimators.linalg import Array, Mask, joseph_update, project

Indices = NDArray[np.int64]

MOVING = eha.P2 + 1
"""States with dynamics; the others are random walks."""
COUPLED = eha.FRIC
"""States that measurements of motion and pressure inform."""
ROBUST = 5.0  # innovations beyond this many sigmas are weighed down (Huber)
PAIRS = 20  # samples averaged before one update
# Columns worked on: up to a multiple of four, which saves the loops over remainders. Those beyond
# COUPLED hold zeros, of the other block, and stay zero.
_SPARE = eha.STATES - min(-(-COUPLED // 4) * 4, eha.STATES)


@njit(error_model="numpy", _nrt=False)
def propagate(P: Array, F: Array, G: Array, noise: Array, Q_diag: Array, scratch: Array) -> None:
    """``P = F P F' + G diag(noise) G' + diag(Q_diag)`` in place, in the block of coupled states.

    `P` and `F` (STATES, STATES): of F the first `MOVING` rows and `COUPLED` columns are read, its other rows
    are the identity's, and P has zeros between coupled and other states. `G` (STATES, 4) and `noise` (4,)
    are effect and variances of the noise on the moving states, `Q_diag` (STATES,) is added to all; `scratch`
    (MOVING, STATES).
    """
    # Not a constant: LLVM turns loops of known length into scalar code, others into vector code.
    width = P.shape[0] - _SPARE
    for i in range(MOVING):
        for j in range(width):
            scratch[i, j] = 0.0
        for k in range(COUPLED):
            f = F[i, k]
            if f != 0.0:
                for j in range(width):
                    scratch[i, j] += f * P[k, j]
    for i in range(MOVING):
        g0, g1, g2, g3 = (
            G[i, 0] * noise[0], G[i, 1] * noise[1], G[i, 2] * noise[2], G[i, 3] * noise[3],
        )  # fmt: skip
        for j in range(i, MOVING):
            total = g0 * G[j, 0] + g1 * G[j, 1] + g2 * G[j, 2] + g3 * G[j, 3]
            for k in range(COUPLED):
                total += scratch[i, k] * F[j, k]
            P[i, j] = total
            P[j, i] = total
        for j in range(MOVING, COUPLED):
            P[i, j] = scratch[i, j]
            P[j, i] = scratch[i, j]
    for i in range(eha.STATES):
        P[i, i] += Q_diag[i]


@njit(error_model="numpy", _nrt=False)
def channel_variance(P: Array, plus: int, minus: int) -> float:
    """``h P h'`` of a channel that measures state `plus`, less state `minus` unless that is negative."""
    if minus < 0:
        return P[plus, plus]
    return P[plus, plus] - 2.0 * P[plus, minus] + P[minus, minus]


@njit(error_model="numpy", _nrt=False)
def selected_update(P: Array, plus: int, minus: int, r: float, u: Array) -> float:
    """Let a channel of variance `r` > 0 shrink `P`, in place; see the module's notes.

    Fills `u` (STATES,) with ``P h' / √s``, so that the gain is ``u / √s``, and gives ``s = h P h' + r``.
    """
    width = P.shape[0] - _SPARE
    s = channel_variance(P, plus, minus) + r
    root = 1.0 / math.sqrt(s)
    if minus < 0:
        for j in range(width):
            u[j] = P[plus, j] * root
    else:
        for j in range(width):
            u[j] = (P[plus, j] - P[minus, j]) * root
    for i in range(COUPLED):
        f = u[i]
        for j in range(width):
            P[i, j] -= f * u[j]
    share = r * root
    if minus < 0:  # the row of the measured state is k r
        for j in range(COUPLED):
            P[plus, j] = share * u[j]
            P[j, plus] = P[plus, j]
    else:  # the difference of two rows is: each takes half of what rounding left
        for j in range(COUPLED):
            if j != plus and j != minus:
                half = 0.5 * (share * u[j] - (P[plus, j] - P[minus, j]))
                P[plus, j] += half
                P[minus, j] -= half
                P[j, plus] = P[plus, j]
                P[j, minus] = P[minus, j]
        P[plus, plus] = share * u[plus] + P[plus, minus]
        P[minus, minus] = P[minus, plus] - share * u[minus]
    return s


@njit(error_model="numpy", _nrt=False)
def update(
    x: Array, P: Array, y: Array, plus: Indices, minus: Indices, r: Array, mask: Mask, work: Array
) -> float:
    """Kalman update of the coupled states, one channel after the other, in place; gives the normalised
    innovation squared, as of `estimators.kernels.kalman_update_correlated`.

    `y`, `r`, `mask` (m,): innovations at the prior, variances, used or not. `plus`, `minus` (m,): the states
    that each channel measures, as in `channel_variance`. `work` (2, STATES) is overwritten.
    """
    width = P.shape[0] - _SPARE
    shift, u = work[0], work[1]
    for j in range(width):
        shift[j] = 0.0
    nis = 0.0
    for c in range(y.shape[0]):
        if not mask[c]:
            continue
        s = selected_update(P, plus[c], minus[c], r[c], u)
        e = y[c] - shift[plus[c]]
        if minus[c] >= 0:
            e += shift[minus[c]]
        e /= math.sqrt(s)
        for j in range(width):
            shift[j] += e * u[j]
        nis += e * e
    for i in range(COUPLED):
        x[i] += shift[i]
    return nis


@njit(error_model="numpy", _nrt=False)
def optimal_layers(
    P: Array, y: Array, plus: Indices, minus: Indices, r: Array, mask: Mask, e_post: Array, gamma: float,
    tie_break: float, psi_k: Array, work: Array,
) -> bool:  # fmt: skip
    """Optimal boundary layer of each channel; False where ``H P H'`` is singular.

    The diagonal of ``S (H P H')⁻¹ diag(E)``, ``E = |y| + γ |e_post|`` (Gadsden and Habibi 2013,
    doi 10.1115/1.4006628). With independent channels ``S (H P H')⁻¹ = I + R (H P H')⁻¹``, so
    only the diagonal of that inverse is needed: the squared columns of the inverse Cholesky factor.

    Other arguments are as in `update`; `e_post` (m,) are the posterior errors of the step before, `gamma`
    the memory, `tie_break` the share of `r` that is added to ``H P H'`` for channels that measure the same.
    Fills `psi_k` (m,), NaN where masked; `work` (2 m, m) is overwritten.
    """
    m = y.shape[0]
    L, inverse = work[:m], work[m:]
    used = 0
    for c in range(m):
        psi_k[c] = np.nan
        if not mask[c]:
            continue
        # Row `used` of the factor: measured rows come in the order of the channels.
        b = 0
        a_plus, a_minus = plus[c], minus[c]
        for d in range(c + 1):
            if not mask[d]:
                continue
            total = P[a_plus, plus[d]]
            if minus[d] >= 0:
                total -= P[a_plus, minus[d]]
            if a_minus >= 0:
                total -= P[a_minus, plus[d]]
                if minus[d] >= 0:
                    total += P[a_minus, minus[d]]
            if d == c:
                total += tie_break * r[c]
                floor = 1e-13 * total
            for k in range(b):
                total -= L[used, k] * L[b, k]
            if d < c:
                L[used, b] = total * inverse[b, b]
            else:
                if not total > floor:
                    return False
                inverse[used, used] = 1.0 / math.sqrt(total)
            b += 1
        for k in range(used):
            total = 0.0
            for i in range(k, used):
                total -= L[used, i] * inverse[i, k]
            inverse[used, k] = total * inverse[used, used]
        used += 1
    b = 0
    for c in range(m):
        if mask[c]:
            total = 0.0
            for i in range(b, used):
                total += inverse[i, b] * inverse[i, b]
            ratio = 1.0 + (1.0 - tie_break) * r[c] * total
            psi_k[c] = ratio * (abs(y[c]) + gamma * abs(e_post[c]))
            b += 1
    return True


@njit(error_model="numpy", _nrt=False)
def layers_exceeded(
    P: Array, y: Array, plus: Indices, minus: Indices, r: Array, mask: Mask, e_post: Array, gamma: float,
    layer: float, psi_k: Array, work: Array,
) -> bool:  # fmt: skip
    """Whether an optimal boundary layer is beyond its limit: `layer` standard deviations of innovation.

    Parameters as in `optimal_layers`. Inside the limit the SVSF's gain is the Kalman gain, which also holds
    where even the tie-break leaves no solution.
    """
    solvable = optimal_layers(P, y, plus, minus, r, mask, e_post, gamma, 0.0, psi_k, work)
    if not solvable and not optimal_layers(P, y, plus, minus, r, mask, e_post, gamma, TIE_BREAK, psi_k, work):
        return False
    for c in range(y.shape[0]):
        if mask[c]:
            limit = layer * layer * (r[c] + channel_variance(P, plus[c], minus[c]))
            if psi_k[c] * psi_k[c] > limit:
                return True
    return False


@njit()
def svsf_motion(
    x: Array, P: Array, y: Array, plus: Indices, minus: Indices, r: Array, mask: Mask, e_post: Array,
    gamma: float, layer: float, psi_k: Array,
) -> tuple[bool, Array, Array]:  # fmt: skip
    """What the SVSF makes of the motion states: whether it switched, them, and their variances.

    Seldom called: only where a boundary layer left its limit. Each channel's layer is the optimal one up to
    its own limit: with the limit for all, one pressure beyond its own would take a position
    well within its ten standard deviations for a matter of no hurry, and the motion would run away.
    """
    n, used = COUPLED, 0
    for measured in mask:  # NumPy's own count would load half of the compiler
        used += measured
    H, R, K = np.zeros((used, n)), np.zeros((used, used)), np.empty((n, used))
    e, before, psi = np.empty(used), np.empty(used), np.empty(used)
    a = 0
    for i in range(y.shape[0]):
        if not mask[i]:
            continue
        H[a, plus[i]] = 1.0
        if minus[i] >= 0:
            H[a, minus[i]] = -1.0
        R[a, a], e[a], before[a] = r[i], y[i], e_post[i]
        psi[a] = layer * np.sqrt(r[i] + channel_variance(P, plus[i], minus[i]))
        if 0.0 < psi_k[i] < psi[a]:
            psi[a] = psi_k[i]
        a += 1
    state, covariance = x[:n].copy(), P[:n, :n].copy()
    PHt, HPHt = np.empty((n, used)), np.empty((used, used))
    project(covariance, H, PHt, HPHt)
    switched = svsf_gain(
        PHt, HPHt, R, e, before, gamma, psi, True, K, np.empty(used), np.empty(used, np.bool_)
    )
    if switched:
        joseph_update(covariance, K, H, R)
        for i in range(n):
            for a in range(used):
                state[i] += K[i, a] * e[a]
    return switched, state[:MOVING], np.diag(covariance)[:MOVING].copy()


@njit(error_model="numpy", _nrt=False)
def take_motion(x: Array, P: Array, motion: Array, variances: Array) -> None:
    """Motion from the SVSF, parameters from the Kalman filter, in place.

    The SVSF's guarantee is for what is measured; carried over to the parameters, its gain throws
    them as far as the innovation is large. No gain has a smaller covariance than Kalman's: the
    surplus of the motion states' variances is added to Kalman's, which leaves it positive.
    """
    for i in range(MOVING):
        if np.isfinite(motion[i]):
            x[i] = motion[i]
        surplus = variances[i] - P[i, i]
        if surplus > 0.0 and np.isfinite(surplus):
            P[i, i] += surplus


@njit()
def compare_sensors(x: Array, P: Array, gap: float, variance: float, memory: Memory) -> None:
    """Let `gap` = Δp − (p₁ − p₂), MPa, of white noise `variance`, tell the zero, `PAIRS` samples at a time.

    The zero stands alone in the covariance: the redundant sensor is not let into the pressures, for its
    gain error, one percent or so, would pull them about under load, and which of the sensors is
    off nobody knows. Differences beyond five standard deviations are weighed down (Huber).
    """
    if np.isnan(gap):
        return
    memory.gap += gap
    memory.pairs += 1.0
    if memory.pairs < PAIRS:
        return
    error = memory.gap / memory.pairs - x[eha.ZERO]
    noise = variance / memory.pairs
    memory.gap = memory.pairs = 0.0
    prior = P[eha.ZERO, eha.ZERO]
    s = prior + noise
    if error * error > ROBUST * ROBUST * s:
        noise += s * (error * error / (s * ROBUST * ROBUST) - 1.0)
        s = prior + noise
    x[eha.ZERO] += prior / s * error
    P[eha.ZERO, eha.ZERO] = prior * noise / s
