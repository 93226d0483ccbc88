"""The compiled Cramér-Rao bound: the recursion in plain NumPy, and what more sensors tell."""

import numpy as np
import pytest

from estimators.eha import model as eha
from fdd.residuals.tracking import Channels, Tracking
from fdd.unit import Unit
from reports.estimators.cases import FORCE_PERIOD, SETTLING, Case, Trajectory, assumed
from reports.estimators.matched import draw, eha_bound, matched_unit


@pytest.fixture(scope="module")
def sliding():
    """A run of the model that slides one way all the time."""
    unit = matched_unit(Unit.load("axis_a"))
    tracking = Tracking(unit, Channels(Case("strokes", "constant").channels), 1e-3)
    prior = assumed(tracking.trackers["ekf"])
    truth, _ = draw(Case("strokes", "constant"), 2.0, tracking.model, prior, np.random.default_rng(1))
    fast = int(np.argmax(np.abs(truth.states[:, eha.V]) > 0.05))
    part = slice(fast, fast + 200)
    return (
        tracking.model,
        prior,
        Trajectory(truth.states[part], truth.accumulator[part], truth.viscosity[part]),
    )


def test_the_compiled_bound_is_the_recursion_on_the_eha_model(sliding):
    """Dense matrices and inverses in NumPy, with a mean force every 20 ms once 80 ms have been slid."""
    model, prior, truth = sliding
    x, sizes = truth.states, prior.sizes
    rows = np.array([50, 99, 150, 199])
    found = eha_bound(truth, model, prior, False, rows)

    H = np.zeros((4, eha.STATES))
    for row, state in enumerate((eha.X, eha.TH, eha.P1, eha.P2)):
        H[row, state] = 1.0
    R = np.diag(np.array([sizes.position, sizes.angle, sizes.pressure, sizes.pressure]) ** 2)
    noise = np.diag(np.array([sizes.force, sizes.acceleration, sizes.small, sizes.small]) ** 2)
    P, new = np.diag(prior.spread**2), np.empty(eha.STATES)
    F, G = np.empty((eha.STATES, eha.STATES)), np.empty((eha.STATES, 4))
    assert np.abs(x[:, eha.V]).min() > 0.01
    for k in range(x.shape[0]):
        if k:
            at = x[k, [eha.V, eha.W]]
            eha.step(x[k - 1], 1.0, 1.0, truth.accumulator[0], at[0], at[1], model, new, F, G)
            F[: eha.P2 + 1, eha.FRIC :] = 0.0
            F = F - np.diag(prior.pull * 1e-3)
            P = F @ P @ F.T + G @ noise @ G.T + np.diag(prior.walk**2 * 1e-3)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        I_KH = np.eye(eha.STATES) - K @ H
        P = I_KH @ P @ I_KH.T + K @ R @ K.T
        if (k + 1) % FORCE_PERIOD == 0 and k >= SETTLING:
            period = x[k - FORCE_PERIOD + 1 : k + 1]
            v = period[:, eha.V]
            h = np.zeros(eha.STATES)
            h[eha.FRIC] = np.mean([eha.friction_curve(value, model)[0] for value in v])
            h[eha.SKEW] = np.abs(v).mean()
            h[eha.VISC], h[eha.LOAD], h[eha.STIF] = v.mean(), 1.0, period[:, eha.X].mean()
            h[eha.THROT], h[eha.INERT] = (v * np.abs(v)).mean(), (v[-1] - v[0]) / FORCE_PERIOD * 1e3
            gain = P @ h / (h @ P @ h + sizes.force_mean**2)
            P = P - np.outer(gain, h @ P)
        if k in rows:
            at_row = found[list(rows).index(k)]
            # 1e-7 mm² of position beside 1e6 of the load: dense algebra keeps few digits of the motion.
            parameters = slice(eha.P2 + 1, eha.STATES)
            np.testing.assert_allclose(at_row[parameters], np.diag(P)[parameters], rtol=1e-5)
    # A throttle at 0.06 m/s may carry kilonewtons: the mean forces leave a third of it.
    assert found[-1, eha.THROT] < 0.33 * prior.spread[eha.THROT] ** 2
