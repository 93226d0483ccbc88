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
from reports.estimators.model import LOW_SIDE, LOW_SIDE_TIME, Assumed, chamber_noise

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
        noise = np.array([sizes.force, sizes.acceleration, *sd]) ** 2
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
        last = (sizes.difference, LOW_SIDE * np.sqrt(LOW_SIDE_TIME)) if self.minimum else (
            sizes.pressure, sizes.pressure)  # fmt: skip
        return np.diag(np.array([sizes.position, sizes.angle, *last]) ** 2)

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

    The block is as the tracker takes it, without gaps; rows (k,) are ascending.

    Gives `states`, `variances`: (k, STATES); NaN from where the peer's covariance was lost.
    """
    from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

    model = _Model(q, prior, block, minimum)
    extended = name == PEERS[0]
    if extended:
        peer = ExtendedKalmanFilter(eha.STATES, 4)
    else:
        points = MerweScaledSigmaPoints(eha.STATES, ALPHA, BETA, KAPPA)
        peer = UnscentedKalmanFilter(eha.STATES, 4, 1.0, model.h, model.step, points)
    peer.x, peer.P, peer.R = model.start(), np.diag(prior.spread**2), model.R

    def predict() -> None:
        new, peer.Q = model.step(peer.x), model.Q(peer.x)
        if extended:
            peer.F = model.F
            peer.predict_x = lambda u=0: setattr(peer, "x", new)
        peer.predict()

    out = np.full((2, rows.size, eha.STATES), np.nan)
    wanted = 0
    for k in range(block.shape[0]):
        try:
            if k > 0:
                model.row = k - 1
                predict()
            peer.update(model.z[k], *((model.H, model.h) if extended else ()))
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


def _measurements(block: Array, minimum: bool, charge: float) -> Array:
    """(n, 4) what the peers measure, model units."""
    position = block[:, layout.POSITION] * 1e3
    if minimum:
        angle = np.cumsum(block[:, layout.SPEED]) * 1e-3
        low = np.full(position.size, charge)
        return np.column_stack([position, angle, block[:, layout.DIFFERENCE] * 1e-6, low])
    pressures = block[:, [layout.PRESSURE_1, layout.PRESSURE_2]] * 1e-6
    return np.column_stack([position, block[:, layout.ANGLE], pressures])
