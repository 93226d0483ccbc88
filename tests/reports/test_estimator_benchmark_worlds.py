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
from reports.estimators.cases import CASES, Case, assumed
from reports.estimators.matched import CLEARANCE, LOWEST, draw, matched_unit
from reports.estimators.peers import PEERS, run_peer
from reports.estimators.runs import evaluate, prepare

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


def test_in_the_matched_world_the_filter_is_consistent():
    """NEES of four parameters over twelve short runs; bounds are 99.9 % ones."""
    found = [evaluate(prepare("matched", SINES, (7, s), 6.0)) for s in range(12)]
    errors, consistency = (
        pd.concat(frames[kind] for frames in found).query("method == 'ekf'")
        for kind in ("errors", "consistency")
    )
    low, high = nees_band(4, 12, 0.999)
    assert low < consistency["nees"].mean() < high
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
