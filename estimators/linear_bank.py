"""A bank of linear (affine) modes over a whole log, compiled: which mode, when, and the state.

Mode j of r, with process noise ``w ~ N(0, Q_j)`` and measurement noise ``v ~ N(0, R_j)``::

    x_k = F_j x_{k-1} + B_j u_k + state_offset_j + w
    z_k = H_j x_k + output_offset_j + v

Offsets make friction in a given direction or a biased sensor a mode. Each step is the one
of :class:`estimators.imm.IMM` with Kalman filters, and of the same functions
(:mod:`estimators.modes`); the difference is the speed.

Source: Blom and Bar-Shalom 1988, doi 10.1109/9.1299.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from estimators.checks import square
from estimators.compiled import njit
from estimators.kernels import kalman_update, kalman_update_correlated, predict_covariance
from estimators.linalg import Array
from estimators.modes import (
    check_distribution,
    check_transitions,
    mix,
    mixing_weights,
    moments,
    update_modes,
)


@dataclass(frozen=True)
class BankRun:
    """What :func:`run_bank` found at each of N samples, for r modes and n states.

    Attributes
    ----------
    mu : (N, r) mode probabilities after the sample.
    x, std : (N, n) estimate of the whole bank and its standard deviation.
    log_likelihood : (N,) of the sample under the whole bank, 0 where nothing was measured. Its sum
        compares banks: other noise, other sojourn times, other modes.
    modes : (r, n), (r, n, n), (r,): estimate, covariance and probability of each mode at the end;
        as ``start`` of a further run it continues as if the log had not been cut.
    """

    mu: Array
    x: Array
    std: Array
    log_likelihood: Array
    modes: tuple[Array, Array, Array]


@njit(error_model="numpy")
def _run(
    z: Array,
    u: Array,
    x: Array,
    P: Array,
    mu: Array,
    M: Array,
    F: Array,
    B: Array,
    H: Array,
    Q: Array,
    R: Array,
    state_offset: Array,
    output_offset: Array,
    correlated: bool,
    out_mu: Array,
    out_x: Array,
    out_std: Array,
    out_log_likelihood: Array,
) -> None:
    """The steps of the module's equations, in place; `correlated`: an R has values off its diagonal."""
    r, n = x.shape
    m, k = z.shape[1], u.shape[1]
    cbar, omega, log_likelihood = np.empty(r), np.empty((r, r)), np.empty(r)
    x0, P0, covariance = np.empty((r, n)), np.empty((r, n, n)), np.empty((n, n))
    none, mask, y, variance = np.zeros(n), np.empty(m, np.bool_), np.empty(m), np.empty(m)
    K = np.empty((n, m))
    for i in range(z.shape[0]):
        mixing_weights(mu, M, cbar, omega)
        mix(x, P, omega, x0, P0)
        for c in range(m):
            mask[c] = not np.isnan(z[i, c])
        for j in range(r):
            for a in range(n):
                x[j, a] = state_offset[j, a]
                for b in range(k):
                    x[j, a] += B[j, a, b] * u[i, b]
                for b in range(n):
                    x[j, a] += F[j, a, b] * x0[j, b]
            predict_covariance(P0[j], F[j], none, P[j])
            P[j] += Q[j]
            for c in range(m):
                variance[c] = R[j, c, c]
                y[c] = z[i, c] - output_offset[j, c]
                for a in range(n):
                    y[c] -= H[j, c, a] * x[j, a]
            if correlated:
                _, log_likelihood[j] = kalman_update_correlated(x[j], P[j], y, H[j], R[j], mask, K)
            else:
                _, log_likelihood[j] = kalman_update(x[j], P[j], y, H[j], variance, mask)
        gained = update_modes(cbar, log_likelihood, mu)
        out_log_likelihood[i] = gained if mask.any() else 0.0
        out_mu[i] = mu
        moments(x, P, mu, out_x[i], covariance)
        for a in range(n):
            out_std[i, a] = np.sqrt(max(covariance[a, a], 0.0))


def run_bank(
    z: ArrayLike,
    u: ArrayLike | None = None,
    *,
    F: ArrayLike,
    H: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    M: ArrayLike,
    B: ArrayLike | None = None,
    state_offset: ArrayLike | None = None,
    output_offset: ArrayLike | None = None,
    x: ArrayLike | None = None,
    P: ArrayLike | None = None,
    mu: ArrayLike | None = None,
    start: tuple[Array, Array, Array] | None = None,
) -> BankRun:
    """Run a bank of r affine modes over a log of N samples.

    Each model array may leave out the leading r where all modes share it; ``M`` says how many
    modes there are.

    Parameters
    ----------
    z : (N, m) measurements, NaN where missing; (N,) for one channel.
    u : (N, k) inputs, ``u[i]`` acting on the step *to* sample i; (N,) for one.
    F, H, Q, R : (r, n, n), (r, m, n), (r, n, n), (r, m, m).
    M : (r, r) mode transitions of one step, see :func:`estimators.modes.transition_matrix`.
    B : (r, n, k), with u.
    state_offset, output_offset : (r, n), (r, m); None: zero.
    x, P : (r, n), (r, n, n) before the first step; None: zero and the identity.
    mu : (r,) mode probabilities before the first step; None: all alike.
    start : ``modes`` of an earlier run, in place of x, P and mu.

    Returns
    -------
    BankRun

    Raises
    ------
    ValueError : shapes that do not fit, infinities, NaN other than in z, M or mu no probabilities.

    Examples
    --------
    A sensor that gets a bias of 1 after 60 samples, noise 0.3:

    >>> import numpy as np
    >>> from estimators import run_bank, transition_matrix
    >>> z = 0.3 * np.random.default_rng(0).normal(size=100) + (np.arange(100) >= 60)
    >>> found = run_bank(z, F=[[0.9]], H=[[1.0]], Q=[[1e-4]], R=[[0.09]], P=[[1e-3]],
    ...     output_offset=[[0.0], [1.0]], M=transition_matrix([10.0, 10.0], dt=0.01))
    >>> (found.mu[:, 1] > 0.5).nonzero()[0][0].item(), found.mu[-1].round(4).tolist()
    (62, [0.0006, 0.9994])
    """
    transitions = np.ascontiguousarray(np.array(M, float))
    r = transitions.shape[0] if transitions.ndim == 2 else 1
    transitions = check_transitions(transitions, r)
    measured = _columns(z, "z")
    samples, m = measured.shape
    if np.isinf(measured).any():
        row, channel = np.argwhere(np.isinf(measured))[0].tolist()
        raise ValueError(f"z is infinite at sample {row}, channel {channel}; mark a gap with NaN")
    F_shape = np.shape(F)
    n = F_shape[-1] if F_shape else 1
    inputs = np.zeros((samples, 0)) if u is None else _columns(u, "u")
    if inputs.shape[0] != samples or not np.isfinite(inputs).all():
        raise ValueError(f"u has {inputs.shape[0]} rows for {samples} of z, or values that are not finite")
    k = inputs.shape[1]
    if (B is None) != (k == 0):
        raise ValueError("u and B come together; give both or none")
    models: dict[str, Any] = {
        "F": _stack(F, (r, n, n), "F"),
        "B": np.zeros((r, n, 0)) if B is None else _stack(B, (r, n, k), "B"),
        "H": _stack(H, (r, m, n), "H"),
        "Q": _covariances(Q, (r, n, n), "Q"),
        "R": _covariances(R, (r, m, m), "R"),
        "state_offset": _stack(0.0 if state_offset is None else state_offset, (r, n), "state_offset"),
        "output_offset": _stack(0.0 if output_offset is None else output_offset, (r, m), "output_offset"),
    }
    if start is not None:
        if not (x is None and P is None and mu is None):
            raise ValueError("start is given with x, P or mu; give one or the other")
        x, P, mu = start
    state = (
        _stack(0.0 if x is None else x, (r, n), "x"),
        _covariances(np.eye(n) if P is None else P, (r, n, n), "P"),
        check_distribution(np.ones(r) if mu is None else mu, r),
    )
    diagonal = np.eye(m, dtype=bool)
    out = BankRun(
        np.empty((samples, r)), np.empty((samples, n)), np.empty((samples, n)), np.empty(samples), state
    )
    _run(
        measured, inputs, *state, transitions, **models,
        correlated=bool(np.any(models["R"][:, ~diagonal])),
        out_mu=out.mu, out_x=out.x, out_std=out.std, out_log_likelihood=out.log_likelihood,
    )  # fmt: skip
    return out


def _columns(value: ArrayLike, name: str) -> Array:
    array = np.array(value, float)
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2:
        raise ValueError(f"{name} has shape {array.shape}; give one row per sample")
    return np.ascontiguousarray(array)


def _stack(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """A fresh array of ``shape``, the leading modes filled up where ``value`` lacks them."""
    array = np.asarray(value, float)
    fits = array.shape in (shape, shape[1:], (1, *shape[1:]))
    if not (fits or (array.ndim == 0 and (array == 0.0 or shape[-1] == 1))):
        raise ValueError(f"{name} has shape {array.shape}; give {shape}, or {shape[1:]} for all modes")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has values that are not finite")
    return np.array(np.broadcast_to(array, shape), order="C")


def _covariances(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    full = _stack(value, shape, name)
    return np.array(
        [square(covariance, shape[-1], f"{name} of mode {j}") for j, covariance in enumerate(full)]
    )
