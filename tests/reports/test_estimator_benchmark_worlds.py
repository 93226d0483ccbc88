"""The data of the benchmark: what the matched world draws, what least squares makes of exact data, the
plant's truth."""

import numpy as np
import pandas as pd
import pytest

from estimators.consistency import nees_band
from estimators.eha import layout
from estimators.eha import model as eha
from fdd.residuals.tracking import Channels, Tracking
from fdd.unit import Unit
from reports.estimators.cases import CASES, Case
from reports.estimators.least_squares import Window, fit_balance
from reports.estimators.matched import CLEARANCE, LOWEST, draw, matched_unit
from reports.estimators.model import assumed
from reports.estimators.peers import PEERS, run_peer
from reports.estimators.runs import evaluate, nis_of_run, prepare

pytestmark = pytest.mark.slow
SINES = Case("sines", "spring")


@pytest.fixture(scope="module")
def axis():
    """Tracker's model and prior of the matched unit."""
    tracking = Tracking(matched_unit(Unit.load("axis_a")), Channels(SINES.channels), 1e-3)
    return tracking.model, assumed(tracking.trackers["ekf"])


@pytest.fixture(scope="module")
def drawn(axis):
    """Ten seconds of sines against a spring."""
    return draw(SINES, 10.0, *axis, np.random.default_rng(5))


def test_the_matched_world_obeys_the_model_with_its_noise(axis, drawn):
    """What is left of each step after the noise on velocity and speed is white flow noise of the right
    size."""
    model, prior = axis
    truth, _ = drawn
    x = truth.states
    flows = np.empty((x.shape[0] - 1, 2))
    new, F, G = np.empty(eha.STATES), np.empty((eha.STATES,) * 2), np.empty((eha.STATES, 4))
    for k in range(x.shape[0] - 1):
        eha.step(x[k], 1.0, 1.0, truth.accumulator[0], np.nan, np.nan, model, new, F, G)
        motion = np.array([x[k + 1, eha.V] - new[eha.V], x[k + 1, eha.W] - new[eha.W]])
        left = x[k + 1] - new - G[:, :2] @ motion
        np.testing.assert_allclose(left[[eha.X, eha.TH]], 0.0, atol=1e-9)
        flows[k] = left[eha.P1] / G[eha.P1, 2], left[eha.P2] / G[eha.P2, 3]
    np.testing.assert_allclose(flows.std(axis=0), prior.sizes.small, rtol=0.03)  # 4 sigma of 10 000
    assert np.abs(flows.mean(axis=0)).max() < 4.0 * prior.sizes.small / 100.0
    assert abs(np.corrcoef(flows[1:, 0], flows[:-1, 0])[0, 1]) < 0.04
    assert abs(np.corrcoef(flows.T)[0, 1]) < 0.04


def test_its_parameters_walk_and_its_sensors_err_as_the_filter_assumes(axis, drawn):
    _, prior = axis
    truth, block = drawn
    walking = [eha.AIR, eha.FRIC, eha.VISC, eha.SKEW]  # leakage walks in proportion where it has grown
    walks = np.diff(truth.states[:, walking], axis=0).std(axis=0)
    np.testing.assert_allclose(walks, prior.walk[walking] * np.sqrt(1e-3), rtol=0.03)
    errors = np.column_stack([
        block[:, layout.POSITION] * 1e3 - truth.states[:, eha.X],
        block[:, layout.ANGLE] - truth.states[:, eha.TH],
        block[:, layout.PRESSURE_1] * 1e-6 - truth.states[:, eha.P1],
    ])  # fmt: skip
    s = prior.sizes
    np.testing.assert_allclose(errors.std(axis=0), [s.position, s.angle, s.pressure], rtol=0.03)
    lowest = truth.states[:, [eha.P1, eha.P2]].min()
    assert lowest == pytest.approx(LOWEST, abs=0.01)
    assert truth.accumulator[0] == pytest.approx(LOWEST - CLEARANCE)


def exact_window(model, leakage, air, gain, n=6000):
    """Signals that keep both chambers' balances by fine sums of the differentials themselves."""
    fine = 8
    t = np.arange(n * fine) / fine * 1e-3
    x = 30.0 * np.sin(2.0 * np.pi * 0.4 * t)
    p1 = 1.2 + 0.4 * np.sin(2.0 * np.pi * 0.9 * t + 1.0) + 0.2 * np.sin(2.0 * np.pi * 3.1 * t)
    v1 = model.volume_1 + model.area_1 * x
    v2 = model.volume_2 - model.area_2 * x
    exponent = model.polytropic_index

    def compliance(p):
        c = 0.101325 ** (1.0 / exponent) / (exponent * (p + 0.101325) ** (1.0 + 1.0 / exponent))
        return model.stiff_compliance + 1e-3 * air * c

    # Chamber 1 says how far the pump turned, chamber 2's pressure follows from that.
    h = 1.0 / fine
    p2, angle, accumulator = np.empty_like(t), np.zeros_like(t), 0.2
    p2[0] = 3.3
    dx, dp1 = np.diff(x), np.diff(p1)
    middle1, middle_v1 = 0.5 * (p1[1:] + p1[:-1]), 0.5 * (v1[1:] + v1[:-1])
    stored1 = middle_v1 * compliance(middle1) * dp1
    for k in range(t.size - 1):
        drop = middle1[k] - p2[k]
        leak1 = (
            leakage * (model.cross_port_leakage * drop + model.case_leakage * (middle1[k] - accumulator)) * h
        )
        leak2 = leakage * (-model.cross_port_leakage * drop + model.case_leakage * (p2[k] - accumulator)) * h
        nodes = np.linspace(p2[k], middle1[k], 5)
        denser = 0.5 * np.trapezoid(compliance(nodes), nodes)
        pumped = (model.area_1 * dx[k] + leak1 + stored1[k]) / (1.0 - denser)
        angle[k + 1] = angle[k] + pumped / (model.displacement * (1.0 + gain))
        inflow = model.area_2 * dx[k] - pumped * (1.0 + denser) - leak2
        p2[k + 1] = p2[k] + inflow / (0.5 * (v2[k] + v2[k + 1]) * compliance(p2[k]))
    at = slice(None, None, fine)
    return Window(x[at], angle[at], p1[at], p2[at], np.full(n, accumulator))


def test_least_squares_finds_exact_data():
    model = Tracking(Unit.load("axis_a"), Channels(SINES.channels), 1e-3).model
    window = exact_window(model, 1.7, 5.0, 2e-3)
    assert window.pressure_2.min() > 0.23
    assert fit_balance(window, model) == pytest.approx((1.7, 5.0), rel=5e-3)
    assert fit_balance(window, model, sealed=True) == pytest.approx((1.7, 5.0), rel=5e-3)


def test_the_nis_of_a_consistent_filter_is_in_its_band():
    rng = np.random.default_rng(9)
    inside = 0
    for _ in range(400):
        mean, low, high = nis_of_run(rng.chisquare(20, 300) / 10.0, 10, 2)
        inside += low <= mean <= high
    assert 0.91 <= inside / 400 <= 0.99


def test_in_the_matched_world_the_filter_is_consistent():
    """NEES of four parameters and mean NIS over twelve short runs; bounds are 99.9 % ones."""
    errors, consistency = (
        pd.concat(frames).query("method == 'ekf'")
        for frames in zip(
            *(evaluate(SINES, prepare("matched", SINES, (7, s), 6.0)) for s in range(12)), strict=True
        )
    )
    low, high = nees_band(4, 12, 0.999)
    assert low < consistency["nees"].mean() < high
    assert consistency["nis"].mean() == pytest.approx(1.0, abs=0.02)
    claimed = (errors["std"] / errors["bound"]).groupby(errors["quantity"]).median()
    np.testing.assert_allclose(claimed[["leakage", "bulk_modulus"]], 1.0, atol=0.1)


def test_the_plants_truth_becomes_states():
    """Pressures and flows of the plant's truth, in the model's words, obey the model's volume balance."""
    data = prepare("plant", SINES, (1, 2), 3.0)
    x, model = data.truth.states, data.tracking.model
    pump = model.displacement * (1.0 + x[0, eha.GAIN])
    drop = x[:, eha.P1] - x[:, eha.P2]
    moved = pump * np.ptp(x[:, eha.TH])
    i1 = np.array([eha.compliance(p, a, model)[0] for p, a in x[::10][:, [eha.P1, eha.AIR]]])
    stored = np.sum((model.volume_1 + model.area_1 * x[10::10, eha.X]) * i1[1:] * np.diff(x[::10, eha.P1]))
    leak = model.cross_port_leakage * drop + model.case_leakage * (x[:, eha.P1] - data.truth.accumulator)
    leaked = np.sum(leak * x[:, eha.LEAK] / data.truth.viscosity)
    balance = pump * (x[-1, eha.TH] - x[0, eha.TH]) - model.area_1 * (x[-1, eha.X] - x[0, eha.X])
    fed = x[:, eha.P1] < data.truth.accumulator
    if not fed.any():
        assert abs(balance - stored - leaked) < 2e-3 * moved
    np.testing.assert_allclose(data.block[:, layout.POSITION] * 1e3, x[:, eha.X], atol=2e-3)
    assert 0.2 < x[0, eha.LEAK] < 2.0


def test_peers_follow_the_same_run():
    case = CASES[0]
    data = prepare("matched", case, (4, 4), 1.0)
    rows = np.array([500, 900])
    for name in PEERS:
        part = data.block if name == PEERS[0] else data.block[:120]
        at = rows if name == PEERS[0] else np.array([60, 110])
        states, variances = run_peer(name, data.tracking.model, data.prior, part, case.minimum, at)
        error = states - data.truth.states[at]
        assert np.abs(error[:, eha.X]).max() < 3e-3 and np.abs(error[:, eha.P1]).max() < 0.02
        assert (variances[:, eha.LEAK] < data.prior.spread[eha.LEAK] ** 2 * 1.01).all()
