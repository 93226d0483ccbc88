"""The watch on simulated machines, whatever the blocks; the chances that its thresholds are argued with."""

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from fdd import Samples, Scenario, Unit
from fdd.plant.simulate import Simulation, simulate
from fdd.sections import Sensor
from fdd.sensors import SensorWatch
from fdd.sensors.finding import Kind, Memory, SensorFindings
from fdd.sensors.jumps import BREAKS_LOOSE, NOISE_REACH, excess
from fdd.sensors.limits import INDEX, POSITION, Limits
from fdd.sensors.scan import spread
from tests.refusal import refused

ONSET = 8.0
DUTIES: dict[str, dict[str, Any]] = {
    "standstill": {"duty": {"name": "standstill"}},
    "standstill without control": {"duty": {"name": "standstill"}, "control": {"mode": "speed"}},
    "steps against weight": {
        "duty": {"name": "steps", "amplitude": 0.1}, "load": {"name": "constant", "level": 900},
    },
    "steps with a mass": {"duty": {"name": "steps", "amplitude": 0.1}, "load": {"name": "inertia"}},
    "noise": {"duty": {"name": "prbs"}, "load": {"name": "gust"}},
    "sweep": {"duty": {"name": "sweep"}, "load": {"name": "throttle"}},
    "end positions": {"duty": {"name": "strokes", "speed": 250}, "control": {"mode": "speed"}},
}  # fmt: skip
SENSORS: dict[str, dict[str, Sensor]] = {
    "as shipped": {},
    "noisy": {
        "position": Sensor(noise=25e-6, resolution=1e-6),
        **{n: Sensor(noise=1e5, resolution=6e3) for n in ("pressure_1", "pressure_2", "pressure_difference")},
    },
    "coarse": {
        "position": Sensor(resolution=25e-6),
        **{n: Sensor(resolution=6e3) for n in ("pressure_1", "pressure_2", "pressure_difference")},
    },
}


@cache
def unit_with(axis: str, sensors: str) -> Unit:
    unit = Unit.load(axis)
    unit.sensors = {**unit.sensors, **SENSORS[sensors]}
    return unit


@cache
def run(
    axis: str, sensors: str, duty: str, fault: str = "", severity: float = 0.0, variant: str = ""
) -> Simulation:
    faults = []
    if fault:
        faults = [{"fault": fault, "severity": severity, "onset": ONSET, "variant": variant or None}]
    return simulate(unit_with(axis, sensors), Scenario(duration=20.0, faults=faults, seed=3, **DUTIES[duty]))


def watched(samples: Samples, unit: Unit | None = None, rows: int = 1_000_000) -> SensorWatch:
    """A watch that has seen samples, in blocks of so many rows."""
    watch = SensorWatch(unit or unit_with("axis_a", "as shipped"))
    for block in samples.blocks(rows):
        watch.push(block)
    return watch


def changed(samples: Samples, channel: str, rows: Any, value: Any) -> Samples:
    column = samples[channel].copy()
    column[rows] = value
    return samples.with_columns({channel: column})


@pytest.mark.parametrize("duty", DUTIES)
@pytest.mark.parametrize(
    ("axis", "sensors"),
    [("axis_a", "as shipped"), ("axis_b", "as shipped"), ("axis_a", "noisy"), ("axis_b", "coarse")],
)
def test_healthy_is_quiet(axis: str, sensors: str, duty: str) -> None:
    watch = watched(run(axis, sensors, duty).samples, unit_with(axis, sensors))
    assert watch.findings() == []
    assert {s["state"] for s in watch.states()} == {"trusted"}


@pytest.mark.parametrize(
    "fault", ["internal_leakage", "relief_valve_stuck_open", "aeration", "coupling_wear"]
)
def test_faults_of_the_machine_are_none_of_the_sensors(fault: str) -> None:
    assert watched(run("axis_a", "as shipped", "steps with a mass", fault, 1.0).samples).findings() == []


@pytest.mark.parametrize("duty", ["standstill", "steps with a mass", "sweep"])
@pytest.mark.parametrize("severity", [0.2, 0.8])
def test_slips_of_the_encoder(duty: str, severity: float) -> None:
    simulation = run("axis_b", "as shipped", duty, "position_sensor_slip", severity)
    # Of the true slips, from what the encoder shows and what is true.
    error = simulation.samples["position"] - simulation.truth["position"]
    there = np.isfinite(error)
    steps = np.diff(error[there])
    rows = np.flatnonzero(np.abs(steps) > 50e-6)
    times, sizes = simulation.samples.time[there][rows + 1], np.abs(steps[rows])
    (slip,) = watched(simulation.samples, simulation.unit).findings()
    assert (slip.channel, slip.kind, slip.fault) == ("position", "slip", "position_sensor_slip")
    assert np.abs(times - slip.onset_s).min() < 0.002, "the onset is one of the slips"
    assert slip.onset_s < times[2], "and one of the first"
    judged = times < 19.4
    assert slip.size == pytest.approx(sizes[judged].sum(), rel=0.35)


@pytest.mark.parametrize(
    ("rod", "pressure", "kinds"), [(False, 0.0, ["slip"]), (True, 0.0, []), (True, 1e6, ["slip"])]
)
def test_a_single_rods_piston_may_run_where_its_load_changes_sides(rod, pressure, kinds):
    """Three millimetres in 0.08 s while the pump stands: both piloted check valves may be open there."""
    unit, still = Unit.load("axis_a"), run("axis_a", "as shipped", "standstill without control").samples
    if rod:
        unit.cylinder.area_2 *= 0.6
    runs = 3e-3 * np.clip((still.time - 10.0) / 0.08, 0.0, 1.0)
    columns = {"position": still["position"] + runs}
    columns |= {n: still[n] + pressure for n in ("pressure_1", "pressure_difference")}
    assert [f.kind for f in watched(still.with_columns(columns), unit).findings()] == kinds


@pytest.mark.parametrize(("often", "rare"), [("slip", "spikes"), ("spikes", "slip")])
def test_jumps_of_one_sensor_have_one_cause(often: Kind, rare: Kind) -> None:
    found = SensorFindings(Memory.new())
    for k, kind in enumerate((rare, often, often)):
        found.begin_frame(2.0 * k + 2.0)
        found.report(POSITION, kind, 2.0 * k + 1.0, None, 1e-3, f"jump {k}")
    (one,) = found.by_onset()
    assert (one.kind, one.count, one.onset_s, one.detected_s, one.evidence) == (often, 3, 1.0, 2.0, "jump 1")
    assert {f.kind: f.count for f in found._found.values()} == {rare: 1, often: 2}, "of which more may come"


@pytest.mark.parametrize(
    ("variant", "severity", "kind"),
    [
        ("missing", 1.0, "dropout"), ("missing", 0.3, "dropout"), ("held", 1.0, "stuck"),
        ("held", 0.3, "dropout"), ("broken_loop", 1.0, "dead"), ("broken_loop", 0.3, "dropout"),
        ("position_missing", 1.0, "dropout"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("duty", ["standstill", "sweep"])
def test_dropouts(variant: str, severity: float, kind: str, duty: str) -> None:
    simulation = run("axis_a", "as shipped", duty, "sensor_dropout", severity, variant)
    (found,) = watched(simulation.samples, simulation.unit).findings()
    channel = "position" if variant.startswith("position") else "pressure_difference"
    assert (found.channel, found.kind, found.fault) == (channel, kind, "sensor_dropout")
    # At severity 0.3 the first burst comes when it comes, 0.33 s after the onset on average.
    assert ONSET - 0.01 <= found.onset_s < ONSET + (1.0 if severity == 1.0 else 3.0)
    assert found.detected_s - found.onset_s <= 5.0


@pytest.mark.parametrize("seed", [51, 52])
@pytest.mark.parametrize(
    ("fails", "kinds"),
    [("holds", {"dropout", "stuck"}), ("reads nothing", {"dead"}), ("at its end", {"saturated"})],
)
def test_a_position_that_fails_in_motion_is_no_slip(seed: int, fails: str, kinds: set[str]) -> None:
    """For four seconds, then it is back at the piston's own position."""
    unit, load = Unit.load("axis_a"), ("spring", "gust")[seed % 2]
    log = simulate(unit, Scenario(duration=24.0, load={"name": load}, seed=seed)).samples
    lost = (log.time >= 15.2) & (log.time < 19.2)
    stands = log["position"][np.argmax(lost)]
    value = {"holds": stands, "reads nothing": 0.0, "at its end": 2.0 * unit.cylinder.stroke}[fails]
    found = {f.kind: f for f in watched(changed(log, "position", lost, value), unit, 500).findings()}
    assert "slip" not in found
    [kind] = kinds & found.keys()
    assert found[kind].onset_s == pytest.approx(15.2, abs=0.05)
    assert found[kind].until_s == pytest.approx(19.1, abs=0.2)


def test_a_failed_channel_is_trusted_again_after_it_came_back() -> None:
    samples = run("axis_a", "as shipped", "sweep").samples
    lost = changed(samples, "pressure_1", (samples.time >= 6.0) & (samples.time < 9.0), 0.0)
    watch = SensorWatch(unit_with("axis_a", "as shipped"))
    out = watch.push(lost)
    (found,) = watch.findings()
    assert (found.kind, found.onset_s) == ("dead", pytest.approx(6.0, abs=0.002))
    assert found.until_s == pytest.approx(9.0, abs=0.51)
    assert np.isnan(out["pressure_1"][(samples.time > 6.51) & (samples.time < 9.0)]).all()
    late = samples.time > 11.0
    assert np.array_equal(out["pressure_1"][late], lost["pressure_1"][late], equal_nan=True)


def test_noise_that_grows_ten_times() -> None:
    samples = run("axis_a", "as shipped", "standstill").samples
    rows = samples.time >= 9.0
    noisy = samples["pressure_2"][rows] + np.random.default_rng(1).normal(0.0, 7e4, int(rows.sum()))
    (found,) = watched(changed(samples, "pressure_2", rows, noisy)).findings()
    assert (found.channel, found.kind) == ("pressure_2", "noisy")
    assert found.onset_s == pytest.approx(9.0, abs=0.51)


def answers(
    parts: list[Samples], unit: Unit, save_after: int | None = None
) -> tuple[Samples, list[Any], list[Any]]:
    watch, out = SensorWatch(unit), []
    for i, part in enumerate(parts):
        out.append(watch.push(part))
        if i == save_after:
            kept = {k: v.copy() for k, v in watch.state().items()}
            watch = SensorWatch(unit)
            watch.restore(kept)
    return Samples.concatenate(out), watch.findings(), watch.states()


def spoilt() -> Samples:
    """A run with nearly everything wrong: slips, bursts, gaps, spikes, a dead and a biased sensor."""
    samples = run("axis_a", "as shipped", "sweep", "position_sensor_slip", 0.5).samples
    rng = np.random.default_rng(4)
    columns = {n: v.copy() for n, v in samples.columns.items()}
    time = samples.time
    columns["pump_angle"][rng.integers(0, len(samples), 12)] += 3.1
    columns["pressure_accumulator"][(time > 5.0) & (time < 7.0)] = 0.0
    columns["pressure_1"][time > 11.0] += 2e6
    for start in np.arange(3.0, 15.0, 0.4):
        columns["motor_current"][(time > start) & (time < start + 0.1)] = np.nan
        columns["pressure_difference"][(time > start) & (time < start + 0.07)] = 1e6
    kept = (time < 9.2) | (time > 10.9)
    return Samples(time[kept], {n: v[kept] for n, v in columns.items()})


@pytest.mark.parametrize("save", [False, True], ids=["through", "saved and restored"])
@settings(max_examples=12)
@given(cuts=st.lists(st.integers(1, 18_000), max_size=12), ones=st.integers(0, 17_000))
def test_answers_do_not_depend_on_the_blocks(save: bool, cuts: list[int], ones: int) -> None:
    samples, unit = spoilt(), unit_with("axis_a", "as shipped")
    edges = sorted({0, len(samples), *(c for c in cuts if c < len(samples)), *range(ones, ones + 40)})
    parts = [samples.rows(a, b) for a, b in pairwise(edges)]
    whole, parted = answers([samples], unit), answers(parts, unit, len(parts) // 2 if save else None)
    for name in samples.channels:
        assert np.array_equal(whole[0][name], parted[0][name], equal_nan=True), name
    assert whole[1:] == parted[1:]
    assert {"slip", "spikes", "dropout", "dead", "step"} <= {f.kind for f in whole[1]}


def test_a_row_is_nan_only_where_it_must_be_and_input_is_left_alone() -> None:
    samples = spoilt()
    before = {n: v.copy() for n, v in samples.columns.items()}
    out = SensorWatch(unit_with("axis_a", "as shipped")).push(samples)
    for name in samples.channels:
        assert np.array_equal(samples[name], before[name], equal_nan=True)
        same = np.isnan(out[name]) | (out[name] == samples[name])
        assert same.all(), name


def test_channels_may_come_and_go() -> None:
    samples = run("axis_a", "as shipped", "standstill").samples
    watch, rest = watched(samples.rows(0, 4000)), samples.rows(4000, len(samples))
    watch.push(Samples(rest.time, {n: rest[n] for n in rest.channels if n != "pressure_2"}))
    (found,) = watch.findings()
    assert (found.channel, found.kind) == ("pressure_2", "dropout")


def test_time_that_stands_is_refused() -> None:
    row = Samples([1.0], {"position": [0.0]})
    watch = watched(row)
    assert "order of time" in refused(lambda: watch.push(row))


@pytest.mark.parametrize("rate", [500.0, 1000.0])
def test_stamps_that_come_late_are_no_slip_of_the_angle(rate: float) -> None:
    """One row in fifty is late by up to nine tenths of a period, so that some late ones stand close by."""
    rng = np.random.default_rng(5)
    time = np.arange(int(300 * rate)) / rate
    late = (rng.random(time.size) < 0.02) * rng.uniform(0.1, 0.9, time.size) / rate
    assert np.any((late[:-2] > 0.5 / rate) & (late[1:-1] == 0.0) & (late[2:] > 0.5 / rate))
    speed = 180.0 + 20.0 * np.sin(time)
    assert not watched(Samples(time + late, {"pump_angle": np.cumsum(speed) / rate})).findings()


@pytest.mark.parametrize("rate", [500.0, 1000.0])
def test_a_piston_that_its_load_swings_goes_on_while_a_row_is_late(rate: float) -> None:
    """Eight swings a second with the pump at rest; one row in fifty is measured late, and stamped so."""
    rng = np.random.default_rng(6)
    time = np.arange(int(60 * rate)) / rate
    time += (rng.random(time.size) < 0.02) * rng.uniform(0.1, 0.9, time.size) / rate
    swing = np.sin(2.0 * np.pi * 8.0 * time)
    columns = {
        "position": np.round(0.01 * swing, 6), "pump_angle": 1e-3 * np.round(30.0 * np.sin(time)),
        "pressure_difference": 1e6 * swing + rng.normal(scale=7e3, size=time.size),
    }  # fmt: skip
    assert not watched(Samples(time, columns)).findings()


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("half", [0.0005, 0.002, 0.005, 0.02])
def test_a_leap_of_a_freed_piston_is_within_what_is_allowed_for_it(half: float, stride: int) -> None:
    """It speeds up at a for some time and slows down at a for as long; rows of 2 ms at any phase."""
    period, acceleration, worst = 0.002, 90.0, 0.0
    for phase in np.linspace(0.0, period, 41):
        time = np.arange(0.0, 0.1, period)
        since = np.clip(time - 0.05 - phase, -half, half)
        leap = acceleration * (half * since - 0.5 * np.sign(since) * since**2)
        worst = max(worst, float(np.abs(excess(time, leap, stride)).max()))
    allowed = BREAKS_LOOSE * acceleration * (stride * period) ** 2
    assert worst <= 1.0001 * allowed
    assert worst > 0.9 * allowed or half < 1.4 * stride * period


@pytest.mark.parametrize(("share", "sound"), [(1.05, True), (0.6, False)])
def test_a_peak_beyond_a_range_that_spans_the_relief_setting_is_no_fault(share: float, sound: bool) -> None:
    """An amplifier that ends below the relief setting is broken: no sensor is chosen so small."""
    samples = run("axis_a", "as shipped", "noise").samples
    end = share * unit_with("axis_a", "as shipped").accumulator.relief_pressure
    watch = watched(changed(samples, "pressure_difference", slice(9000, 9020), end), rows=700)
    assert bool(watch.findings()) != sound
    assert len(watch.notes()) == sound
    state = next(s for s in watch.states() if s["channel"] == "pressure_difference")["state"]
    assert state == ("clipped" if sound else "trusted")


ROWS = 1_000_000


def chance_of_excess(reach: float) -> float:
    """That ``a + 2b + c`` and ``2a + b + d`` are both beyond `reach`, or both below its negative."""
    correlation, scale = 4.0 / 6.0, np.sqrt(6.0)
    rest = np.sqrt(1.0 - correlation**2)

    def density(u: float) -> float:
        return float(stats.norm.pdf(u) * stats.norm.sf((reach / scale - correlation * u) / rest))

    return 2.0 * float(integrate.quad(density, reach / scale, reach / scale + 12.0)[0])


@pytest.mark.parametrize("reach", [4.0, 7.0])
def test_excess_of_white_noise_has_the_chance_that_is_said(reach: float) -> None:
    noise = np.random.default_rng(1).normal(0.0, 1.0, ROWS)
    over = np.abs(excess(np.arange(ROWS) * 1e-3, noise)) > reach
    expected = chance_of_excess(reach)
    assert over.mean() == pytest.approx(expected, abs=5.0 * np.sqrt(expected / ROWS))


def test_a_false_jump_comes_once_in_a_hundred_thousand_hours() -> None:
    channels, strides, rate = 6, 2, 1000.0
    per_hour = chance_of_excess(NOISE_REACH) * channels * strides * rate * 3600.0
    assert per_hour < 1e-5


def test_noise_is_estimated_through_jumps_and_rounding() -> None:
    rng = np.random.default_rng(2)
    noise = rng.normal(0.0, 3.0, (800, 40))
    # A step every 20 rows, and rounding to the noise's own size.
    spoilt = np.round(noise / 3.0) * 3.0 + 100.0 * np.cumsum(np.arange(800) % 20 == 0)[:, None]
    assert np.median([spread(run) for run in noise.T]) == pytest.approx(3.0, rel=0.05)
    assert all(2.0 < spread(run) < 9.0 for run in spoilt.T)


def test_rows_of_noise_repeat_no_more_often_than_limits_allow() -> None:
    unit = Unit.load("axis_a")
    sensor = unit.sensor("pressure_1")
    values = 5e5 + sensor.noise * np.random.default_rng(3).normal(size=ROWS)
    counts = np.round(values / sensor.resolution)
    repeated = float((np.diff(counts) == 0).mean())
    assert repeated == pytest.approx(sensor.resolution / (sensor.noise * np.sqrt(4.0 * np.pi)), rel=0.05)
    assert Limits.of(unit).repeat[INDEX["pressure_1"]] >= repeated


def test_limits_leave_every_shipped_unit_its_ordinary_range() -> None:
    for name in ("axis_a", "axis_b"):
        unit, limits = Unit.load(name), Limits.of(Unit.load(name))
        half, relief = 0.5 * unit.cylinder.stroke, unit.accumulator.relief_pressure
        assert limits.low[INDEX["position"]] < -half < half < limits.high[INDEX["position"]]
        assert limits.high[INDEX["pressure_1"]] > relief + unit.accumulator.charge_pressure
        assert limits.low[INDEX["pressure_1"]] < -101_325.0
        assert limits.high[INDEX["pump_speed"]] > unit.drive.max_speed
