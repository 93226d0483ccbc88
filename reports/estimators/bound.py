"""The posterior Cramér-Rao bound: how well any filter could know the states from the same data.

For ``x_k = f(x_{k-1}) + w``, ``z_k = h(x_k) + v`` with Gaussian noise the information matrix obeys::

    J_k = (Q + F J_{k-1}^-1 F')^-1 + H' R^-1 H

with F and H taken at the true states (Tichavský, Muravchik and Nehorai 1998, doi 10.1109/78.668800; this is
their eq. 21 by the matrix inversion lemma, which also holds where Q is singular, as here). On a linear model
it is the Kalman filter's covariance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.eha import model as eha
from estimators.eha.update import MOVING, propagate
from estimators.kernels import scalar_update
from reports.estimators.cases import Trajectory
from reports.estimators.compiled import njit
from reports.estimators.model import (
    FORCE_PERIOD,
    LOW_SIDE,
    LOW_SIDE_TIME,
    SETTLING,
    Assumed,
    Sizes,
    chamber_noise,
)

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def eha_bound(
    truth: Trajectory, model: eha.Parameters, prior: Assumed, *, minimum: bool, rows: Rows
) -> Array:
    """Bound of every state's variance for the EHA estimators' model, on the data of one run.

    The same noise and the same statement of the model as the estimators': flow noise large where a chamber is
    fed, friction known by 20 ms mean force balances while the piston has slid one way for 80 ms, each with
    the standard deviation ``Noise.force_mean``, and not by the single samples. Their further caution, such as
    noise that grows with the load's unrest, is not in the bound.

    `truth`: the run. `model`: parameter array. `prior`: initial spread and noise. `minimum`: of all pressures
    the chambers' difference alone is measured. `rows`: (k,) ascending, where the bound is wanted.

    Gives (k, STATES) variances, model units.
    """
    out = np.empty((rows.size, eha.STATES))
    _eha_bound(
        truth.states, truth.accumulator, truth.viscosity, model, np.diag(prior.spread**2), prior.walk,
        prior.pull, prior.sizes, not minimum, not minimum, rows, out,
    )  # fmt: skip
    return out


@njit(error_model="numpy")
def _eha_bound(
    states: Array, p_acc: Array, viscosity: Array, q: eha.Parameters, P: Array, walk: Array, pull: Array,
    sizes: Sizes, pressures: bool, known: bool, rows: Rows, out: Array,
) -> None:  # fmt: skip
    n, motion = eha.STATES, eha.P2 + 1
    F, G = np.empty((n, n)), np.empty((n, 4))
    new, k_gain, scratch, diag, noise = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(4)
    moved, still = np.empty((MOVING, n)), np.zeros(n)
    noise[0], noise[1] = sizes.force**2, sizes.acceleration**2
    for i in range(n):
        diag[i] = walk[i] ** 2 * 1e-3
    channels = 4
    H, r = np.zeros((channels, n)), np.empty(channels)
    H[0, eha.X] = H[1, eha.TH] = 1.0
    r[0], r[1] = sizes.position**2, sizes.angle**2
    if pressures:
        H[2, eha.P1] = H[3, eha.P2] = 1.0
        r[2] = r[3] = sizes.pressure**2
    else:
        H[2, eha.P1], H[2, eha.P2] = 1.0, -1.0
        r[2], r[3] = sizes.difference**2, LOW_SIDE**2 * LOW_SIDE_TIME
    force, sliding = np.zeros(n), 0
    wanted = 0
    for k in range(states.shape[0]):
        x = states[k]
        if k > 0:
            past = states[k - 1]
            eha.step(past, 1.0, viscosity[k - 1], p_acc[k - 1], x[eha.V], x[eha.W], q, new, F, G)
            sd1, sd2 = chamber_noise(past[eha.P1], past[eha.P2], p_acc[k - 1], known, sizes)
            noise[2], noise[3] = sd1 * sd1, sd2 * sd2
            propagate(P, F, G, noise, still, moved)
            for i in range(motion, n):
                P[i, :] *= 1.0 - 1e-3 * pull[i]
                P[:, i] *= 1.0 - 1e-3 * pull[i]
            for i in range(n):
                P[i, i] += diag[i]
        if not pressures:
            low = 1.0 if x[eha.P1] <= x[eha.P2] else 0.0
            H[3, eha.P1], H[3, eha.P2] = low, 1.0 - low
        for c in range(channels):
            scalar_update(P, H[c], r[c], k_gain, scratch)

        # The mean force of a period, wherever the piston slid through all of it and had settled before.
        v = x[eha.V]
        if k > 0 and abs(v) >= q.sliding_velocity and v * states[k - 1, eha.V] > 0.0:
            sliding += 1
        else:
            sliding = 0
        place = k % FORCE_PERIOD
        if place == 0:
            force[:] = 0.0
        force[eha.FRIC] += eha.friction_curve(v, q)[0] / FORCE_PERIOD
        force[eha.VISC] += v / FORCE_PERIOD
        force[eha.SKEW] += abs(v) / FORCE_PERIOD
        force[eha.LOAD] = 1.0
        force[eha.STIF] += x[eha.X] / FORCE_PERIOD
        force[eha.THROT] += v * abs(v) / FORCE_PERIOD
        if place == FORCE_PERIOD - 1 and sliding >= SETTLING:
            force[eha.INERT] = (v - states[k - FORCE_PERIOD + 1, eha.V]) / FORCE_PERIOD * 1e3
            scalar_update(P, force, sizes.force_mean**2, k_gain, scratch)
        if wanted < rows.size and rows[wanted] == k:
            for i in range(n):
                out[wanted, i] = P[i, i]
            wanted += 1
