"""filterpy's extended and unscented Kalman filters on the estimators' model.

They get the same model (one compiled millisecond of `estimators.eha.model`), the same noise, channels and
first estimate. What a textbook filter cannot say is left out: they linearise at their own prediction (the EKF
at its estimate) and not at what the encoders measure; friction and load are learned sample by sample from the
velocity equation and not from 20 ms force balances; nothing robust, no bounds on parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.eha import layout
from estimators.eha import model as eha
from evidence.estimators.model import (
    LOW_SIDE,
    LOW_SIDE_TIME,
    N_ACCELERATION,
    N_ANGLE,
    N_DIFFERENCE,
    N_FORCE,
    N_POSITION,
    N_PRESSURE,
    Assumed,
    chamber_noise,
)

Array = NDArray[np.float64]

PEERS = ("filterpy EKF", "filterpy UKF")
ALPHA, BETA, KAPPA = 0.1, 2.0, 3.0 - eha.STATES
"""Of the scaled sigma points (van der Merwe 2004): spread, Gaussian prior, and 3 - n."""


@dataclass
class _Model:
    """The model as filterpy takes it; `row` is the sample that a step starts from."""

    q: eha.Parameters
    prior: Assumed
    block: Array
    minimum: bool
    row: int = 0

    def __post_init__(self) -> None:
        self.F, self.G = np.empty((eha.STATES, eha.STATES)), np.empty((eha.STATES, 4))
        self.z = _measurements(self.block, self.minimum, float(self.q.accumulator_pressure))
        self.p_acc = self.block[:, layout.ACCUMULATOR] * 1e-6
        self.known = not self.minimum
        if self.minimum:
            self.p_acc = np.full(self.block.shape[0], self.q.accumulator_pressure)
        viscosity = self.block[:, layout.VISCOSITY]
        self.viscosity = np.where(np.isnan(viscosity), 1.0, viscosity)

    def step(self, x: Array, _dt: float = 1.0) -> Array:
        new = np.empty(eha.STATES)
        at = self.row
        eha.step(x, 1.0, self.viscosity[at], self.p_acc[at], np.nan, np.nan, self.q, new, self.F, self.G)
        return new

    def Q(self, x: Array) -> Array:
        sizes = self.prior.sizes
        sd = chamber_noise(x[eha.P1], x[eha.P2], self.p_acc[self.row], self.known, sizes)
        noise = np.array([sizes[N_FORCE], sizes[N_ACCELERATION], *sd]) ** 2
        return np.asarray((self.G * noise) @ self.G.T + np.diag(self.prior.walk**2 * 1e-3))

    def h(self, x: Array) -> Array:
        if not self.minimum:
            return x[[eha.X, eha.TH, eha.P1, eha.P2]]
        return np.array([x[eha.X], x[eha.TH], x[eha.P1] - x[eha.P2], min(x[eha.P1], x[eha.P2])])

    def H(self, x: Array) -> Array:
        out = np.zeros((4, eha.STATES))
        out[0, eha.X] = out[1, eha.TH] = 1.0
        if not self.minimum:
            out[2, eha.P1] = out[3, eha.P2] = 1.0
        else:
            out[2, eha.P1], out[2, eha.P2] = 1.0, -1.0
            out[3, eha.P1 if x[eha.P1] <= x[eha.P2] else eha.P2] = 1.0
        return out

    @property
    def R(self) -> Array:
        sizes = self.prior.sizes
        last = (sizes[N_DIFFERENCE], LOW_SIDE * np.sqrt(LOW_SIDE_TIME)) if self.minimum else (
            sizes[N_PRESSURE], sizes[N_PRESSURE])  # fmt: skip
        return np.diag(np.array([sizes[N_POSITION], sizes[N_ANGLE], *last]) ** 2)

    def start(self) -> Array:
        x = self.prior.start.copy()
        first = self.z[0]
        x[[eha.X, eha.TH]] = first[:2]
        x[[eha.P1, eha.P2]] = first[2:]
        if self.minimum:
            x[eha.P1] = first[3] + max(first[2], 0.0)
            x[eha.P2] = first[3] + max(-first[2], 0.0)
        return x


def run_peer(
    name: str, q: eha.Parameters, prior: Assumed, block: Array, minimum: bool, rows: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Run one of `PEERS` over a block.

    Parameters
    ----------
    name : of the peer. q, prior : the model. block : as the tracker takes it, without gaps.
    minimum : the smallest set of sensors. rows : (k,) ascending.

    Returns
    -------
    states, variances : (k, STATES); NaN from where the peer's covariance was lost.

    Raises
    ------
    ImportError : filterpy is not installed.
    """
    model = _Model(q, prior, block, minimum)
    peer = _extended(model) if name == PEERS[0] else _unscented(model)
    out = np.full((2, rows.size, eha.STATES), np.nan)
    wanted = 0
    for k in range(block.shape[0]):
        try:
            if k > 0:
                model.row = k - 1
                peer.predict()
            peer.update(model.z[k])
        except np.linalg.LinAlgError:
            break
        if not np.isfinite(peer.x).all():
            break
        if rows[wanted] == k:
            out[0, wanted], out[1, wanted] = peer.x, np.diag(peer.P)
            wanted += 1
            if wanted == rows.size:
                break
    return out[0], out[1]


class _Peer:
    """predict() and update(z) of either filter."""

    def __init__(self, inner: object, model: _Model, extended: bool) -> None:
        self._inner, self._model, self._extended = inner, model, extended

    @property
    def x(self) -> Array:
        return np.asarray(self._inner.x)  # type: ignore[attr-defined]

    @property
    def P(self) -> Array:
        return np.asarray(self._inner.P)  # type: ignore[attr-defined]

    def predict(self) -> None:
        inner, model = self._inner, self._model
        new = model.step(self.x)
        inner.Q = model.Q(self.x)  # type: ignore[attr-defined]
        if self._extended:
            inner.F = model.F  # type: ignore[attr-defined]
            inner.predict_x = lambda u=0: setattr(inner, "x", new)  # type: ignore[attr-defined]
        inner.predict()  # type: ignore[attr-defined]

    def update(self, z: Array) -> None:
        if self._extended:
            self._inner.update(z, self._model.H, self._model.h)  # type: ignore[attr-defined]
        else:
            self._inner.update(z)  # type: ignore[attr-defined]


def _extended(model: _Model) -> _Peer:
    from filterpy.kalman import ExtendedKalmanFilter

    inner = ExtendedKalmanFilter(eha.STATES, 4)
    inner.x, inner.P, inner.R = model.start(), np.diag(model.prior.spread**2), model.R
    return _Peer(inner, model, True)


def _unscented(model: _Model) -> _Peer:
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    points = MerweScaledSigmaPoints(eha.STATES, ALPHA, BETA, KAPPA)
    inner = UnscentedKalmanFilter(eha.STATES, 4, 1.0, model.h, model.step, points)
    inner.x, inner.P, inner.R = model.start(), np.diag(model.prior.spread**2), model.R
    return _Peer(inner, model, False)


def _measurements(block: Array, minimum: bool, charge: float) -> Array:
    """(n, 4) what the peers measure, model units."""
    position = block[:, layout.POSITION] * 1e3
    if minimum:
        angle = np.cumsum(block[:, layout.SPEED]) * 1e-3
        low = np.full(position.size, charge)
        return np.column_stack([position, angle, block[:, layout.DIFFERENCE] * 1e-6, low])
    pressures = block[:, [layout.PRESSURE_1, layout.PRESSURE_2]] * 1e-6
    return np.column_stack([position, block[:, layout.ANGLE], pressures])
