"""``python -m reports estimators``: worlds and bound against plain NumPy, verdicts that follow figures."""

import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from estimators.eha import layout
from estimators.eha import model as eha
from fdd.residuals.tracking import METHODS, Tracking
from fdd.unit import Unit
from reports.estimators import runs
from reports.estimators.cases import CASES, FORCE_PERIOD, QUANTITIES, SETTLING, Case, Trajectory, assumed
from reports.estimators.matched import CLEARANCE, LOWEST, draw, eha_bound, matched_unit
from reports.estimators.report import accuracy, coverage, draw_pictures, goals, report_text

SINES, STROKES = Case("sines", "spring"), Case("strokes", "constant")


@pytest.fixture(scope="module")
def axis():
    """Tracker's model and prior of the matched unit."""
    tracking = Tracking(matched_unit(Unit.load("axis_a")), SINES.channels, 1e-3)
    return tracking.model, assumed(tracking.trackers["ekf"])


@pytest.fixture(scope="module")
def drawn(axis):
    """Ten seconds of sines against a spring."""
    return draw(SINES, 10.0, *axis, np.random.default_rng(5))


@pytest.mark.slow
def test_the_matched_world_obeys_the_model_with_its_noise(axis, drawn):
    """What the noise on velocity and speed leaves of each step is white flow noise of the right size."""
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_in_the_matched_world_the_filter_is_consistent():
    """NEES of four parameters over twelve short runs; bounds are 99.9 % ones."""
    found = [runs.evaluate(runs.prepare("matched", SINES, (7, s), 6.0)) for s in range(12)]
    errors, consistency = (
        pd.concat(frames[kind] for frames in found).query("method == 'ekf'")
        for kind in ("errors", "consistency")
    )
    low, high = chi2.interval(0.999, 4 * 12)
    assert low < consistency["nees"].sum() < high
    claimed = (errors["std"] / errors["bound"]).groupby(errors["quantity"]).median()
    np.testing.assert_allclose(claimed[["leakage", "bulk_modulus"]], 1.0, atol=0.1)


@pytest.mark.slow
def test_the_plants_truth_becomes_states():
    """Pressures and flows of the plant's truth, in the model's words, obey the model's volume balance."""
    data = runs.prepare("plant", SINES, (1, 2), 3.0)
    truth, model, every = data.truth, data.tracking.model, data.truth.states
    np.testing.assert_allclose(data.block[:, layout.POSITION] * 1e3, every[:, eha.X], atol=2e-3)
    assert 0.2 < every[0, eha.LEAK] < 2.0
    alone = slice(np.flatnonzero(every[:, eha.P1] < truth.accumulator + 0.03)[-1] + 1, None)  # no valve feeds
    x = every[alone]
    pump, drop = model.displacement * (1.0 + x[0, eha.GAIN]), x[:, eha.P1] - x[:, eha.P2]
    soft = np.array([eha.compliance(p, a, model)[0] for p, a in x[1:, [eha.P1, eha.AIR]]])
    stored = np.sum((model.volume_1 + model.area_1 * x[1:, eha.X]) * soft * np.diff(x[:, eha.P1]))
    leak = model.cross_port_leakage * drop + model.case_leakage * (x[:, eha.P1] - truth.accumulator[alone])
    leaked = np.sum(leak * x[:, eha.LEAK] / truth.viscosity[alone])
    balance = pump * (x[-1, eha.TH] - x[0, eha.TH]) - model.area_1 * (x[-1, eha.X] - x[0, eha.X])
    assert len(x) > 1500 and abs(balance - stored - leaked) < 2e-3 * pump * np.ptp(x[:, eha.TH])


@pytest.mark.slow
def test_filterpys_filter_follows_the_same_run():
    data, rows = runs.prepare("matched", CASES[0], (4, 4), 1.0), np.array([300, 500])
    states, variances = runs.filterpy_ekf(data.tracking.model, data.prior, data.block, rows)
    error = states - data.truth.states[rows]
    assert np.abs(error[:, eha.X]).max() < 3e-3 and np.abs(error[:, eha.P1]).max() < 0.02
    assert (variances[:, eha.LEAK] < data.prior.spread[eha.LEAK] ** 2 * 1.01).all()


@pytest.fixture(scope="module")
def sliding(axis):
    """A run of the model that slides one way all the time."""
    truth, _ = draw(STROKES, 2.0, *axis, np.random.default_rng(1))
    fast = int(np.argmax(np.abs(truth.states[:, eha.V]) > 0.05))
    return (*axis, Trajectory(*(each[fast : fast + 200] for each in truth)))


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


NAME = "steps, none, all"
TRUTH = np.array([6e-12, 2e8, 150.0, 60.0])


def many(error=1.0, nees=4.0, halves=np.linspace(0.1, 2.1, 21)) -> runs.Measured:
    """Runs with errors of `error` times a bound of 2 % (4 N·s/m)."""
    rng, count = np.random.default_rng(1), 200
    at = pd.MultiIndex.from_product([range(count), METHODS, QUANTITIES, range(runs.CHECKS)])
    errors = at.to_frame(index=False, name=["run", "method", "quantity", "check"])
    errors["truth"] = errors["quantity"].map(dict(zip(QUANTITIES, TRUTH, strict=True)))
    errors["bound"] = np.where(errors["quantity"] == QUANTITIES[3], 4.0, 0.02 * errors["truth"])
    errors["error"] = error * errors["bound"] * rng.standard_normal(len(errors))
    consistency = pd.DataFrame([
        {"run": run, "method": m, "nees": nees, **dict.fromkeys(QUANTITIES, 0.0)}
        for run in range(count) for m in METHODS
    ])  # fmt: skip
    steps = pd.DataFrame([
        {"run": run, "method": m, "half": t, "response": np.zeros(runs.GRID.size), "case": "leakage"}
        for run, t in enumerate(halves) for m in METHODS
    ])  # fmt: skip
    return {
        "errors": errors.assign(std=errors["bound"], flag=True, world="plant", case=NAME),
        "consistency": consistency.assign(world="plant", case=NAME),
        "steps": steps.assign(world="plant"),
    }


def test_figures_are_those_of_the_draw():
    found = many(error=1.3)
    each = accuracy(found["errors"]).loc["plant", NAME]
    a = each.loc["leakage", "ekf"]
    assert a["counted"] and a["flagged"] == 1.0
    assert a["rmse"] / a["bound"] == pytest.approx(1.3, rel=0.1) and a["bound"] == pytest.approx(2.0)
    assert a["rmse"] == pytest.approx(np.hypot(a["bias"], a["spread"]))
    assert each.loc["viscous_friction", "svsf"]["bound"] == pytest.approx(4.0)  # N·s/m, not percent
    c = coverage(found["consistency"]).loc["plant", NAME, "ekf"]
    assert (c["nees"], c["lost"]) == (1.0, 0.0)


SHORT = [({}, None), ({"error": 1.8}, "bound"), ({"nees": 12.0}, "NEES"), ({"nees": np.nan}, "NEES")]


@pytest.mark.parametrize(("settings", "short"), [*SHORT, ({"halves": (0.5, 2.5)}, "change")])
def test_a_goal_is_short_where_its_figure_is(settings, short):
    for goal in goals(many(**settings), "plant"):
        assert goal.total > 0
        missed = short is not None and short in goal.name
        assert (goal.met < goal.total) == missed, goal.name
        assert bool(goal.short) == missed
    if short == "change":
        assert goal.short == ("leakage, EKF: 2.50 s", "leakage, SVSF: 2.50 s")


@pytest.mark.slow
def test_a_tiny_run_makes_the_whole_report(tmp_path):
    plan = runs.Plan(runs=2, duration=3.0, cases=(NAME,), stepped=("leakage",))
    told: list[float] = []
    found = runs.measure(plan, 1, told.append)
    assert told[-1] == 1.0 and told == sorted(told)
    text = report_text(plan, found)
    for part in ("## Goals", "## Matched world", "## Plant world", "## A sudden change"):
        assert part in text
    assert text.count(f"| {NAME} |") == 4 and "## Speed" not in text
    draw_pictures(found, tmp_path)
    heads = {p.name: p.read_bytes()[:4] for p in tmp_path.iterdir()}
    assert heads == dict.fromkeys(("coverage.png", "steps.png"), b"\x89PNG")
    again = runs.measure(runs.Plan(runs=2, duration=3.0, cases=(NAME,), stepped=()))
    pd.testing.assert_frame_equal(again["errors"], found["errors"])


BALANCE = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "volume_balance.py"))
Window, fit_balance = BALANCE["Window"], BALANCE["fit_balance"]


def test_least_squares_finds_what_the_model_leaks_and_holds_of_air(axis):
    """Three seconds of the model's own steps, without noise: the pump holds a difference that swings."""
    model, x, rows = axis[0], np.zeros(eha.STATES), []
    x[[eha.LEAK, eha.AIR, eha.FRIC, eha.P1, eha.P2]] = 1.7, 5.0, 1.0, 1.2, 1.2
    new, F, G = np.empty(eha.STATES), np.empty((eha.STATES, eha.STATES)), np.empty((eha.STATES, 4))
    for t in np.arange(12_000) * 0.25e-3:  # steps of first order: shorter than the samples
        wanted = 0.8 * np.sin(2.0 * np.pi * 0.9 * t) + 0.4 * np.sin(2.0 * np.pi * 3.1 * t)
        x[eha.V] = 0.075 * np.cos(2.0 * np.pi * 0.4 * t)
        x[eha.W] = model.area_1 * x[eha.V] / model.displacement + 0.02 * (wanted - x[eha.P1] + x[eha.P2])
        rows.append(x.copy())
        eha.step(x, 0.25, 1.0, 0.2, x[eha.V], x[eha.W], model, new, F, G)
        x = new.copy()
    signals = np.array(rows)[::4, [eha.X, eha.TH, eha.P1, eha.P2]].T
    window = Window(*signals, np.full(3000, 0.2))
    assert window.pressure_1.min() > 0.23 and window.pressure_2.min() > 0.23
    for sealed in (False, True):
        leakage, air = fit_balance(window, model, sealed=sealed)
        assert leakage == pytest.approx(1.7, rel=1e-4)
        assert air == pytest.approx(5.0, rel=5e-3)
