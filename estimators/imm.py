"""Interacting multiple models: a bank of filters, one for each mode the plant may be in.

A healthy and a leaking actuator, say. Each filter believes in its own mode; the bank weighs them
by how well they foresee the measurements, and before each step lets every filter start from a
mixture of all, weighted by how likely the plant has come over from their mode. Hence the bank
follows a plant that switches, and says which mode it is in: that is fault detection with a
probability attached.

The equations stand in :mod:`estimators.modes`.

Source: Blom and Bar-Shalom 1988, doi 10.1109/9.1299.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from estimators import modes
from estimators.checks import Array, square


class IMM:
    """Interacting multiple model estimator with filterpy's interface.

    Parameters
    ----------
    filters : r filters of the same state, one per mode: :class:`ExtendedKalmanFilter`, :class:`SVSF`,
        or filterpy's. The bank drives them; do not call them yourself.
    mu : (r,) mode probabilities at the start, scaled to sum 1; None: all alike.
    M : (r, r), ``M[i, j]`` the probability of going from mode i to mode j in one step, as
        :func:`estimators.modes.transition_matrix` gives; or a function ``M(dt)`` of the step in s.

    Attributes
    ----------
    x, P : estimate of the whole bank, in the form of the first filter's, and its covariance.
    mu : (r,) mode probabilities now: predicted after ``predict``, posterior after ``update``.
    mode : index of the most likely mode.
    log_likelihood : of the last measurement under the whole bank.
    log_likelihoods, likelihood : (r,) of the last measurement under each mode; the latter its exponential.
    cbar, omega : (r,) predicted mode probabilities, (r, r) mixing weights: those of this step after
        ``predict``, those of the next after ``update`` (if it is as long as this one).
    x_prior, P_prior, x_post, P_post : copies after the last predict and update.
    filters, M, N : as given, and the number of filters.

    Raises
    ------
    ValueError : filters of different states, probabilities that are none, or what a filter
        refuses. A refused call leaves the bank and its filters as they were.

    Notes
    -----
    Differs from ``filterpy.kalman.IMMEstimator``, to which it is otherwise equal to rounding:

    - Weights come from log-likelihoods: outliers and long runs cannot underflow them.
    - ``x_prior`` and ``P_prior`` are weighted by ``cbar``, the probabilities *after* the transition
      (filterpy: by those before), and ``mu`` is ``cbar`` then. So several predictions may follow each
      other, as may several updates, and a missing measurement lets the modes drift on.
    - ``M`` is read as filterpy's code does, rows summing to 1; its documentation says the transpose.
    - ``None`` and NaN in ``z`` work as in our filters; one filter is enough.

    An :class:`SVSF` keeps its own memory ``e_post``; only state and covariance are mixed. Its likelihood is
    that of the covariance of the gain that it applied, ``N(e; 0, H P H' + R)``.

    Examples
    --------
    A constant that starts to drift at the tenth sample; the second mode allows it to:

    >>> import numpy as np
    >>> from estimators import ExtendedKalmanFilter, transition_matrix
    >>> still, moving = ExtendedKalmanFilter(1, 1), ExtendedKalmanFilter(1, 1)
    >>> for kf, Q in ((still, 1e-6), (moving, 1.0)):
    ...     kf.H, kf.Q, kf.R = [[1.0]], Q, 0.01
    >>> bank = IMM([still, moving], None, transition_matrix([1.0, 1.0], dt=0.01))
    >>> for z in [0.1, -0.1] * 5 + [1.0, 2.0, 3.0]:
    ...     bank.predict()
    ...     bank.update(z)
    >>> bank.mode, bank.mu.round(3).tolist(), bank.x.round(2).item()
    (1, [0.0, 1.0], 2.99)
    """

    def __init__(
        self, filters: Sequence[Any], mu: ArrayLike | None, M: ArrayLike | Callable[[float], ArrayLike]
    ) -> None:
        self.filters = list(filters)
        self.N = len(self.filters)
        if self.N == 0:
            raise ValueError("there are no filters; give one for each mode")
        if len({id(f) for f in self.filters}) < self.N:
            raise ValueError("a filter stands in the bank twice; give each mode its own")
        self._takes_dt = ["dt" in inspect.signature(f.predict).parameters for f in self.filters]
        self.mu: Any = modes.check_distribution(np.ones(self.N) if mu is None else mu, self.N)
        self.M: Any = M
        self._M = np.eye(self.N) if callable(M) else modes.check_transitions(M, self.N)
        self.cbar, self.omega = modes.mixing_weights(self.mu, self._M)
        self.log_likelihoods = np.zeros(self.N)
        self.log_likelihood = 0.0
        self.x, self.P = self._combined(self.mu)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

    @property
    def mode(self) -> int:
        """Index of the most likely mode; the first of equals."""
        return int(np.argmax(self.mu))

    @property
    def likelihood(self) -> Array:
        """Likelihood of the last measurement under each mode (r,); for show, as it may underflow."""
        return np.exp(np.minimum(self.log_likelihoods, 700.0))

    def predict(self, u: ArrayLike | None = None, dt: float | None = None) -> None:
        """Mix the filters and carry them all to the next sample.

        Parameters
        ----------
        u : input, given to every filter.
        dt : s, length of the step: given to ``M`` when it is a function, and to the filters that take one.
        """
        M = self._step_transitions(dt)
        cbar, omega = modes.mixing_weights(modes.check_distribution(self.mu, self.N), M)
        x0, P0 = modes.mix(*self._stacked(), omega)
        with self._undone_if_refused():
            for j, f in enumerate(self.filters):
                f.x, f.P = x0[j].reshape(np.shape(f.x)).copy(), P0[j].copy()
                arguments: dict[str, Any] = {} if u is None else {"u": u}
                if dt is not None and self._takes_dt[j]:
                    arguments["dt"] = dt
                _ask(j, f.predict, **arguments)
            combined = self._combined(cbar)
        self._M, self.mu, self.cbar, self.omega = M, cbar.copy(), cbar, omega
        self.x, self.P = combined
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def update(self, z: ArrayLike | None, *args: Any, **kwargs: Any) -> None:
        """Correct all filters with a measurement and weigh their modes by it.

        Parameters
        ----------
        z : as the filters take it; None, or NaN throughout: nothing was measured. NaN in some
            channels is for filters of this package only.
        args, kwargs : handed to every filter's ``update``: ``R``, or the functions of filterpy's
            ``ExtendedKalmanFilter``.
        """
        z, measured = self._checked(z)
        log_likelihoods = np.zeros(self.N)
        with self._undone_if_refused():
            for j, f in enumerate(self.filters):
                _ask(j, f.update, z, *args, **kwargs)
                if measured:
                    log_likelihoods[j] = _log_likelihood(f, j)
            before = modes.check_distribution(self.mu, self.N)
            mu, log_likelihood = modes.update_modes(before, log_likelihoods)
            combined = self._combined(mu)
        self.mu, self.log_likelihoods, self.log_likelihood = mu, log_likelihoods, log_likelihood
        self.cbar, self.omega = modes.mixing_weights(mu, self._M)
        self.x, self.P = combined
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.filters})"

    def _step_transitions(self, dt: float | None) -> Array:
        if not callable(self.M):
            if dt is not None and not any(self._takes_dt):
                raise ValueError("dt is given, but neither M nor any filter takes a time step")
            return modes.check_transitions(self.M, self.N)
        if dt is None:
            raise ValueError("M is a function of the time step; give dt")
        return modes.check_transitions(self.M(dt), self.N)

    def _checked(self, z: ArrayLike | None) -> tuple[ArrayLike | None, bool]:
        """The measurement, None when it is missing altogether; and whether it is not."""
        if z is None:
            return None, False
        values = np.asarray(z, float)
        missing = np.isnan(values)
        if missing.all():
            return None, False
        if missing.any():
            for j, f in enumerate(self.filters):
                if not hasattr(f, "channels_used"):
                    kind = type(f).__name__
                    raise ValueError(
                        f"z has gaps, and filter {j} ({type(f).__module__}.{kind}) cannot drop channels; "
                        "give None, or take a filter of estimators"
                    )
        if np.isinf(values).any():
            channel = int(np.flatnonzero(np.isinf(values))[0])
            raise ValueError(f"z is infinite in channel {channel}; mark a gap with NaN")
        return z, True

    def _stacked(self) -> tuple[Array, Array]:
        """States and covariances of all filters, (r, n) and (r, n, n)."""
        n = np.size(self.filters[0].x)
        x, P = np.empty((self.N, n)), np.empty((self.N, n, n))
        for j, f in enumerate(self.filters):
            if np.size(f.x) != n:
                raise ValueError(
                    f"filter {j} has {np.size(f.x)} states and filter 0 has {n}; they must agree"
                )
            x[j] = np.asarray(f.x, float).reshape(-1)
            try:
                P[j] = square(f.P, n, "P")
            except ValueError as error:
                raise ValueError(f"filter {j}: {error}") from error
            if not np.isfinite(x[j]).all():
                raise ValueError(f"filter {j} has a state that is not finite")
        return x, P

    def _combined(self, weights: Array) -> tuple[Array, Array]:
        mean, covariance = modes.moments(*self._stacked(), weights)
        return mean.reshape(np.shape(self.filters[0].x)), covariance

    @contextmanager
    def _undone_if_refused(self) -> Iterator[None]:
        """Give the filters their attributes back when one of them refuses half-way through the bank."""
        before = [dict(vars(f)) for f in self.filters]
        try:
            yield
        except Exception:
            for f, attributes in zip(self.filters, before, strict=True):
                vars(f).clear()
                vars(f).update(attributes)
            raise


def _ask(j: int, method: Callable[..., None], *args: Any, **kwargs: Any) -> None:
    """Call a filter; a refusal says which one it was."""
    try:
        method(*args, **kwargs)
    except ValueError as error:
        raise ValueError(f"filter {j}: {error}") from error


def _log_likelihood(f: Any, j: int) -> float:
    if hasattr(f, "log_likelihood"):
        value = float(f.log_likelihood)
    else:
        value = math.log(f.likelihood) if f.likelihood > 0.0 else -math.inf
    if math.isnan(value):
        raise ValueError(f"filter {j} has a likelihood that is not a number; check its P and R")
    return value
