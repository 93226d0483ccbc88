"""filterpy's extended and unscented Kalman filters on the estimators' model.

They get the same model (one compiled millisecond of `estimators.eha.model`), the same noise, channels and
first estimate. What a textbook filter cannot say is left out: they linearise at their own prediction (the EKF
at its estimate) and not at what the encoders measure; friction and load are learned sample by sample from the
velocity equation and not from 20 ms force balances; nothing robust, no bounds on parameters.
"""

from __future__ import annotations

import numpy as np

from estimators.eha import layout
from estimators.eha import model as eha
from reports.estimators.cases import LOW_SIDE, LOW_SIDE_TIME, Array, Assumed, Rows, chamber_noise

PEERS = ("filterpy EKF", "filterpy UKF")
ALPHA, BETA, KAPPA = 0.1, 2.0, 3.0 - eha.STATES
"""Of the scaled sigma points (van der Merwe 2004): spread, Gaussian prior, and 3 - n."""


class _Model:
    """The model as filterpy takes it; `row` is the sample that a step starts from."""

    def __init__(self, q: eha.Parameters, prior: Assumed, block: Array, minimum: bool) -> None:
        self.q, self.prior, self.minimum, self.row = q, prior, minimum, 0
        self.F, self.G = np.empty((eha.STATES, eha.STATES)), np.empty((eha.STATES, 4))
        self.viscosity = np.nan_to_num(block[:, layout.VISCOSITY], nan=1.0)
        position, sizes = block[:, layout.POSITION] * 1e3, prior.sizes
        if minimum:
            self.p_acc = np.full(block.shape[0], q.accumulator_pressure)
            angle = np.cumsum(block[:, layout.SPEED]) * 1e-3
            # The low side counts as measured at the accumulator's charge.
            self.z = np.column_stack([position, angle, block[:, layout.DIFFERENCE] * 1e-6, self.p_acc])
            last = sizes.difference, LOW_SIDE * np.sqrt(LOW_SIDE_TIME)
        else:
            self.p_acc = block[:, layout.ACCUMULATOR] * 1e-6
            pressures = block[:, [layout.PRESSURE_1, layout.PRESSURE_2]] * 1e-6
            self.z = np.column_stack([position, block[:, layout.ANGLE], pressures])
            last = sizes.pressure, sizes.pressure
        self.R = np.diag(np.array([sizes.position, sizes.angle, *last]) ** 2)
        self.x = prior.start.copy()
        self.x[[eha.X, eha.TH, eha.P1, eha.P2]] = self.z[0]
        if minimum:
            drop, low = self.z[0, 2:]
            self.x[[eha.P1, eha.P2]] = low + max(drop, 0.0), low + max(-drop, 0.0)

    def step(self, x: Array, _dt: float = 1.0) -> Array:
        new, at = np.empty(eha.STATES), self.row
        eha.step(x, 1.0, self.viscosity[at], self.p_acc[at], np.nan, np.nan, self.q, new, self.F, self.G)
        return new

    def Q(self, x: Array) -> Array:
        sizes = self.prior.sizes
        sd = chamber_noise(x[eha.P1], x[eha.P2], self.p_acc[self.row], not self.minimum, sizes)
        noise = np.array([sizes.force, sizes.acceleration, *sd]) ** 2
        return np.asarray((self.G * noise) @ self.G.T + np.diag(self.prior.walk**2 * 1e-3))

    def h(self, x: Array) -> Array:
        if not self.minimum:
            return x[[eha.X, eha.TH, eha.P1, eha.P2]]
        return np.array([x[eha.X], x[eha.TH], x[eha.P1] - x[eha.P2], min(x[eha.P1], x[eha.P2])])

    def H(self, x: Array) -> Array:
        out = np.zeros((4, eha.STATES))
        out[0, eha.X] = out[1, eha.TH] = out[2, eha.P1] = 1.0
        if self.minimum:
            out[2, eha.P2] = -1.0
            out[3, eha.P1 if x[eha.P1] <= x[eha.P2] else eha.P2] = 1.0
        else:
            out[3, eha.P2] = 1.0
        return out


def run_peer(
    name: str, q: eha.Parameters, prior: Assumed, block: Array, minimum: bool, rows: Rows
) -> tuple[Array, Array]:
    """Run one of `PEERS` over a block as the tracker takes it, without gaps; rows (k,) are ascending.

    Gives `states`, `variances`: (k, STATES); NaN from where the peer's covariance was lost.
    """
    from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

    model, extended = _Model(q, prior, block, minimum), name == PEERS[0]
    if extended:
        peer = ExtendedKalmanFilter(eha.STATES, 4)
    else:
        points = MerweScaledSigmaPoints(eha.STATES, ALPHA, BETA, KAPPA)
        peer = UnscentedKalmanFilter(eha.STATES, 4, 1.0, model.h, model.step, points)
    peer.x, peer.P, peer.R = model.x, np.diag(prior.spread**2), model.R

    def predict() -> None:
        new, peer.Q = model.step(peer.x), model.Q(peer.x)
        if extended:
            peer.F = model.F
            peer.predict_x = lambda u=0: setattr(peer, "x", new)
        peer.predict()

    found = np.full((2, rows.size, eha.STATES), np.nan)
    for k in range(rows[-1] + 1):
        try:
            if k > 0:
                model.row = k - 1
                predict()
            peer.update(model.z[k], *((model.H, model.h) if extended else ()))
        except np.linalg.LinAlgError:
            break
        if not np.isfinite(peer.x).all():
            break
        found[:, rows == k] = np.stack([peer.x, np.diag(peer.P)])[:, None]
    return found[0], found[1]
