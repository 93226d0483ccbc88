"""The stated population's draws, and what healthy units and logs differ by, learnt from known spreads."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fdd import Scenario, Unit
from fdd.campaign import population
from fdd.campaign.drawing import draw_unit, stream
from fdd.campaign.population import BETWEEN_UNITS, FRICTION, OIL_VOLUME, WANDER, charge_factor, with_its_air
from fdd.campaign.recipe import Recipe
from fdd.campaign.scenarios import as_it_runs, draw_scenario
from fdd.campaign.spreads import UnitLogs, learnt_spread, learnt_wander
from fdd.diagnosis.baseline import log_equations, scattered
from fdd.plant import conditions as c
from fdd.plant.oil import stiff_bulk_modulus
from fdd.plant.prepare import FRICTION_TIME, axis_conditions
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import LogConditions, first_effects, usual_conditions
from fdd.residuals.normal_equations import marginalised

STATED = Recipe(schema="fdd.recipe/1", healthy_share=1.0, population="stated", bases=["axis_a"])


def test_units_differ_by_what_is_stated() -> None:
    """Moments of 60 drawn units: within four standard errors of the table."""
    number = 60
    units = [draw_unit(STATED, stream(STATED, "unit", k), k).unit for k in range(number)]
    base, error = Unit.load("axis_a"), 4.0 / math.sqrt(2.0 * number)
    assert units[7] == draw_unit(STATED, stream(STATED, "unit", 7), 7).unit
    for section, spreads in (*BETWEEN_UNITS.items(), ("accumulator", OIL_VOLUME)):
        for name, spread in spreads.items():
            if name == "bulk_modulus":
                continue  # of the stiff part alone; below
            ratio = np.array([getattr(getattr(u, section), name) for u in units])
            ratio /= getattr(getattr(base, section), name)
            seen = np.log(ratio) if spread.distribution == "lognormal" else ratio - 1.0
            std = spread.width / math.sqrt(3.0) if spread.distribution == "uniform" else spread.width
            assert seen.std() == pytest.approx(std, rel=error), (section, name)
            assert abs(seen.mean()) < 4.0 * std / math.sqrt(number), (section, name)
    static = np.log([[u.friction.forward.static, u.friction.reverse.static] for u in units])
    common, own = population.FRICTION_LEVEL.width, FRICTION["static"].width
    assert static.std(axis=0) == pytest.approx([math.hypot(common, own)] * 2, rel=error)
    together = np.corrcoef(static.T)[0, 1]
    assert together == pytest.approx(common**2 / (common**2 + own**2), abs=0.1)
    ratios = np.array([u.cylinder.area_2 / u.cylinder.area_1 for u in units])
    assert ratios.std() == pytest.approx(population.AREA_RATIO.width, rel=error)
    stiff = np.array([stiff_bulk_modulus(u.oil) for u in units]) / stiff_bulk_modulus(base.oil)
    assert stiff.std() == pytest.approx(BETWEEN_UNITS["oil"]["bulk_modulus"].width, rel=error)


def test_more_air_makes_the_oil_softer() -> None:
    sheet = Unit.load("axis_a").oil
    assert with_its_air(sheet, sheet).bulk_modulus == pytest.approx(sheet.bulk_modulus)
    airy = with_its_air(sheet.model_copy(update={"air_fraction": 4.0 * sheet.air_fraction}), sheet)
    absolute = sheet.reference_pressure + 101325.0
    gives = 3.0 * 0.003 * (101325.0 / absolute) ** (1.0 / 1.4) / (1.4 * absolute)  # eqs 5.20 and 5.21
    assert 1.0 / airy.bulk_modulus == pytest.approx(1.0 / sheet.bulk_modulus + gives)
    assert stiff_bulk_modulus(airy) == pytest.approx(stiff_bulk_modulus(sheet))


def test_charge_follows_the_oils_expansion_and_the_gas_law() -> None:
    unit = Unit.load("axis_a")
    gas, oil, atmosphere = unit.accumulator.gas_volume, 4.32e-3, 101325.0
    rest = unit.accumulator.charge_pressure + atmosphere
    hot = rest * (328.15 / 313.15) * gas / (gas - 7e-4 * oil * 15.0) - atmosphere
    assert charge_factor(unit, 1.0, 55.0) == pytest.approx(hot / unit.accumulator.charge_pressure, rel=1e-9)
    assert charge_factor(unit, 0.9, 40.0) == pytest.approx(0.9, rel=1e-9)
    small = Unit.load("axis_a_13cm3")
    assert charge_factor(small, 1.0, 90.0) <= 2.5, "what the scenario takes"


def test_runs_of_a_unit_have_their_own_temperature_charge_zeros_and_wander() -> None:
    rig = draw_unit(STATED, stream(STATED, "unit", 0), 0)
    temperatures, zeros, wanders = [], [], []
    for k in range(200):
        scenario = draw_scenario(STATED, rig, stream(STATED, "log", 0, k, 0))
        unit, scenario = as_it_runs(STATED, rig, rig.unit, scenario, ("log", 0, k))
        temperatures.append(scenario.oil_temperature)
        zeros.append(unit.sensors["pressure_1"].zero - rig.unit.sensors["pressure_1"].zero)
        wanders.append(scenario.friction_wander)
        assert unit.sensors["position"].zero == rig.unit.sensors["position"].zero
        usual = charge_factor(rig.unit, 1.05, scenario.oil_temperature)
        assert scenario.charge_factor == pytest.approx(usual, rel=0.45)
    assert np.mean(temperatures) == pytest.approx(40.0, abs=2.2)
    assert np.std(temperatures) == pytest.approx(7.3, abs=1.2)
    assert min(temperatures) >= 25.0 and max(temperatures) <= 55.0
    assert np.std(zeros) == pytest.approx(0.25 * 8e3, rel=0.2)
    assert WANDER[0] <= min(wanders) < 0.015 and 0.035 < max(wanders) <= WANDER[1]


def test_friction_wanders_with_the_std_and_time_that_are_asked_for() -> None:
    scenario = Scenario(duration=3600.0, friction_wander=0.03, seed=4)
    every = np.arange(0.0, 3600.0, 1.0)
    none = np.zeros(every.size)
    rows = axis_conditions(Unit.load("axis_a"), scenario, every, none, none)[0]
    assert np.array_equal(rows[:, c.FRICTION_FORWARD], rows[:, c.FRICTION_REVERSE])
    wander = (rows[:, c.FRICTION_FORWARD] - 1.0) / 0.03
    # 90 independent stretches of twice the process's time.
    assert abs(wander.mean()) < 0.4 and wander.std() == pytest.approx(1.0, abs=0.25)
    assert np.abs(wander).max() <= 3.0
    lagged = np.mean(wander[20:] * wander[:-20]) / np.mean(wander**2)
    assert lagged == pytest.approx(math.exp(-20.0 / FRICTION_TIME), abs=0.15)
    assert np.abs(np.diff(wander)).max() < 1.5, "no jumps"


NAME = "torque"
LOGS = 9


def drawn(seed: int, units: int, freedom: float) -> tuple[list[UnitLogs], np.ndarray, np.ndarray, np.ndarray]:
    """Units' logs, with the mean, the std of units and q (5, n) that they were drawn with."""
    rng, first = np.random.default_rng(seed), first_effects(NAME)
    n = first.mean.size
    mean = first.mean + first.units
    spread = 0.5 * first.units
    always = 0.3 * np.sqrt(first.between_logs(usual_conditions(first.noise)))
    q = np.array([always, always / first.noise, *np.zeros((3, n))])
    out = []
    for _ in range(units):
        own = mean + spread * rng.normal(size=n)
        information, vector, conditions = [], [], []
        for _ in range(LOGS):
            each = LogConditions(1.0, float(first.noise**2 * rng.uniform(0.2, 4.0)), 0.0, 0.0, 0.0)
            weight = rng.gamma(0.5 * freedom, 2.0 / freedom)
            std = np.sqrt(np.array(each) @ np.square(q) / weight)
            theta = own + std * rng.normal(size=n)
            x = rng.normal(size=(40, n)) / (0.5 * always)
            information.append(x.T @ x)
            vector.append(x.T @ (x @ theta + rng.normal(size=40)))
            conditions.append(each)
        out.append(UnitLogs(np.array(information), np.array(vector), np.array(conditions)))
    return out, mean, spread, q


def test_spreads_are_those_that_logs_were_drawn_with() -> None:
    """80 units of nine logs, Student's t of five degrees of freedom."""
    units, mean, spread, q = drawn(1, 80, 5.0)
    found = learnt_spread(NAME, units, first_effects(NAME))
    usual = np.array(usual_conditions(first_effects(NAME).noise))
    np.testing.assert_allclose(usual @ np.square(found.between), usual @ np.square(q), rtol=0.5)
    np.testing.assert_allclose(found.units, spread, rtol=0.35)
    assert np.all(np.abs(found.mean - mean) < 4.0 * spread / np.sqrt(80.0))
    assert 3.0 < found.freedom < 9.0
    assert np.all(found.logs > 0.5 * 80 * LOGS)


def test_wander_is_that_which_frames_were_drawn_with() -> None:
    """60 logs of 40 frames: half of the coefficients wander, the others not; within four standard errors."""
    rng, first = np.random.default_rng(3), first_effects("coherence")
    first = replace(first, wander=6.0 * first.within)
    n = first.mean.size
    wander = np.where(np.arange(n) % 2, 0.0, first.wander / 3.0)
    logs = []
    for _ in range(60):
        x = rng.normal(size=(40, 50, n)) / (2.0 * first.wander)
        frames = first.mean + first.units * rng.normal(size=n) + wander * rng.normal(size=(40, n))
        y = np.einsum("hkn,hn->hk", x, frames) + rng.normal(size=(40, 50))
        m, v = np.einsum("hki,hkj->hij", x, x), np.einsum("hki,hk->hi", x, y)
        logs.append(((m, v, np.full(40, 50.0), np.ones(40)), usual_conditions(first.noise)))
    found = learnt_wander("coherence", logs, first)
    assert np.all(np.abs(found[::2] / wander[::2] - 1.0) < 0.1)
    assert np.all(found[1::2] < 0.1 * first.wander[1::2])


def test_what_belongs_to_the_load_is_marginalised() -> None:
    """The force balance's normal equations are those of the joint normal density's marginal."""
    rng, first = np.random.default_rng(4), first_effects("force")
    own = BALANCES["force"].own
    n = own.size
    assert not own[list(BALANCES["force"].columns).index("spring")] and own.sum() == 2
    x = rng.normal(size=(8, 60, n)) / np.sqrt(np.diag(first.covariance))
    m = np.einsum("hki,hkj->hij", x, x)
    v = np.einsum("hki,hk->hi", x, x @ first.mean + rng.normal(size=(8, 60)))
    conditions = LogConditions(1.0, first.noise**2, 0.0, 0.0, 0.0)
    sums = m, v, np.full(8, 60.0), np.full(8, first.noise**2)
    information, vector, told = log_equations("force", sums, conditions, first)
    assert told == conditions
    # The same by the dense joint covariance of all coefficients: a flat prior on the unit's own ones.
    wide, kept = marginalised(m, v, first.wander)
    over = scattered(wide, kept, first)[1]
    total, right = wide.sum(axis=0) / over, kept.sum(axis=0) / over
    prior = np.where(own, 0.0, 1.0 / (np.square(first.units) + first.between_logs(conditions)))
    covariance = np.linalg.inv(total + np.diag(prior))
    mean = covariance @ (right + prior * first.mean)
    inside = covariance[np.ix_(own, own)]
    np.testing.assert_allclose(np.linalg.inv(information), inside, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.solve(information, vector), mean[own], rtol=1e-6)
