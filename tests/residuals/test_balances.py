"""The balances close on the plant: a healthy axis's coefficients are what its profile says."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from fdd import Pipeline, Samples, Unit, simulate
from fdd.diagnosis.baseline import add_baseline, effects_of, history_of
from fdd.plant.scenario import Recording, Scenario
from fdd.residuals.balances import BALANCES, LAG_S
from fdd.residuals.bins import COLUMNS, FRAME_BINS, BinMaker
from fdd.residuals.oil import stiff_compliance
from fdd.residuals.quantities import Quantities, Scales, settled

LOADS: tuple[dict[str, Any], ...] = (
    {"name": "spring"}, {"name": "constant"}, {"name": "constant", "level": -1000.0},
)  # fmt: skip
PRESSURES = ("pressure_1", "pressure_2", "pressure_difference")


@pytest.fixture(scope="module")
def logs() -> list[Samples]:
    return [
        simulate(Unit.load("axis_a"), Scenario(duration=40.0, load=load, seed=seed)).samples
        for seed, load in enumerate(LOADS, 51)
    ]


@pytest.fixture(scope="module")
def unit(logs: list[Samples]) -> Unit:
    return add_baseline(Unit.load("axis_a"), logs)


def coefficients(log: Samples, unit: Unit, balance: str) -> tuple[np.ndarray, np.ndarray]:
    """By all frames of a log, and what any unit may be, (n,), and their covariance (n, n)."""
    history = history_of(log, unit, effects_of(unit))
    effects, (information, vector) = history.effects[balance], history.marginalised()[balance]
    prior = np.diag(1.0 / np.square(3.0 * effects.units))
    covariance = np.linalg.inv(prior + information.sum(axis=0))
    return covariance @ (prior @ effects.mean + vector.sum(axis=0)), covariance


def force_coefficients(log: Samples, unit: Unit) -> dict[str, float]:
    found, _ = coefficients(log, unit, "force")
    return dict(zip(BALANCES["force"].columns, found.tolist(), strict=True))


def quantities(log: Samples, unit: Unit) -> Quantities:
    return Quantities(BinMaker(unit).push(log)[1], unit, Scales.of(unit))


AGREEING = {"gain_1": 1.0, "gain_2": -1.0}


@pytest.mark.parametrize(
    ("balance", "column", "expected", "within"),
    [
        ("volume", "gain", 0.0, 0.01),
        ("volume", "compliance", 1.0, 0.25),
        ("volume", "leak", 1.0, 0.15),
        ("torque", "pressure", 1.0, 0.03),
        ("torque", "inertia", 1.0, 0.03),
        ("torque", "zero", 0.0, 0.005),
        ("force", "friction_forward", 1.0, 0.15),
        ("force", "friction_reverse", 1.0, 0.15),
        *(("coherence", column, AGREEING.get(column, 0.0), 0.02) for column in BALANCES["coherence"].columns),
    ],
)
def test_a_coefficient_is_what_the_profile_says(unit, balance, column, expected, within):
    found = effects_of(unit)[balance].mean[BALANCES[balance].columns.index(column)]
    assert found == pytest.approx(expected, abs=within)


def test_the_volume_balance_closes_to_a_hundred_cubic_millimetres(unit: Unit) -> None:
    """Levels of a usual stretch within a frame, on logs that the baseline was not made of."""
    for seed, load in enumerate(LOADS, 61):
        fresh = simulate(Unit.load("axis_a"), Scenario(duration=20.0, load=load, seed=seed)).samples
        mean, _ = coefficients(fresh, unit, "volume")
        maker = BinMaker(unit)
        rows = np.concatenate([maker.push(fresh)[1], maker.push(None)[1]])
        q = Quantities(rows, unit, Scales.of(unit))
        levels: list[np.ndarray] = []
        raw: list[np.ndarray] = []
        for y, x, ok, _ in BALANCES["volume"].blocks(q):
            good = settled(ok & np.isfinite(y) & np.isfinite(x).all(axis=1), BALANCES["volume"].settle)
            for start in range(0, len(rows) - FRAME_BINS + 1, FRAME_BINS):
                inside = start + np.flatnonzero(good[start : start + FRAME_BINS])
                for stretch in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1):
                    if stretch.size >= 12:
                        for left, into in ((y[stretch] - x[stretch] @ mean, levels), (y[stretch], raw)):
                            level = np.cumsum(left)
                            into.append(level - level.mean())
        typical = np.median([np.sqrt(np.mean(level**2)) for level in levels])
        assert typical < 100e-9, f"{load}: {1e9 * typical:.0f} mm³"
        rest, whole = (np.sqrt(np.mean(np.concatenate(x) ** 2)) for x in (levels, raw))
        assert rest < 0.3 * whole


@pytest.mark.parametrize("filled", [0.0, 0.5, 1.0])
def test_what_a_pump_compresses_is_found(filled: float) -> None:
    """Of pumps that move their ports' mean density, their inlet's, or amid: within three deviations."""
    unit = Unit.load("axis_a")
    unit.oil.bulk_modulus, unit.oil.air_fraction = 6e7, 0.001
    duty = {"name": "constant_speed", "speeds": [60.0, 120.0, 200.0], "turn": 8.0, "amplitude": 0.05}
    load, details = {"name": "throttle", "pressure": 2.2e6}, {"pump_compression": filled}
    run = {"duration": 45.0, "control": {"mode": "speed"}, "recording": Recording.perfect()}
    log = simulate(unit, Scenario(**run, duty=duty, load=load, details=details)).samples
    found, covariance = coefficients(log, unit, "volume")
    # At one temperature what leaks with speed looks the same.
    scales, columns = Scales.of(unit), BALANCES["volume"].columns
    half = 0.5 * unit.pump.displacement * stiff_compliance(unit.oil)
    lost = np.zeros(len(columns))
    lost[columns.index("filled")], lost[columns.index("wear")] = 1.0, scales.leakage / scales.speed / half
    std = float(np.sqrt(lost @ covariance @ lost))
    assert std < 0.25 and abs(float(lost @ found) - filled) < 3.0 * std
    assert abs(found[columns.index("density")] - 1.0) < 0.2


def test_a_starved_pump_tells_nothing_of_its_chambers(unit: Unit, logs: list[Samples]) -> None:
    """It no longer displaces what it turns: chambers are judged only with their pump full."""
    rows = BinMaker(unit).push(logs[0])[1]
    full = Quantities(rows, unit, Scales.of(unit))
    assert any(s.valid.any() for s in BALANCES["volume"].blocks(full))
    low = np.argmin([np.nanmean(full.p1), np.nanmean(full.p2)]) + 1
    for name in (f"pressure_{low}", "pressure_accumulator"):
        rows[:, COLUMNS[name]] = -5e4
    starved = Quantities(rows, unit, Scales.of(unit))
    assert not any(s.valid.any() for s in BALANCES["volume"].blocks(starved))


@pytest.mark.parametrize(("load", "shut"), [("none", 1.0), ("constant", 0.0)])
def test_the_case_lies_amid_the_ports_until_its_valve_opens(load: str, shut: float) -> None:
    """What the case's column leaks against is the plant's case pressure; the case opens at 2 bar."""
    unit = Unit.load("axis_a").model_copy(deep=True)
    unit.accumulator.case_cracking_pressure = 2e5
    run = simulate(unit, Scenario(duration=20.0, load={"name": load}, seed=73))
    q = quantities(run.samples, unit)
    mid = 0.5 * (q.p1[1:] + q.p1[:-1])
    case = BALANCES["volume"].blocks(q)[0].x[1:, BALANCES["volume"].columns.index("case")]
    found = mid - case / (Scales.of(unit).leakage * (q.dt / q.viscosity)[1:])
    late = np.isfinite(found) & (q.take["time"][1:] > 5.0)
    time = (0.5 * (q.take["time"][1:] + q.take["time"][:-1]))[late]
    true, level = (
        np.interp(time, run.truth.time, run.truth[f"pressure_{n}"]) for n in ("case", "accumulator")
    )
    assert np.mean(true < level + 1.9e5) == pytest.approx(shut, abs=0.1)
    assert np.sqrt(np.mean(np.square(found[late] - true))) < 3e3


@pytest.mark.parametrize(
    ("duty", "load", "lag"),
    [
        ({"name": "strokes", "amplitude": 0.08, "rate": 0.12}, "none", 2e-3),
        ({"name": "sines"}, "spring", 2e-2),
    ],
)
def test_a_chamber_that_is_fed_is_not_taken_for_closed(duty: dict[str, Any], load: str, lag: float) -> None:
    """Fast strokes put the pump's inlet below the accumulator, but not the chamber that it empties; a piloted
    valve that is slow closes long after the chamber's pressure has passed the accumulator's."""
    unit = Unit.load("axis_a").model_copy(deep=True)
    unit.cylinder.area_2 *= 0.6
    details = {"line_loss": 1.5e12, "pilot_ratio": 3.0, "pilot_cracking": 3e4, "check_lag": lag}
    scenario = Scenario(duration=12.0, duty=duty, load={"name": load}, details=details, seed=5)
    run = simulate(unit, scenario)
    q = quantities(run.samples, unit)
    time = q.take["time"]
    share = unit.pump.displacement * unit.drive.max_speed
    for side, block in zip((1, 2), BALANCES["volume"].blocks(q), strict=True):
        at = np.clip(np.searchsorted(time, run.truth.time), 1, time.size - 1)
        fed = np.abs(run.truth[f"refeed_flow_{side}"]) > 0.02 * share
        assert fed.mean() > 0.1, "else this shows nothing"
        taken = settled(block.valid, BALANCES["volume"].settle)
        assert (fed & taken[at]).mean() < 0.002


@pytest.mark.parametrize("cracking", [7e3, 50e3])
def test_a_sound_valve_drops_by_its_spring_whatever_the_relief_setting(cracking: float) -> None:
    """The chamber that leakage empties stands where its valve opens."""
    unit = Unit.load("axis_a").model_copy(deep=True)
    unit.accumulator.refeed_cracking_pressure = cracking
    drops = []
    for unit.accumulator.relief_pressure in (3.44e6, 20e6):
        log = simulate(unit, Scenario(duration=40.0, load={"name": "constant"}, seed=8)).samples
        found, covariance = coefficients(log, unit, "refeed")
        assert covariance[1, 1] < 0.02**2
        drops.append(found[1])
    assert drops[1] == pytest.approx(drops[0], abs=0.01)
    assert 0.7 * cracking < drops[0] * Scales.of(unit).valve < cracking


@pytest.mark.parametrize(("keeps", "found"), [(True, ["check_valve_stuck_open"]), (False, [])])
def test_a_lower_chamber_that_keeps_its_oil_tells_of_its_valve(unit, logs, keeps, found):
    """Of a load that holds chamber 2 higher; not where a pilot may let the lower chamber's oil go."""
    mine = unit.model_copy(deep=True)
    mine.accumulator.refeed_pilots = not keeps
    mine = add_baseline(mine, logs)
    valve = {"fault": "check_valve_stuck_open", "severity": 0.5, "side": 1, "onset": 15.0}
    load = {"name": "constant", "level": -1500.0}
    for faults, expected in (([valve], found), ([], [])):
        pipeline = Pipeline(mine)
        pipeline.push(simulate(unit, Scenario(duration=40.0, load=load, faults=faults, seed=77)).samples)
        answer = pipeline.finish().faults
        assert [f.fault for f in answer] == expected
        assert all(14.0 <= (f.onset_s or 0.0) <= 16.0 for f in answer)


def test_friction_is_told_beside_a_mass_whose_pressures_lag() -> None:
    unit, decay = Unit.load("axis_a"), np.exp(-1e-3 / LAG_S)
    for seed in (71, 72):
        log = simulate(unit, Scenario(duration=40.0, load={"name": "inertia"}, seed=seed)).samples
        late = {n: lfilter([1.0 - decay], [1.0, -decay], log[n] - log[n][0]) + log[n][0] for n in PRESSURES}
        lags = []
        for samples in (log, log.with_columns(late)):
            found = force_coefficients(samples, unit)
            assert found["friction_forward"] == pytest.approx(1.0, abs=0.15)
            assert found["friction_reverse"] == pytest.approx(1.0, abs=0.15)
            lags.append(found["lag"])
        assert lags[1] - lags[0] == pytest.approx(-1.0, abs=0.1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_load_cell_tells_gusts_from_friction_whichever_way_it_counts(sign: float) -> None:
    unit = Unit.load("axis_a")
    run = simulate(unit, Scenario(duration=40.0, load={"name": "gust"}, seed=1))
    log, noise = run.samples, np.random.default_rng(1).normal(0.0, 20.0, len(run.samples))
    force = sign * (1.005 * np.interp(log.time, run.truth.time, run.truth["load_force"]) + 20.0 + noise)
    found = force_coefficients(log.with_columns({"load_force": force}), unit)
    assert found["load_measured"] == pytest.approx(sign / 1.005, abs=0.02)
    assert found["friction_forward"] == pytest.approx(1.0, abs=0.12)
    assert found["friction_reverse"] == pytest.approx(1.0, abs=0.12)


def driven(**scenario: Any) -> Samples:
    return simulate(Unit.load("axis_a"), Scenario(duration=40.0, seed=57, **scenario)).samples


@pytest.mark.parametrize("mode", ["position", "speed"])
def test_a_dead_drive_does_not_follow_its_command(unit: Unit, mode: str) -> None:
    dead = {"fault": "drive_failure", "severity": 1.0, "onset": 20.0, "law": "dead"}
    found = Pipeline(unit)
    found.push(driven(faults=[dead], control={"mode": mode}))
    [first, *_] = found.finish().faults
    assert first.fault == "drive_failure" and first.severity == pytest.approx(1.0, abs=0.1)


def test_a_drive_follows_its_command(unit: Unit) -> None:
    log = driven(load={"name": "spring"}, duty={"name": "strokes"})
    found, covariance = coefficients(log, unit, "drive")
    assert covariance[0, 0] < 0.05**2
    assert found[0] == pytest.approx(1.0, abs=0.05)


def test_a_drive_at_its_limit_is_not_asked(unit: Unit) -> None:
    log = driven(load={"name": "spring"}, duty={"name": "steps"})
    q = quantities(log, unit)
    [block] = BALANCES["drive"].blocks(q)
    at_limit = np.abs(q.take["motor_current"]) > 0.9 * unit.drive.current_limit
    assert at_limit.sum() > 20 and not (at_limit & block.valid).any()
