"""Proposed maps: names of three languages, units, and signs that only the physics tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.logs import read_log
from fdd.logs.channel_map import ChannelMap
from fdd.logs.formats import open_log
from fdd.logs.formats.signals import Signal
from fdd.logs.mapping import Words, given_of, propose
from fdd.logs.mapping.concepts import name_scores
from fdd.logs.mapping.writing import map_text
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit

STYLES = {
    "German": """time=Zeit|s, command=Sollwert|1/min, pump_speed=Drehzahl|1/min, position=Kolbenweg|mm,
        pressure_difference=Differenzdruck|bar, pressure_1=Druck A|bar, pressure_2=Druck B|bar,
        pressure_accumulator=Speicherdruck|bar,
        motor_current=Motorstrom|A, oil_temperature=Oeltemperatur|°C""",
    "French": """time=temps|s, command=consigne vitesse|tr/min, pump_speed=vitesse pompe|tr/min,
        position=course verin|mm, pressure_1=pression A|bar, pressure_2=pression B|bar,
        pressure_accumulator=pression accumulateur|bar, motor_current=courant moteur|A,
        oil_temperature=temperature huile|°C""",
    "units in names": """time=t_ms|, command=drive_V|, pump_speed=pump_rpm|, position=cyl_mm|,
        pressure_difference=dp_bar|, pressure_1=pA_bar|, pressure_2=pB_bar|,
        pressure_accumulator=acc_bar|,
        motor_current=i_A|, oil_temperature=oil_C|""",
    "capitals": """time=Timestamp|s, command=MotCmd|rpm, pump_speed=MotSpd|rpm, position=RamPos|in,
        pressure_difference=PrDiff|psi, pressure_1=PrA|psi, pressure_2=PrB|psi,
        pressure_accumulator=PrRes|psi, motor_current=MotCur|A, oil_temperature=OilTmp|degF""",
    "sides": """time=Timestamp|s, command=MotCmd|rpm, pump_speed=MotSpd|rpm, position=RamPos|in,
        pressure_difference=PrDiff|psi, pressure_1=PrExt|psi, pressure_2=PrRet|psi""",
    "as users type": """time=Time (s)|, pump_speed=pumpspeed [rpm]|, position=Position [mm]|,
        pressure_1=Pressure 1 [MPa]|, pressure_2=Pressure 2 [MPa]|""",
    "absolute": """time=time|s, command=n_soll|rpm, pump_speed=n_ist|rpm, position=x_ist|mm,
        pressure_1=p1|bar abs, pressure_2=p2|bar abs, pressure_accumulator=p_acc|bara""",
}
"""Channel, name and unit of each column as loggers of several makers have them."""
FACTORS = {
    "1/min": np.pi / 30, "tr/min": np.pi / 30, "rpm": np.pi / 30, "mm": 1e-3, "bar": 1e5, "A": 1.0, "s": 1.0,
    "V": 31.4159265, "ms": 1e-3, "in": 0.0254, "psi": 6894.757293168, "MPa": 1e6,
}  # fmt: skip


@pytest.fixture(scope="module")
def log() -> Samples:
    """Half a minute of strokes of axis A against a spring."""
    scenario = Scenario(duration=30.0, seed=3, load={"name": "spring"})
    return simulate(Unit.load("axis_a"), scenario).samples


def written(path: Path, samples: Samples, style: str, turned: dict[str, int] | None = None) -> dict[str, str]:
    """The log in a style, some channels with the other sign; the columns' names by channel."""
    columns, units, names = {}, [], {}
    for entry in STYLES[style].split(","):
        channel, _, (name, unit) = *entry.strip().partition("=")[:2], entry.partition("=")[2].split("|")
        if channel != "time" and channel not in samples:
            continue
        values = samples.time if channel == "time" else samples[channel] * (turned or {}).get(channel, 1)
        spelled = unit or name.rsplit("_", 1)[-1].rsplit("[", 1)[-1].rsplit("(", 1)[-1].strip("]) ")
        if spelled in ("bar abs", "bara"):
            values = (values + 101_325.0) / 1e5
        elif spelled in ("degF",):
            values = values * 1.8 + 32.0
        elif spelled not in ("°C", "C"):
            values = values / FACTORS[spelled]
        columns[name], names[channel] = values, name
        units.append(unit)
    frame = pd.DataFrame(columns)
    text = frame.to_csv(index=False, sep=";")
    head, rest = text.split("\n", 1)
    path.write_text(f"{head}\n{';'.join(units)}\n{rest}" if any(units) else text, encoding="utf-8")
    return names


@pytest.mark.parametrize("style", STYLES)
def test_a_log_of_any_maker_is_read_by_its_proposed_map(style: str, log: Samples, tmp_path: Path) -> None:
    names = written(tmp_path / "log.csv", log, style)
    found = propose(open_log(tmp_path / "log.csv"))
    assert not found.questions, found.questions
    assert {c: r.source.column for c, r in found.rows.items()} == names
    channel_map = ChannelMap.from_yaml(map_text(found, "rig", "axis_x", "log.csv"))
    read = read_log(tmp_path / "log.csv", channel_map).samples
    for channel in names:
        if channel not in ("time", "command"):
            bound = 1e-6 * float(np.nanmax(np.abs(log[channel])))
            np.testing.assert_allclose(read[channel], log[channel], atol=bound, rtol=0, err_msg=channel)
    if "command" in names:  # a demand in volts is scaled by what the pump does
        np.testing.assert_allclose(
            read["command"], log["command"], atol=0.02 * np.nanmax(np.abs(log["command"]))
        )


TURNED = {
    "the pump": ["command", "pump_speed", "pump_angle"],
    "the position": ["position", "position_setpoint"],
    "pump and position": ["command", "pump_speed", "pump_angle", "position", "position_setpoint"],
    "the difference": ["pressure_difference"],
}


@pytest.mark.parametrize("what", TURNED)
def test_a_turned_sign_is_found_by_the_volume_balance(what: str, log: Samples, tmp_path: Path) -> None:
    """Test: some channels with the other sign. Expected: channels that fit together as an actuator's do.

    Pump and position turned together cannot be told from swapped chambers, and are read as these.
    """
    written(tmp_path / "log.csv", log, "German", dict.fromkeys(TURNED[what], -1))
    found = propose(open_log(tmp_path / "log.csv"))
    read = read_log(tmp_path / "log.csv", found.channel_map()).samples
    mirrored = what == "pump and position"
    sign = -1 if mirrored else 1
    for channel in ("pump_speed", "command", "position", "pressure_difference"):
        np.testing.assert_allclose(
            read[channel], sign * log[channel], atol=2e-3 * np.nanmax(np.abs(log[channel]))
        )
    np.testing.assert_allclose(read["pressure_1"], log["pressure_2" if mirrored else "pressure_1"], rtol=1e-6)
    assert bool(found.notes) == (what != "the difference")


def test_sides_that_names_tell_turn_the_motion(log: Samples, tmp_path: Path) -> None:
    written(tmp_path / "log.csv", log, "sides", dict.fromkeys(TURNED["pump and position"], -1))
    found = propose(open_log(tmp_path / "log.csv"))
    assert found.rows["pressure_1"].source.column == "PrExt"
    assert [found.rows[c].source.sign for c in ("position", "pump_speed", "command")] == [-1, -1, -1]


def test_what_no_unit_tells_is_asked_with_the_likeliest_first(log: Samples, tmp_path: Path) -> None:
    frame = pd.DataFrame({"t": log.time, "w": log["pump_speed"], "x_mm": 1e3 * log["position"],
                          "p1": log["pressure_1"] / 1e3, "p2": log["pressure_2"] / 1e3})  # fmt: skip
    frame.to_csv(tmp_path / "log.csv", index=False)
    found = propose(open_log(tmp_path / "log.csv"))
    assert [q.channel for q in found.questions] == ["pressure"]
    found.answer(found.questions[0], "kPa")
    read = read_log(tmp_path / "log.csv", found.channel_map()).samples
    np.testing.assert_allclose(read["pressure_1"], log["pressure_1"], rtol=1e-9)
    np.testing.assert_allclose(read["pump_speed"], log["pump_speed"], atol=1e-9)


def test_what_the_user_knows_goes_first(log: Samples, tmp_path: Path) -> None:
    written(tmp_path / "log.csv", log, "French")
    options = ["pressure_1=pression B", "pressure_2=pression A", "motor_current="]
    found = propose(open_log(tmp_path / "log.csv"), None, given_of(options))
    assert "motor_current" not in found.rows
    chambers = {found.rows[c].source.column for c in ("pressure_1", "pressure_2")}
    assert chambers == {"pression A", "pression B"}
    assert "courant moteur" in found.unused


def test_own_words(tmp_path: Path) -> None:
    (tmp_path / "words.yaml").write_text("schema: fdd.words/1\nwords: {position: [schuifpositie]}\n")
    words = Words(tmp_path / "words.yaml")
    scores = name_scores(Signal("Schuifpositie"), words)
    assert max(scores, key=lambda c: scores[c]) == "position" and scores["position"] >= 2.0


@given(st.text(max_size=40), st.text(max_size=8))
@settings(max_examples=300)
def test_any_name_and_unit_have_scores(name: str, unit: str) -> None:
    scores = name_scores(Signal(name, unit=unit), Words())
    assert all(np.isfinite(s) for s in scores.values())


SUFFIXES = {"rig0": "csv", "rig1": "parquet", "rig2": "h5", "rig3": "mf4", "rig4": "mcap", "rig5": "mat"}


@pytest.mark.parametrize("rig", SUFFIXES)
def test_rigs_that_we_did_not_build(rig: str, shared: Path) -> None:
    """Test: a rig's baseline. Expected: one question at most, and the map that its notes ask for."""
    if rig == "rig3":
        pytest.importorskip("asammdf", reason="MDF files need the extra fdd[mdf]")
    found = propose(open_log(shared / "rig_logs" / rig / f"baseline.{SUFFIXES[rig]}"))
    assert len(found.questions) == (rig == "rig4")
    if found.questions:
        found.answer(found.questions[0], "kPa")
    wanted = ChannelMap.load(Path(__file__).parents[2] / "examples" / f"{rig}.map.yaml").channels
    assert {c: r.source for c, r in found.rows.items()} == wanted
    assert (wanted["position"].sign == -1) == (rig == "rig3")


def test_a_sensors_name_is_no_side_of_the_cylinder(log: Samples, tmp_path: Path) -> None:
    """Test: "capteur", French for sensor, begins like "cap". Expected: swapped chambers, motion as it was."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(STYLES, "sensors", STYLES["sides"].replace("PrExt", "capteur pression A").replace(
            "PrRet", "capteur pression B"))  # fmt: skip
        written(tmp_path / "log.csv", log, "sensors", dict.fromkeys(TURNED["pump and position"], -1))
    found = propose(open_log(tmp_path / "log.csv"))
    assert found.rows["pressure_1"].source.column == "capteur pression B"
    assert found.rows["position"].source.sign == 1
