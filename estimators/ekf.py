"""Extended Kalman filter with filterpy's interface: real nonlinear models, gaps, honest numerics.

Model, with process noise ``w ~ N(0, Q)`` and measurement noise ``v ~ N(0, R)``::

    x_k = f(x_{k-1}, u, dt) + w          or, without f:  F x + B u + w
    z_k = h(x_k) + v                     or, without h:  H x + v

The covariance goes with the Jacobians ``F = df/dx`` and ``H = dh/dx``. Channels are decorrelated and taken
one by one in Joseph form (:func:`estimators.kernels.kalman_update_correlated`), so that nothing is inverted.

Outliers can be weighed down channel by channel. With ``t = |y| / sqrt(S)`` the innovation in its own
standard deviations and Huber's limit c, the weight is ``w = min(1, c / t)`` and ``R <- R + S (1 / w - 1)``,
so that S becomes ``S / w``. Widening the noise, rather than clipping the innovation, lets the covariance
grow too: what was hardly used has hardly informed.

Sources: Bar-Shalom, Li and Kirubarajan 2001, Estimation with Applications to Tracking and
Navigation, sections 5.2 and 10.3, doi 10.1002/0471221279; Huber 1964, doi 10.1214/aoms/1177703732; on the
noise of single channels: Koch and Yang 1998, doi 10.1007/s001900050183.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from estimators.kernels import kalman_update_correlated
from estimators.linalg import Array, Mask

Model = Callable[..., ArrayLike]


def jacobian(function: Callable[[Array], ArrayLike], x: Array, P: Array) -> Array:
    """Derivative of ``function`` at ``x`` by central differences.

    Steps go with the standard deviations of the covariance `P` (n, n), or with `x` (n,) where that is larger.
    Gives (m, n) for m values, with an error of about 1e-10 of the scale where the function is smooth.

    Examples
    --------
    >>> import numpy as np
    >>> jacobian(lambda x: [x[0] * x[1]], np.array([2.0, 3.0]), np.eye(2)).round(9).tolist()
    [[3.0, 2.0]]
    """
    scale = np.maximum(np.abs(x), np.sqrt(np.maximum(np.diag(P), 0.0)))
    scale[scale == 0.0] = 1.0
    columns = []
    for i, step in enumerate(np.cbrt(np.finfo(float).eps) * scale):
        ahead, behind = x.copy(), x.copy()
        ahead[i] += step
        behind[i] -= step
        width = ahead[i] - behind[i]
        upper, lower = np.asarray(function(ahead), float), np.asarray(function(behind), float)
        columns.append((upper.reshape(-1) - lower.reshape(-1)) / width)
    return np.ascontiguousarray(np.stack(columns, axis=1))


class ExtendedKalmanFilter:
    """Extended Kalman filter; without ``f`` and ``h`` the linear one (README: how filterpy's differs).

    Parameters
    ----------
    dim_x, dim_z : number n of states and m of measured channels.
    dim_u : number of inputs; only for the linear model's ``B``.
    f : ``f(x, u, dt)`` gives the next state; None: ``F x + B u``.
    h : ``h(x)`` gives the m channels; None: ``H x``.
    F_jacobian : ``F_jacobian(x, u, dt)`` gives df/dx (n, n) at the state before the step.
        None: ``F`` as set, or with ``f`` central differences. Without ``f`` it makes a
        linear model whose ``F`` depends on the time step.
    H_jacobian : ``H_jacobian(x)`` gives dh/dx (m, n). None: ``H``, or with ``h`` central differences.
        Compare your own with :func:`jacobian`: ``np.testing.assert_allclose`` says which entry is off.
    robust : Huber's limit in standard deviations of the innovation, > 0: a channel that is further off counts
        as if it were just there. 1.345 keeps 95 % of the efficiency for Gaussian noise; 3 touches 0.3 % of
        good samples. None: no limit.

    Attributes
    ----------
    x : state, (n,) or (n, 1): it keeps the form you give it, and the model functions see it so.
        The default is filterpy's column of zeros.
    P, Q, R : covariances of state (n, n), process noise of one step (n, n), measurement noise
        (m, m); Q and R may be set to a scalar or to a vector, the diagonal.
    F, B, H : (n, n), (n, k) or None, (m, n); the first and last hold the Jacobians in use.
    x_prior, P_prior, x_post, P_post : copies after the last predict and update.
    z, y : last measurement and innovation, NaN where a channel is missing.
    S, SI, K : innovation covariance (m, m), its inverse over the channels used (zero elsewhere), gain (n, m).
    nis, channels_used : normalised innovation squared ``y' S^-1 y`` and its degrees of freedom.
    log_likelihood, likelihood : of the channels used; 0 and 1 when there are none.
    mahalanobis : square root of ``nis``.
    robust_weights : (m,) Huber weight of each channel at the last update: 1 when it counted in full,
        ``w < 1`` when its S was widened to ``S / w``, NaN when missing. ``S``, ``nis`` and the
        likelihood are those of the noise as given; ``K`` and ``P`` are those applied.

    Raises
    ------
    ValueError : a shape that does not fit, an infinite measurement, or a model that gives NaN.
        A refused call leaves ``x`` and ``P`` as they were.

    Examples
    --------
    A pendulum of 1 m, its horizontal deflection measured, at an uneven rate:

    >>> import numpy as np
    >>> def swing(x, u, dt):
    ...     return [x[0] + dt * x[1], x[1] - dt * 9.81 * np.sin(x[0])]
    >>> kf = ExtendedKalmanFilter(2, 1, f=swing, h=lambda x: np.sin(x[:1]))
    >>> kf.x, kf.P, kf.Q, kf.R = np.array([0.3, 0.0]), 0.1, 1e-6, 1e-4
    >>> for dt, z in [(0.01, 0.29), (0.02, np.nan), (0.01, 0.28)]:
    ...     kf.predict(dt=dt)
    ...     kf.update(z)
    >>> kf.x.round(3).tolist(), kf.channels_used
    ([0.287, -0.2], 1)
    """

    def __init__(
        self, dim_x: int, dim_z: int, dim_u: int = 0, *, f: Model | None = None, h: Model | None = None,
        F_jacobian: Model | None = None, H_jacobian: Model | None = None, robust: float | None = None,
    ) -> None:  # fmt: skip
        self.dim_x, self.dim_z, self.dim_u = dim_x, dim_z, dim_u
        if robust is not None and not robust > 0.0:
            raise ValueError(
                f"robust is {robust:g}; give a limit of more than 0 standard deviations, or None"
            )
        self.robust = robust
        self.f, self.h, self.F_jacobian, self.H_jacobian = f, h, F_jacobian, H_jacobian
        n, m = dim_x, dim_z
        self.x: Any = np.zeros((n, 1))
        self.P: Any = np.eye(n)
        self.Q: Any = np.eye(n)
        self.R: Any = np.eye(m)
        self.F: Any = np.eye(n)
        self.B: Any = np.zeros((n, dim_u)) if dim_u else None
        self.H: Any = np.zeros((m, n))
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()
        self.x_post, self.P_post = self.x.copy(), self.P.copy()
        self.z: Array = np.full((m, 1), np.nan)
        self.y: Array = np.zeros((m, 1))
        self.S, self.K = np.zeros((m, m)), np.zeros((n, m))
        self.nis, self.channels_used, self.log_likelihood = 0.0, 0, 0.0
        self.robust_weights: Array = np.ones(m)

    def predict(
        self, u: ArrayLike | None = None, dt: float | None = None, *, F: ArrayLike | None = None,
        B: ArrayLike | None = None, Q: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        """Carry state and covariance to the next sample, by a step of length `dt` (s).

        The input `u` goes to ``f`` and ``F_jacobian``, or is multiplied by ``B``. `F`, `B` and `Q` are for
        this step only, in place of the attributes.
        """
        n = self.dim_x
        x, P = _vector(self.x, n, "x"), _square(self.P, n, "P")
        shaped = x.reshape(np.shape(self.x))
        noise = _square(self.Q if Q is None else Q, n, "Q")
        if F is not None:
            transition = _matrix(F, n, n, "F")
        elif self.F_jacobian is not None:
            transition = _matrix(self.F_jacobian(shaped.copy(), u, dt), n, n, "F_jacobian(x, u, dt)")
        elif self.f is not None:
            f = self.f
            transition = jacobian(lambda v: f(v.reshape(shaped.shape), u, dt), x, P)
        else:
            transition = _matrix(self.F, n, n, "F")
        if self.f is not None:
            x = _vector(self.f(shaped.copy(), u, dt), n, "f(x, u, dt)")
        else:
            x = transition @ x + self._input(u, self.B if B is None else B)
        require_finite(x, "the predicted state", "state")
        P = transition @ P @ transition.T + noise
        self.x, self.P, self.F = x.reshape(shaped.shape), 0.5 * (P + P.T), transition
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def update(
        self, z: ArrayLike | None, HJacobian: Model | None = None, Hx: Model | None = None,
        R: ArrayLike | None = None, args: Any = (), hx_args: Any = (),
        residual: Callable[[Any, Any], Any] = np.subtract, *, mask: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        """Correct the state with a measurement.

        Parameters
        ----------
        z : (m,) or (m, 1), a scalar when m = 1; NaN drops a channel, None all of them.
        HJacobian, Hx : for this update only, in place of ``H_jacobian`` and ``h``;
            called with the state and ``args``, ``hx_args``.
        R : (m, m), (m,) or scalar, for this update only.
        residual : ``residual(z, h(x))``, for channels that are angles.
        mask : (m,) bools, False drops a channel whatever ``z`` holds there. None: NaN alone decides.
        """
        n, m, shape = self.dim_x, self.dim_z, np.shape(self.x)
        x, P = _vector(self.x, n, "x"), _square(self.P, n, "P")
        measured = _vector(np.full(m, np.nan) if z is None else z, m, "z")
        used = _measured(measured, mask)
        measured[~used] = np.nan
        noise = _square(self.R if R is None else R, m, "R")
        args = args if isinstance(args, tuple) else (args,)
        hx_args = hx_args if isinstance(hx_args, tuple) else (hx_args,)
        h = self.h if Hx is None else Hx
        derivative = self.H_jacobian if HJacobian is None and Hx is None else HJacobian

        def modelled(state: Array) -> Array:
            return _vector(h(state.reshape(shape).copy(), *hx_args), m, "h(x)") if h else H @ state

        if derivative is not None:
            H = _matrix(derivative(x.reshape(shape), *args), m, n, "the Jacobian of h")
        elif h is None:
            H = _matrix(self.H, m, n, "H")
        else:
            H = jacobian(modelled, x, P)
        column = (m, 1) if len(shape) == 2 else (m,)

        def innovation(state: Array) -> Array:
            difference = residual(measured.reshape(column), modelled(state).reshape(column))
            return _vector(difference, m, "residual(z, h(x))")

        y = innovation(x)
        require_finite(y[used], "the innovation z - h(x)", "used channel")
        require_finite(H[used], "the Jacobian of h", "row")
        found = self._corrected(x, P, y, H, noise, used, innovation)
        require_finite(found["x"], "the updated state", "state")
        require_finite(found["P"], "the updated covariance", "row")
        S = H @ P @ H.T + noise
        self.S, self.H = 0.5 * (S + S.T), H
        for name, value in found.items():
            setattr(self, name, value)
        self.x = found["x"].reshape(shape)
        self.z, self.y = measured.reshape(column), np.where(used, y, np.nan).reshape(column)
        self.channels_used = int(used.sum())
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

    @property
    def SI(self) -> Array:
        """Inverse of ``S`` over the channels of the last update, zero elsewhere (m, m); for show."""
        used = ~np.isnan(self.z).reshape(-1)
        inverse = np.zeros((self.dim_z, self.dim_z))
        scale = np.sqrt(np.diag(self.S)[used])
        scale[scale == 0.0] = 1.0
        weights = np.outer(scale, scale)
        inverse[np.ix_(used, used)] = (
            np.linalg.pinv(self.S[np.ix_(used, used)] / weights, hermitian=True) / weights
        )
        return inverse

    @property
    def likelihood(self) -> float:
        """``exp(log_likelihood)``, but at least the smallest float, so that a product survives it."""
        return max(math.exp(min(self.log_likelihood, 700.0)), sys.float_info.min)

    @property
    def mahalanobis(self) -> float:
        """How many standard deviations the last measurement was off."""
        return math.sqrt(self.nis)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(dim_x={self.dim_x}, dim_z={self.dim_z})"

    def _corrected(
        self, x: Array, P: Array, y: Array, H: Array, R: Array, used: Mask,
        innovation: Callable[[Array], Array],
    ) -> dict[str, Any]:  # fmt: skip
        """What an update from the prior makes of the attributes; neither arguments nor filter are changed."""
        found = self._kalman(x, P, y, H, R, used)
        weights = np.where(used, 1.0, np.nan)
        if self.robust is not None:
            S = np.diag(H @ P @ H.T + R)
            sigmas = np.sqrt(np.divide(y * y, S, out=np.zeros_like(y), where=used & (S > 0.0)))
            weights *= self.robust / np.maximum(sigmas, self.robust)
            if (sigmas > self.robust).any():
                wide = self._kalman(x, P, y, H, R + np.diag(S * (1.0 / weights - 1.0)), used)
                found |= {name: wide[name] for name in ("x", "P", "K")}
        return found | {"robust_weights": weights}

    def _kalman(self, x: Array, P: Array, y: Array, H: Array, R: Array, used: Mask) -> dict[str, Any]:
        x, P, K = x.copy(), P.copy(), np.zeros((self.dim_x, self.dim_z))
        nis, log_likelihood = kalman_update_correlated(x, P, y, H, R, used, K)
        return {"x": x, "P": P, "K": K, "nis": nis, "log_likelihood": log_likelihood}

    def _input(self, u: ArrayLike | None, B: ArrayLike | None) -> Array:
        if u is None or (B is None and not np.any(u)):
            return np.zeros(self.dim_x)
        if B is None:
            raise ValueError("u is given but the filter has no B; set B (n, k), or give f")
        values = np.asarray(u, float).reshape(-1)
        gain = np.asarray(B, float)
        if gain.ndim == 0:
            gain = gain * np.eye(self.dim_x)
        return _matrix(gain, self.dim_x, values.size, "B") @ values


def require_finite(array: Array, what: str, place: str) -> None:
    """Refuse an array with values that are not finite; names what it is and the first place."""
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        raise ValueError(f"{what} is not finite in {place} {bad[0, 0]}; check the model and the covariances")


def _vector(value: ArrayLike, size: int, name: str) -> Array:
    """A fresh (size,) array of whatever shape came in."""
    array = np.array(value, dtype=float).reshape(-1)
    if array.size != size:
        raise ValueError(f"{name} has {array.size} values, the filter expects {size}")
    return array


def _matrix(value: ArrayLike, rows: int, columns: int, name: str) -> Array:
    """A fresh (rows, columns) array; a scalar or a flat list will do where the sizes agree."""
    array = np.array(value, dtype=float, order="C")
    if array.size == rows * columns and (array.ndim < 2 or array.shape == (rows, columns)):
        return np.ascontiguousarray(array.reshape(rows, columns))
    raise ValueError(f"{name} has shape {array.shape}, the filter expects {(rows, columns)}")


def _square(value: ArrayLike, size: int, name: str) -> Array:
    """A covariance (size, size) from a scalar, its diagonal or itself; a symmetric, finite copy."""
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        array = array * np.eye(size)
    elif array.shape == (size,):
        array = np.diag(array)
    full = _matrix(array, size, size, name)
    require_finite(full, name, "row")
    negative = np.flatnonzero(np.diag(full) < 0.0)
    if negative.size:
        raise ValueError(f"{name} has a negative variance at {negative[0]}")
    return 0.5 * (full + full.T)


def _measured(z: Array, mask: ArrayLike | None) -> Mask:
    """True where ``z`` (m,) is a number and ``mask`` (m,), if given, says to use it."""
    used = ~np.isnan(z)
    if mask is not None:
        wanted = np.asarray(mask)
        if wanted.dtype != np.bool_ or wanted.size != z.size:
            problem = f"mask has {wanted.size} values of type {wanted.dtype}"
            raise ValueError(f"{problem}; give {z.size} bools, True to use")
        used &= wanted.reshape(-1)
    infinite = np.flatnonzero(used & np.isinf(z))
    if infinite.size:
        raise ValueError(f"z is infinite in channel {infinite[0]}; mark a gap with NaN")
    return used
