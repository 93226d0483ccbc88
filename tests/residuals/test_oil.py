"""The viscosity of the oil; chamber pressures from their difference, against those of the plant."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd import Samples, simulate
from fdd.plant.oil import air_compliance, bulk_modulus, viscosity
from fdd.plant.scenario import Recording, Scenario
from fdd.residuals.bins import COLUMNS, BinMaker
from fdd.residuals.oil import chambers_from_difference, viscosity_ratio
from fdd.unit import Oil, Unit


def unknown(like: np.ndarray) -> np.ndarray:
    return np.full_like(like, np.nan)


def test_they_follow_the_plants() -> None:
    """Strokes against a throttle, after which the mean stays up."""
    unit = Unit.load("axis_a")
    duty = {"name": "constant_speed", "speeds": [50.0, 110.0], "turn": 8.0, "amplitude": 0.05}
    run = {"duration": 20.0, "control": {"mode": "speed"}, "recording": Recording.perfect()}
    load = {"name": "throttle", "pressure": 1.5e6}
    truth = simulate(unit, Scenario(**run, duty=duty, load=load)).truth.columns
    p1, p2 = truth["pressure_1"], truth["pressure_2"]
    mean, tank = chambers_from_difference(p1 - p2, truth["position"], 1e-3, unit, unknown(p1))
    true_mean = 0.5 * (p1 + p2)
    assert np.sqrt(np.mean((mean - true_mean) ** 2)) < 3e4
    # A constant would be off by ten times that, and a lower chamber that is always fed by half of the load.
    assert np.sqrt(np.mean((true_mean - unit.accumulator.charge_pressure) ** 2)) > 2.5e5
    assert np.sqrt(np.mean((tank - truth["pressure_accumulator"]) ** 2)) < 4e4
    lowest = mean - 0.5 * np.abs(p1 - p2)
    assert np.all(lowest >= tank - unit.accumulator.refeed_cracking_pressure - 1.0)


@pytest.mark.parametrize("air", [0.0, 0.003, 0.02])
def test_what_one_shut_chamber_gives_the_other_takes(air: float) -> None:
    """Off mid-stroke V1 dp1 / β(p1) = -V2 dp2 / β(p2) without drain or feed, β by the plant's law of oil."""
    unit = Unit.load("axis_a")
    unit.pump.case_leakage, unit.oil.air_fraction = 0.0, air
    soft = air * float(air_compliance(unit.oil.reference_pressure, unit.oil.polytropic_index))
    unit.oil.bulk_modulus = 1.0 / (1.0 / 3.5e8 + soft)
    c = unit.cylinder
    difference = np.concatenate([[2e6], 1e6 + 5e5 * np.sin(np.linspace(0.0, 20.0, 4000))])
    position = np.full_like(difference, 0.3 * c.stroke)
    mean, _ = chambers_from_difference(difference, position, 0.01, unit, unknown(difference))
    dp1, dp2 = np.diff(mean + 0.5 * difference), np.diff(mean - 0.5 * difference)
    one, two = c.volume_1 + c.area_1 * position[1:], c.volume_2 - c.area_2 * position[1:]
    middle = 0.5 * (mean[1:] + mean[:-1]), 0.25 * (difference[1:] + difference[:-1])
    given, taken = (
        v * dp / bulk_modulus(unit.oil, middle[0] + sign * middle[1])
        for v, dp, sign in ((one, dp1, 1.0), (two, dp2, -1.0))
    )
    np.testing.assert_allclose(given[1:], -taken[1:], atol=1e-3 * np.abs(given).max())


def test_the_case_drain_lets_the_mean_down_by_its_time_constant() -> None:
    unit = Unit.load("axis_a")
    unit.oil.air_fraction = 0.0
    c, low = unit.cylinder, unit.accumulator.charge_pressure
    position, difference = np.zeros(200), np.concatenate([[1e6], np.zeros(199)])
    tank = np.full_like(position, low)
    mean, _ = chambers_from_difference(difference, position, 1e-3, unit, tank)
    above = mean - low - unit.accumulator.case_cracking_pressure
    tau = (c.volume_1 + c.volume_2) / unit.oil.bulk_modulus / (2.0 * unit.pump.case_leakage)
    np.testing.assert_allclose(above[2:] / above[1:-1], np.exp(-1e-3 / tau), rtol=1e-9)


def test_a_single_rods_accumulator_follows_the_rod() -> None:
    """Its lower chamber is held open by the pilot; the rod takes its volume of oil from the accumulator."""
    unit = Unit.load("axis_a")
    unit.cylinder.area_2 = 0.7 * unit.cylinder.area_1
    position = np.linspace(-0.02, 0.02, 50)
    difference = 1e6 * np.sin(np.linspace(0.0, 9.0, 50))
    mean, tank = chambers_from_difference(difference, position, 0.01, unit, unknown(position))
    c, rod = unit.cylinder, 0.3 * unit.cylinder.area_1 * position
    held = (c.volume_1 + c.volume_2 + rod) / unit.oil.bulk_modulus * (mean - mean[1])
    product = (tank + 101325.0) * (unit.accumulator.gas_volume + rod + held)
    np.testing.assert_allclose(product[1:], product[1], rtol=0.02)
    assert np.ptp(tank) > 5e4
    lowest = mean - 0.5 * np.abs(difference)
    crack = unit.accumulator.refeed_cracking_pressure
    assert np.all((lowest >= tank - crack - 1.0) & (lowest <= tank + unit.accumulator.case_cracking_pressure))


def test_noise_lifts_nothing() -> None:
    """Peaks of a noisy sensor would lift the mean by their height for as long as the drain takes."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(6)
    unit.pump.case_leakage = unit.oil.air_fraction = 0.0
    noisy, tank = 1e6 + rng.normal(0.0, 2e4, 500), np.full(500, unit.accumulator.charge_pressure)
    true = tank + 0.5e6 - unit.accumulator.refeed_cracking_pressure
    plain, told = (
        chambers_from_difference(noisy, np.zeros(500), 0.01, unit, tank, noise=noise)[0]
        for noise in (None, np.full(500, 2e4))
    )
    np.testing.assert_allclose(plain[250:] - told[250:], 0.5 * 2e4, rtol=0.01)
    assert np.mean(told[250:] - true[250:]) < 2.5e4


@pytest.mark.parametrize("step", [900, 2500, 7001])
def test_rows_do_not_depend_on_blocks_where_sensors_come_and_go(step: int) -> None:
    """The mean is followed all along, and anew after a pause in which the drain has let it down."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(8)
    time = np.concatenate([np.arange(20_000), np.arange(60_000, 70_000)]) * 1e-3
    difference = 1e5 * np.cumsum(rng.normal(0.0, 0.05, time.size))
    columns = {
        "position": 0.01 * np.sin(time), "pump_angle": 30.0 * np.sin(time), "pressure_difference": difference,
        "pressure_1": np.where(time < 8.0, 9e5, np.nan), "pressure_2": np.where(time < 8.0, 6e5, np.nan),
        "pressure_accumulator": np.where(time < 5.0, 4e5, np.nan),
    }  # fmt: skip
    log = Samples(time, columns)

    def mean(blocks: list[Samples]) -> np.ndarray:
        maker = BinMaker(unit)
        parts = [rows for block in blocks for _, rows in maker.stretches(block)]
        return np.concatenate([*parts, maker.push(None)[1]])[:, COLUMNS["mean_pressure"]]

    whole = mean([log])
    np.testing.assert_array_equal(mean([log.rows(a, a + step) for a in range(0, len(log), step)]), whole)
    lower = whole[2000] - 0.5 * abs(np.mean(difference[20_000:20_010]))
    assert lower == pytest.approx(4e5, abs=1e3)


@pytest.mark.parametrize("drains", [True, False])
def test_the_mean_is_unknown_while_its_drain_says_whether_a_valve_feeds(drains: bool) -> None:
    """A load comes, goes for four seconds, and again: the valve opens where the mean has come down to."""
    unit = Unit.load("axis_a")
    if not drains:
        unit.pump.case_leakage = 0.0
    time = np.arange(0.0, 8.0, 1e-3)
    comes, goes, again = (np.clip(time - start, 0.0, 1.0) for start in (0.5, 2.0, 6.0))
    columns = dict.fromkeys(("position", "pump_angle"), 0.0 * time)
    columns["pressure_difference"] = 1.6e6 * (comes - goes + again)
    columns["pressure_accumulator"] = np.full(time.size, unit.accumulator.charge_pressure)
    maker = BinMaker(unit)
    rows = np.concatenate([maker.push(Samples(time, columns))[1], maker.push(None)[1]])
    known = np.isfinite(rows[:, COLUMNS["mean_pressure"]])
    assert known[200:300].all() and known[350:600].all() and known[710:].all()
    assert known.all() if not drains else 10 <= np.sum(~known[600:700]) <= 80


def oil_of(at_40: float, share: float, reference: float) -> Oil:
    """Axis A's oil with other viscosities: cSt at 40 °C, share of what lies above 1 cSt at 100 °C."""
    points = {"viscosity_40": at_40 * 1e-6, "viscosity_100": (1.0 + share * (at_40 - 1.0)) * 1e-6}
    return Unit.load("axis_a").oil.model_copy(update={**points, "reference_temperature": reference})


oils = st.builds(oil_of, st.floats(8.0, 400.0), st.floats(0.05, 0.5), st.floats(0.0, 90.0))


@given(oils, st.floats(-20.0, 120.0))
def test_is_a_straight_line_in_walthers_coordinates(oil: Oil, celsius: float) -> None:
    at_reference = viscosity(oil, oil.reference_temperature)
    centistokes = viscosity_ratio(oil, [40.0, 100.0, celsius]) * float(at_reference) * 1e6
    ordinate = np.log10(np.log10(centistokes + 0.7))
    abscissa = np.log10(np.array([40.0, 100.0, celsius]) + 273.15)
    line = np.polyfit(abscissa[:2], ordinate[:2], 1)
    assert ordinate[2] == pytest.approx(np.polyval(line, abscissa[2]), abs=1e-7)


def test_agrees_with_the_plants_own_law() -> None:
    oil = Unit.load("axis_a").oil
    celsius = np.linspace(-20.0, 110.0, 27)
    expected = viscosity(oil, celsius) / viscosity(oil, 40.0)
    np.testing.assert_allclose(viscosity_ratio(oil, celsius), expected, rtol=1e-9)


def test_absurd_temperatures_stay_finite() -> None:
    found = viscosity_ratio(Unit.load("axis_a").oil, [-300.0, 1e6])
    assert np.isfinite(found).all() and (found > 0.0).all()
