"""Proposed maps: names by language and trade, units, signs, and counts of which only the physics tells."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fdd import Scenario, Unit, simulate
from fdd.errors import InputError
from fdd.logs import read_log
from fdd.logs.channel_map import ChannelMap
from fdd.logs.formats import Signal, open_log
from fdd.logs.mapping import given_of, propose
from fdd.logs.mapping.behaviour import counts_a_turn
from fdd.logs.mapping.concepts import name_scores
from fdd.measures import Measure, find_measure
from fdd.samples import CHANNELS, Samples

EXAMPLES = Path(__file__).parents[2] / "examples"
RIGS = yaml.safe_load(Path(__file__).with_name("rig_names.yaml").read_text("utf-8"))
OTHERS = {"winding": (45.0, 0.1), "case": (1.5, 0.0), "ambient": (21.0, 0.0)}
"""What rigs record besides: level and drift a second, in the units of the table."""


@pytest.fixture(scope="module")
def log() -> Samples:
    """Half a minute of steps against a spring."""
    duty = {"duty": {"name": "steps"}, "load": {"name": "spring"}}
    return simulate("axis_a", Scenario(duration=30.0, seed=3, **duty)).samples


def written(samples: Samples, rig: dict, path: Path, turned: Any = (), every: int = 1) -> dict[str, str]:
    """Rows of the log as the rig writes them, some channels with the other sign; channel to column."""
    columns, names = {}, {}
    for name, (what, unit) in rig["signals"].items():
        column = rig["form"].format(name, unit)
        if what in OTHERS:
            level, drift = OTHERS[what]
            columns[column] = (level + drift * samples.time)[::every]
            continue
        volts = Measure("angular_speed", 10.0 * math.pi)
        measure = volts if unit == "V" else find_measure(unit, CHANNELS[what].dimension)
        assert measure is not None, unit
        values = samples.time if what == "time" else samples[what] * (-1 if what in turned else 1)
        columns[column] = ((values - measure.offset) / measure.factor)[::every]
        names[what] = column
    pd.DataFrame(columns).to_csv(path, index=False, sep=";", float_format="%.9g")
    return names


@pytest.mark.parametrize("rig", RIGS)
def test_every_channel_is_found_and_nothing_else(rig, log, tmp_path):
    path = tmp_path / "log.csv"
    names = written(log, RIGS[rig], path, every=4)
    found = propose(open_log(path))
    assert found.rows.keys() == names.keys()
    assert all(names[channel].endswith(str(row.source.column)) for channel, row in found.rows.items())
    if RIGS[rig]["form"] == "{}":  # units are asked for
        return
    assert not found.questions
    read = read_log(path, ChannelMap.from_yaml(found.map_text("rig", "axis_x", "log.csv"))).samples
    for channel in names.keys() - {"time"}:
        # A demand in volts is scaled by what the pump does.
        share = 0.02 if channel == "command" else 1e-6
        wanted = log[channel][::4] - (log[channel][0] if channel == "pump_angle" else 0.0)
        got = read[channel] - (read[channel][0] if channel == "pump_angle" else 0.0)
        bound = share * float(np.nanmax(np.abs(wanted)))
        np.testing.assert_allclose(got, wanted, atol=bound, rtol=0, err_msg=channel)


MOTION = ("position", "position_setpoint")
PUMP = ("command", "pump_speed", "pump_angle")
TURNED = {
    "the pump": PUMP, "the position": MOTION, "pump and position": PUMP + MOTION,
    "the difference": ("pressure_difference",),
}  # fmt: skip


@pytest.mark.parametrize("what", TURNED)
def test_a_turned_sign_is_found_by_the_volume_balance(what, log, tmp_path):
    """Pump and position turned together cannot be told from swapped chambers, and are read as these."""
    written(log, RIGS["german table"], tmp_path / "log.csv", TURNED[what])
    found = propose(open_log(tmp_path / "log.csv"))
    read = read_log(tmp_path / "log.csv", found.channel_map()).samples
    mirrored = what == "pump and position"
    sign = -1 if mirrored else 1
    for channel in ("pump_speed", "command", "position", "pressure_difference"):
        bound = 2e-3 * np.nanmax(np.abs(log[channel]))
        np.testing.assert_allclose(read[channel], sign * log[channel], atol=bound)
    np.testing.assert_allclose(read["pressure_1"], log["pressure_2" if mirrored else "pressure_1"], rtol=1e-6)
    assert bool(found.notes) == (what != "the difference")


def test_sides_that_names_tell_turn_the_motion_and_a_sensors_name_tells_none(log, tmp_path):
    """Pump and position turned; "capteur", French for sensor, is no cap."""
    rig = RIGS["capitals with units"]
    written(log, rig, tmp_path / "log.csv", PUMP + MOTION)
    found = propose(open_log(tmp_path / "log.csv"))
    assert found.rows["pressure_1"].source.column == "PrExt [psi]"
    assert [found.rows[c].source.sign for c in ("position", "pump_speed", "command")] == [-1, -1, -1]
    french = {"PrExt": "capteur pression A", "PrRet": "capteur pression B"}
    signals = {french.get(name, name): what for name, what in rig["signals"].items()}
    written(log, {**rig, "signals": signals}, tmp_path / "log.csv", PUMP + MOTION)
    found = propose(open_log(tmp_path / "log.csv"))
    assert found.rows["pressure_1"].source.column == "capteur pression B [psi]"
    assert found.rows["position"].source.sign == 1


def test_what_no_unit_tells_is_asked_and_a_scale_keeps_the_sign_that_was_found(log, tmp_path):
    frame = pd.DataFrame({"t": log.time, "w": log["pump_speed"], "x_mm": 1e3 * log["position"],
                          "p1": log["pressure_1"] / 1e3, "p2": log["pressure_2"] / 1e3})  # fmt: skip
    frame.to_csv(tmp_path / "log.csv", index=False)
    found = propose(open_log(tmp_path / "log.csv"))
    assert [q.channel for q in found.questions] == ["pressure"]
    found.answer(found.questions[0], "kPa")
    read = read_log(tmp_path / "log.csv", found.channel_map()).samples
    np.testing.assert_allclose(read["pressure_1"], log["pressure_1"], rtol=1e-9)
    np.testing.assert_allclose(read["pump_speed"], log["pump_speed"], atol=1e-9)
    # A position that counts backwards takes pumping's sign, and its offset with it.
    columns = {"time_s": log.time, "speed_rpm": log["pump_speed"] * 30.0 / np.pi,
               "position": np.round(-1e5 * log["position"]) + 5000.0,
               "p1_bar": log["pressure_1"] / 1e5, "p2_bar": log["pressure_2"] / 1e5}  # fmt: skip
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    found = propose(open_log(tmp_path / "log.csv"), given=given_of(["position=*0.01-50:mm"]))
    read = read_log(tmp_path / "log.csv", found.channel_map()).samples
    np.testing.assert_allclose(read["position"], log["position"], atol=1e-5)


def test_what_the_user_knows_goes_first(log, tmp_path):
    written(log, RIGS["french"], tmp_path / "log.csv")
    chambers = {"Pression chambre 1 (bar)", "Pression chambre 2 (bar)"}
    options = [f"pressure_{k}={name}" for k, name in zip((2, 1), sorted(chambers), strict=True)]
    found = propose(open_log(tmp_path / "log.csv"), given_of([*options, "motor_current="]))
    assert {found.rows[c].source.column for c in ("pressure_1", "pressure_2")} == chambers
    assert "motor_current" not in found.rows and "Courant moteur (A)" in found.unused


@given(st.text(max_size=40), st.text(max_size=8))
def test_any_name_and_unit_have_scores(name, unit):
    scores = name_scores(Signal(name, unit=unit))
    assert all(np.isfinite(s) for s in scores.values())


SUFFIXES = {"rig0": "csv", "rig1": "parquet", "rig2": "h5", "rig3": "mf4", "rig4": "mcap", "rig5": "mat"}


@pytest.mark.parametrize("rig", SUFFIXES)
def test_rigs_that_we_did_not_build(rig, rig_logs):
    """A rig's baseline gives one question at most, and the map that its notes ask for."""
    if rig == "rig3":
        pytest.importorskip("asammdf", reason="MDF files need the extra fdd[mdf]")
    found = propose(open_log(rig_logs / rig / f"baseline.{SUFFIXES[rig]}"))
    assert len(found.questions) == (rig == "rig4")
    if found.questions:
        found.answer(found.questions[0], "kPa")
    wanted = ChannelMap.load(EXAMPLES / f"{rig}.map.yaml").channels
    assert {c: r.source for c, r in found.rows.items()} == wanted
    assert (wanted["position"].sign == -1) == (rig == "rig3")


SHAFTS = {
    "axis A, steps on a spring": ("axis_a", "steps", "spring", 3, False),
    "axis A, sines on a spring, a valve": ("axis_a", "sines", "spring", 5, True),
    "axis B, steps under a weight, a valve": ("axis_b", "steps", "constant", 6, True),
    "axis B, strokes on a spring": ("axis_b", "strokes", "spring", 8, False),
}
"""Profile, duty, load, seed; whether the pump turns one way and a valve gives the direction."""
RPM_A_COUNT = 0.25
PORTS = ("pressure_1", "pressure_2")


def stripped(samples: Samples, path: Path, seed: int, *, one_way: bool) -> dict[str, str]:
    """A log as a microcontroller writes it: counts, columns in any order; channels to columns.

    The pump of `one_way` always counts down, and a valve's state says where the oil goes.
    """
    turned = samples["pump_angle"] / (2.0 * np.pi) * 4096.0
    steps = np.diff(turned, prepend=turned[0])
    if one_way:
        turned = -np.cumsum(np.abs(steps))
    counts = {
        "pump_angle": np.floor(turned % 4096.0),
        "pump_speed": np.round(samples["pump_speed"] * 30.0 / np.pi / RPM_A_COUNT),
        "command": np.round(samples["command"] * 30.0 / np.pi / RPM_A_COUNT),
        "position": np.round(samples["position"] / 1e-5) + 5000.0,
        "position_setpoint": np.round(samples["position_setpoint"] / 1e-5) + 5000.0,
        "pressure_1": np.round(samples["pressure_1"] / 2e3) + 120.0,
        "pressure_2": np.round(samples["pressure_2"] / 2.5e3) + 80.0,
        "current": np.round(100.0 * samples["motor_current"]) + 2048.0,
        "duty": np.round(np.abs(samples["command"]) * 8.0),
        "warmth": np.round(10.0 * samples["oil_temperature"]),
    }
    if one_way:
        counts["valve"] = np.sign(np.where(steps == 0.0, samples["command"], steps))
    order = [str(channel) for channel in np.random.default_rng(seed).permutation(list(counts))]
    columns = {f"ch{k}": counts[channel] for k, channel in enumerate(order)}
    pd.DataFrame({"time": np.arange(len(samples)), **columns}).to_csv(path, index=False)
    return dict(zip(order, columns, strict=True))


@pytest.mark.parametrize("rig", SHAFTS)
def test_counts_without_names_are_read_but_for_their_scales(rig, tmp_path):
    """Position and pressures are to be named; with their scales given nothing is left to ask."""
    unit, duty, load, seed, one_way = SHAFTS[rig]
    scenario = Scenario(duration=30.0, seed=seed, duty={"name": duty}, load={"name": load})
    log = simulate(Unit.load(unit), scenario).samples
    path = tmp_path / "log.csv"
    names = stripped(log, path, seed, one_way=one_way)
    with pytest.raises(InputError, match="found no position"):
        propose(open_log(path)).channel_map()
    scales = [
        f"position={names['position']}*0.01-50:mm",
        f"position_setpoint={names['position_setpoint']}",
        f"pressure_1={names['pressure_1']}*0.02-2.4:bar",
        f"pressure_2={names['pressure_2']}*0.025-2:bar",
    ]
    found = propose(open_log(path), given=given_of(scales))
    assert not found.questions
    of_shaft = {"command", "pump_angle", "pump_speed"}
    columns = {c: r.source.column for c, r in found.rows.items() if c != "time"}
    assert columns == {c: names[c] for c in (*of_shaft, "position", "position_setpoint", *PORTS)}
    read = read_log(path, ChannelMap.from_yaml(found.map_text("rig", None, "log.csv"))).samples
    # Of the angle a count is lost or won at a reversal.
    count = {"position": 1e-5, "position_setpoint": 1e-5, "pressure_1": 2e3, "pressure_2": 2.5e3}
    for channel, digit in {"pump_angle": 0.05, **count}.items():
        wanted, got = log[channel], read[channel]
        if channel == "pump_angle":  # which is counted from the first row
            wanted, got = wanted - wanted[0], got - got[0]
        assert float(np.nanmax(np.abs(got - wanted)[100:-100])) < digit, channel
    for channel in ("pump_speed", "command"):
        slope = float(read[channel] @ log[channel] / (log[channel] @ log[channel]))
        assert slope == pytest.approx(1.0, abs=0.01), channel


def test_a_saw_tooth_is_an_angle_and_a_switch_or_a_spike_is_none():
    rng = np.random.default_rng(1)
    turned = np.cumsum(rng.uniform(5.0, 60.0, 20_000))
    assert counts_a_turn(np.floor(turned % 4096.0)) == 4096.0
    assert counts_a_turn(np.floor(-turned % 3600.0)) == 3600.0
    assert counts_a_turn(turned / 100.0 % 360.0) == 360.0
    assert counts_a_turn(np.sign(np.sin(turned / 500.0))) is None
    assert counts_a_turn(rng.normal(size=20_000)) is None
    spikes = np.zeros(20_000)
    spikes[::500] = 4000.0
    assert counts_a_turn(spikes + rng.normal(size=20_000)) is None


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("pressure_1=adc*0,5:bar", "the scale is no number"),
        ("pressure_1=adc*0:bar", "the scale is no number"),
        ("pressure_1=adc*1e999:bar", "the scale is no number"),
        ("pressure_1=adc*0.5", "a scale without a unit"),
        ("pressure_1=adc*0.5:mm", "mm"),
        ("presure_1=adc", "no channel"),
    ],
)
def test_what_a_user_says_is_read_strictly(option, said):
    with pytest.raises(InputError, match=said):
        given_of([option])
    assert given_of(["pressure_1=adc*two:bar"])["pressure_1"].signal == "adc*two", "a name may hold a star"


REQUIRED = {"position", "pressure_difference", "pressure_1", "pressure_2"}


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.map.yaml")), ids=lambda p: p.name)
def test_example_maps_are_valid(path):
    assert set(ChannelMap.load(path).channels) >= REQUIRED - {"pressure_difference"}


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["rig1", "rig4"])
def test_every_rig_log_is_read(rig_logs, rig):
    channel_map = ChannelMap.load(EXAMPLES / f"{rig}.map.yaml")
    paths = sorted((rig_logs / rig).iterdir())
    assert len(paths) >= 11
    for path in paths:
        log = read_log(path, channel_map)
        quality = log.quality
        assert set(log.samples.channels) >= REQUIRED and log.axis
        assert quality.period == 0.001 and quality.time_jumps == 0
        # The rigs' description: about 0.1 % of the rows are missing, some stamps are late.
        assert 0.0003 < quality.dropped_samples / len(log.samples) < 0.003
        assert quality.nan_samples < 0.01 * len(log.samples)
        assert np.abs(log.samples["position"]).max() < 0.16


@pytest.mark.parametrize("rig", ["rig1", "rig4"])
def test_pump_and_cylinder_agree_where_the_load_is_light(rig_logs, rig):
    """Fast motion, a tenth of a second at a time, at low pressure (little leakage): the thesis's transmission
    D/A = 3.66e-4 m/rad within the rigs' spread, both ways, positive out."""
    baseline = next((rig_logs / rig).glob("baseline.*"))
    samples = read_log(baseline, EXAMPLES / f"{rig}.map.yaml").samples
    turned = samples["pump_angle"][100::100] - samples["pump_angle"][:-100:100]
    moved = samples["position"][100::100] - samples["position"][:-100:100]
    light = np.abs(samples["pressure_difference"][50::100][: turned.size]) < 4e5
    for direction in (1, -1):
        fast = light & (direction * turned > 4.0)
        assert fast.sum() > 20
        assert np.median(moved[fast] / turned[fast]) == pytest.approx(3.66e-4, rel=0.2)


SCALES = [
    "position=ADC1_Channel_14*0.025:mm", "pressure_1=ADC1_Channel_2*0.0625-0.625:bar",
    "pressure_2=ADC1_Channel_3*0.07576-18.333:bar",
]  # fmt: skip


@pytest.mark.slow
def test_the_map_of_every_third_healthy_bench_run_has_the_same_channels_and_signs(bench):
    """Columns without names or units; the angle counts down, and the loop's rpm are 1.136 times those of the
    encoder's counts."""
    numbers = {"pump_angle": 6, "pump_speed": 10, "position": 14, "pressure_1": 2, "pressure_2": 3}
    columns = {channel: f"ADC1_Channel_{k}" for channel, k in numbers.items()}
    paths = sorted(p for s in ("session_17oct", "session_18oct") for p in (bench / s).glob("*.csv"))
    assert len(paths) == 26
    for path in paths[::3]:
        found = propose(open_log(path), given=given_of(SCALES))
        assert not found.questions, path.name
        sources = {c: found.rows[c].source for c in columns}
        assert {c: s.column for c, s in sources.items()} == columns, path.name
        angle, speed = sources["pump_angle"], sources["pump_speed"]
        assert (angle.sign, angle.wrap, angle.sign_of) == (-1, 4096.0, "ADC1_Channel_16"), path.name
        assert (speed.sign, speed.unit) == (1, "rpm") and speed.scale == pytest.approx(1.0 / 1.136, rel=2e-3)
        signs = {c: s.sign for c, s in sources.items() if c != "pump_angle"}
        assert set(signs.values()) == {1} and not any(s.delay for s in sources.values()), path.name
        if "command" in found.rows:
            assert found.rows["command"].source.column == "ADC1_Channel_9", path.name


def test_bench_signs_and_gains(bench, bench_map):
    """The unloaded 50 mm run goes out with positive pump motion and pressure in chamber 1, and back with
    negative motion and pressure in chamber 2."""
    samples = read_log(bench / "session_18oct" / "exp_data_1_4.csv", bench_map).samples
    out = (samples.time > 4.5) & (samples.time < 7.0)
    back = (samples.time > 12.5) & (samples.time < 15.0)
    gain = {}
    for name, rows, direction in (("out", out, 1), ("back", back, -1)):
        turned, moved = (np.ptp(samples[c][rows]) for c in ("pump_angle", "position"))
        assert direction * np.median(np.diff(samples["pump_angle"][rows])) > 0
        assert direction * (samples["position"][rows][-1] - samples["position"][rows][0]) > 0.02
        assert direction * samples["pressure_difference"][rows].mean() > 5e5
        gain[name] = moved / turned
    assert gain["out"] == pytest.approx(1.25e-4, rel=0.05)
    assert 1.35 < gain["back"] / gain["out"] < 1.55
