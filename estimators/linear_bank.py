"""A bank of linear (affine) modes over a whole log, compiled: which mode, when, and the state.

Mode j of r, with process noise ``w ~ N(0, Q_j)`` and measurement noise ``v ~ N(0, R_j)``::

    x_k = F_j x_{k-1} + B_j u_k + state_offset_j + w
    z_k = H_j x_k + output_offset_j + v

Offsets make friction in a given direction or a biased sensor a mode. Each step is the one
of :class:`estimators.imm.IMM` with Kalman filters, and of the same functions
(:mod:`estimators.imm_kernels`); the difference is the speed. In a loop of your own, with models
that change from sample to sample, call :func:`bank_step`.

Source: Blom and Bar-Shalom 1988, doi 10.1109/9.1299.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from estimators.compiled import njit
from estimators.imm_kernels import mix, mixing_weights, moments, update_modes
from estimators.kernels import kalman_update, kalman_update_correlated, predict_covariance
from estimators.linalg import Array, balanced_covariance
from estimators.mode_chain import check_distribution, check_transitions


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
def bank_step(
    x: Array,
    P: Array,
    mu: Array,
    M: Array,
    drive: Array,
    y0: Array,
    F: Array,
    Q: Array,
    H: Array,
    R: Array,
    correlated: bool,
    cbar: Array,
    omega: Array,
    x0: Array,
    P0: Array,
    log_likelihood: Array,
) -> float:
    """One step of a bank of affine Kalman filters, in place.

    Parameters
    ----------
    x, P, mu : (r, n), (r, n, n), (r,) the modes' estimates and probabilities; overwritten by the next.
    M : (r, r) transition probabilities of this step.
    drive : (r, n) what is added to ``F x``: ``B u`` and offsets.
    y0 : (r, m) measurement minus output offset; NaN where a channel is missing.
    F, Q, H, R : (r, n, n), (r, n, n), (r, m, n), (r, m, m) models.
    correlated : whether an R has values off its diagonal. False reads only the diagonal, and is faster.
    cbar, omega, x0, P0, log_likelihood : (r,), (r, r), (r, n), (r, n, n), (r,) scratch; as in
        :mod:`estimators.imm_kernels` on return, ``x0`` and ``P0`` the mixed starts.

    Returns
    -------
    Log-likelihood of the measurement under the whole bank; 0 when nothing was measured.

    Examples
    --------
    Two modes of a constant, noise of variance 1 or 4; 3 speaks for the wider one:

    >>> import numpy as np
    >>> x, P, mu, one = np.zeros((2, 1)), np.zeros((2, 1, 1)), np.full(2, 0.5), np.ones((2, 1, 1))
    >>> scratch = np.empty(2), np.empty((2, 2)), np.empty((2, 1)), np.empty((2, 1, 1)), np.empty(2)
    >>> R = np.array([[[1.0]], [[4.0]]])
    >>> _ = bank_step(
    ...     x, P, mu, np.eye(2), np.zeros((2, 1)), np.full((2, 1), 3.0),
    ...     one, 0.0 * one, one, R, False, *scratch)
    >>> mu.round(3).tolist()
    [0.064, 0.936]
    """
    r, n = x.shape
    m = y0.shape[1]
    mixing_weights(mu, M, cbar, omega)
    mix(x, P, omega, x0, P0)
    none = np.zeros(n)
    mask = np.empty(m, np.bool_)
    y = np.empty(m)
    variance = np.empty(m)
    used = 0
    for c in range(m):
        mask[c] = not np.isnan(y0[0, c])
        used += mask[c]
    for j in range(r):
        for a in range(n):
            total = drive[j, a]
            for b in range(n):
                total += F[j, a, b] * x0[j, b]
            x[j, a] = total
        predict_covariance(P0[j], F[j], none, P[j])
        for a in range(n):
            for b in range(n):
                P[j, a, b] += Q[j, a, b]
        for c in range(m):
            variance[c] = R[j, c, c]
            y[c] = y0[j, c]
            for a in range(n):
                y[c] -= H[j, c, a] * x[j, a]
        if correlated:
            log_likelihood[j] = _correlated(x[j], P[j], y, H[j], R[j], mask, used)
        else:
            _, log_likelihood[j] = kalman_update(x[j], P[j], y, H[j], variance, mask)
    gained = update_modes(cbar, log_likelihood, mu)
    return gained if used > 0 else 0.0


@njit(error_model="numpy")
def _correlated(x: Array, P: Array, y: Array, H: Array, R: Array, mask: Array, used: int) -> float:
    """Kalman update with a full R over the channels in ``mask``, in place; the log-likelihood."""
    ya, Ha, Ra = np.empty(used), np.empty((used, x.shape[0])), np.empty((used, used))
    a = 0
    for c in range(y.shape[0]):
        if mask[c]:
            ya[a], Ha[a] = y[c], H[c]
            b = 0
            for d in range(y.shape[0]):
                if mask[d]:
                    Ra[a, b] = R[c, d]
                    b += 1
            a += 1
    _, log_likelihood = kalman_update_correlated(x, P, ya, Ha, Ra, np.empty((x.shape[0], used)))
    return log_likelihood


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
    r, n = x.shape
    m, k = z.shape[1], u.shape[1]
    drive, y0 = np.empty((r, n)), np.empty((r, m))
    cbar, omega, log_likelihood = np.empty(r), np.empty((r, r)), np.empty(r)
    x0, P0, covariance = np.empty((r, n)), np.empty((r, n, n)), np.empty((n, n))
    for i in range(z.shape[0]):
        for j in range(r):
            for a in range(n):
                drive[j, a] = state_offset[j, a]
                for b in range(k):
                    drive[j, a] += B[j, a, b] * u[i, b]
            for c in range(m):
                y0[j, c] = z[i, c] - output_offset[j, c]
        out_log_likelihood[i] = bank_step(
            x, P, mu, M, drive, y0, F, Q, H, R, correlated, cbar, omega, x0, P0, log_likelihood
        )
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
    M : (r, r) mode transitions of one step, see :func:`estimators.mode_chain.transition_matrix`.
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
    if array.ndim not in (0, len(shape) - 1, len(shape)) or (
        array.ndim == 0 and shape[-1] > 1 and array != 0.0
    ):
        raise ValueError(f"{name} has shape {array.shape}; give {shape}, or {shape[1:]} for all modes")
    try:
        full = np.broadcast_to(array, shape)
    except ValueError:
        full = None
    if full is None or (array.ndim and array.shape[-(len(shape) - 1) :] != shape[1:]):
        raise ValueError(f"{name} has shape {array.shape}; give {shape}, or {shape[1:]} for all modes")
    if not np.isfinite(full).all():
        raise ValueError(f"{name} has values that are not finite")
    return np.array(full, order="C")


def _covariances(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    full = _stack(value, shape, name)
    for j, covariance in enumerate(full.copy()):
        defect = balanced_covariance(covariance, full[j])
        if defect > 0:
            raise ValueError(f"{name} has a negative variance at {defect - 1} of mode {j}")
    return full
