"""Logs of raw counts without names or units: turns, direction, speeds and signs follow from the shaft."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd.errors import InputError
from fdd.logs import read_log
from fdd.logs.channel_map import ChannelMap
from fdd.logs.formats import open_log
from fdd.logs.mapping import given_of, propose
from fdd.logs.mapping.behaviour import counts_a_turn
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit

RIGS = {
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
    position, setpoint = samples["position"], samples["position_setpoint"]
    counts = {
        "pump_angle": np.floor(turned % 4096.0),
        "pump_speed": np.round(samples["pump_speed"] * 30.0 / np.pi / RPM_A_COUNT),
        "command": np.round(samples["command"] * 30.0 / np.pi / RPM_A_COUNT),
        "position": np.round(position / 1e-5) + 5000.0,
        "position_setpoint": np.round(setpoint / 1e-5) + 5000.0,
        "pressure_1": np.round(samples["pressure_1"] / 2e3) + 120.0,
        "pressure_2": np.round(samples["pressure_2"] / 2.5e3) + 80.0,
        "current": np.round(100.0 * samples["motor_current"]) + 2048.0,
        "duty": np.round(np.abs(samples["command"]) * 8.0),
        "warmth": np.round(10.0 * samples["oil_temperature"]),
    }
    if one_way:
        counts["valve"] = np.sign(np.where(steps == 0.0, samples["command"], steps))
    order = np.random.default_rng(seed).permutation(list(counts))
    names = {str(channel): f"ch{k}" for k, channel in enumerate(order)}
    columns = {names[str(c)]: counts[str(c)] for c in order}
    pd.DataFrame({"time": np.arange(len(samples)), **columns}).to_csv(path, index=False)
    return names


@pytest.mark.parametrize("rig", RIGS)
def test_counts_without_names_are_read_but_for_their_scales(rig: str, tmp_path: Path) -> None:
    """Test: counts in nameless columns. Expected: the shaft's; position and pressures are to be named.

    With them given by their scales nothing is left to ask, and the log reads as it was simulated.
    """
    unit, duty, load, seed, one_way = RIGS[rig]
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
        if channel == "pump_angle":  # it is counted from the first row
            wanted, got = wanted - wanted[0], got - got[0]
        assert float(np.nanmax(np.abs(got - wanted)[100:-100])) < digit, channel
    for channel in ("pump_speed", "command"):
        slope = float(read[channel] @ log[channel] / (log[channel] @ log[channel]))
        assert slope == pytest.approx(1.0, abs=0.01), channel


def test_a_saw_tooth_is_an_angle_and_a_switch_or_a_spike_is_none() -> None:
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
        ("pressure_1=adc*two:bar", None),
        ("pressure_1=adc*0,5:bar", "the scale is no number"),
        ("pressure_1=adc*0:bar", "the scale is no number"),
        ("pressure_1=adc*1e999:bar", "the scale is no number"),
        ("pressure_1=adc*0.5", "a scale without a unit"),
        ("pressure_1=adc*0.5:mm", "mm"),
        ("presure_1=adc", "no channel"),
    ],
)
def test_what_a_user_says_is_read_strictly(option: str, said: str | None) -> None:
    """Test: odd options. Expected: a name may hold a star; a scale is a number and has a unit that fits."""
    if said is None:
        assert given_of([option])["pressure_1"].signal == "adc*two"
        return
    with pytest.raises(InputError, match=said):
        given_of([option])


def test_a_scale_keeps_the_sign_that_was_found(tmp_path: Path) -> None:
    """Test: a position that counts backwards, scaled. Expected: pumping's sign, the offset with it."""
    log = simulate(Unit.load("axis_a"), Scenario(duration=20.0, seed=3, load={"name": "spring"})).samples
    columns = {"time_s": log.time, "speed_rpm": log["pump_speed"] * 30.0 / np.pi,
               "position": np.round(-1e5 * log["position"]) + 5000.0,
               "p1_bar": log["pressure_1"] / 1e5, "p2_bar": log["pressure_2"] / 1e5}  # fmt: skip
    pd.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    found = propose(open_log(tmp_path / "log.csv"), given=given_of(["position=*0.01-50:mm"]))
    read = read_log(tmp_path / "log.csv", found.channel_map()).samples
    np.testing.assert_allclose(read["position"], log["position"], atol=1e-5)
