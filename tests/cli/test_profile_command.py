"""``fdd profile new`` and ``check``: a profile from a data sheet, and the slips that such typing makes."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from fdd.data_sheet.plausibility import accumulator_volumes, derived, unit_remarks
from fdd.data_sheet.profile import QUESTIONS
from fdd.unit import Unit

EXAMPLES = Path(__file__).parents[2] / "examples"

SHEET = {
    "name": "press 3", "piston_area_1": "20 cm^2", "piston_area_2": "10 cm^2", "stroke": "300mm",
    "moving_mass": "80 kg", "breakaway_pressure": "2 bar", "pump_displacement": "6.3 cm^3/rev",
    "max_speed": "3000 rpm", "rated_pressure": "120 bar", "charge_pressure": "7 bar", "gas_volume": "1 L",
    "viscosity_40": "32 mm^2/s", "torque_constant": 0.8, "winding_resistance": "0.5 ohm",
    "current_limit": "30 A", "inertia": 3e-3,
}  # fmt: skip
"""What must be said, in a fitter's units; a plain number is SI."""


def typed(folder: Path, suffix: str = ".yaml", **changes: object) -> Path:
    """A file of answers: the sheet with some changed, None leaves one out."""
    answers = {k: v for k, v in {**SHEET, **changes}.items() if v is not None}
    path = folder / f"answers{suffix}"
    path.write_text(json.dumps(answers) if suffix == ".json" else yaml.safe_dump(answers), encoding="utf-8")
    return path


@pytest.fixture
def made(ran, tmp_path):
    def make(**changes: object) -> Unit:
        ran("profile", "new", "--from", typed(tmp_path, **changes), "-o", tmp_path / "base.yaml")
        return Unit.load(tmp_path / "base.yaml")

    return make


def test_answers_arrive_in_si_and_what_the_sheet_leaves_open_is_assumed_and_says_so(made):
    unit = made()
    assert unit.name == "press 3"
    assert unit.cylinder.area_1 == pytest.approx(2e-3)
    assert unit.pump.displacement == pytest.approx(6.3e-6 / (2 * np.pi))
    assert unit.drive.max_speed == pytest.approx(100 * np.pi)
    assert unit.cylinder.provenance["area_1"].source == "data sheet: 20 cm^2"
    assert unit.cylinder.std_of("area_1") == pytest.approx(0.006 * 2e-3)
    assert unit.pump.std_of("displacement") == pytest.approx(0.02 * unit.pump.displacement, rel=1e-3)
    # Every number has a source; friction follows from breakaway pressure times area, 0.2 MPa on 15 cm².
    unit = made()
    told = {str(v) for v in SHEET.values()}
    for section in (unit.cylinder, unit.pump, unit.oil, unit.accumulator, unit.friction.forward, unit.drive):
        for name in set(type(section).model_fields) - {"provenance", "refeed_pilots"}:
            source = section.provenance[name].source
            assert source is not None, name
            assert source.startswith("assumption: ") or any(t in source for t in told), (name, source)
    relief = unit.accumulator.provenance["relief_pressure"].source
    assert relief == "assumption: a tenth above the rated pressure"
    assert unit.friction.forward.static == pytest.approx(2e5 * 15e-4)
    assert unit.friction.forward.coulomb == pytest.approx(0.6 * 300)


def test_viscosity_index_100_follows_iso_3448_and_leakage_may_be_a_flow(made):
    """Viscosity at 100 °C left open: as ASTM D2270 has it, as suppliers print it, within 5 %."""
    for at_40, at_100 in ((15, 3.3), (22, 4.3), (46, 6.8), (68, 8.7)):
        unit = made(viscosity_40=f"{at_40} cSt")
        assert unit.oil.viscosity_100 == pytest.approx(at_100 * 1e-6, rel=0.05)
    coefficient = made(leakage="1.25e-12 m^3/(s*Pa)").pump.total_leakage
    flow = made(leakage="0.9 L/min").pump.total_leakage  # 1.5e-5 m³/s at 12 MPa
    assert flow == pytest.approx(coefficient) == pytest.approx(1.25e-12)


def test_yaml_and_json_say_the_same(ran, tmp_path):
    for suffix in (".yaml", ".json"):
        ran("profile", "new", "--from", typed(tmp_path, suffix), "-o", tmp_path / f"base{suffix}")
    assert (tmp_path / "base.yaml").read_text("utf-8") == (tmp_path / "base.json").read_text("utf-8")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rated_pressure": 120}, ["rated_pressure: 120 Pa", "did you mean", "120 bar"]),
        ({"rated_pressure": "12e6 bar"}, ["rated_pressure", "not between"]),
        ({"piston_area_1": 2000}, ["piston_area_1: 2000 m^2", "2000 mm^2"]),
        ({"pump_displacement": 6.3}, ["pump_displacement: 6.3 m^3/rad", "6.3 cm^3/rev"]),
        ({"max_speed": 3000}, ["max_speed: 3000 rad/s", "3000 rpm"]),
        ({"stroke": 300}, ["stroke: 300 m", "300 mm"]),
        ({"viscosity_40": 32}, ["viscosity_40: 32 m^2/s", "32 mm^2/s"]),
        ({"stroke": "300 bar"}, ["stroke", "measures pressure, not length"]),
        ({"stroke": "long"}, ["stroke", "no number with a unit"]),
        ({"stroke": "0,3 m"}, ["stroke", "unit"]),
        ({"stroke": True}, ["stroke", "no number"]),
        ({"stroke": "nan m"}, ["stroke", "no number"]),
        ({"stroke": [1, 2]}, ["stroke", "no number"]),
        ({"stroke": None}, ["missing: stroke (m)"]),
        ({"name": None}, ["missing: name"]),
        ({"name": "../x"}, ["name"]),
        ({"strokes": "1 m"}, ["unknown key 'strokes'"]),
        # Each number would do alone; beside the others it cannot be.
        ({"rated_flow": "3.15 L/min"}, ["times largest speed gives 18.9 L/min", "turn or radian"]),
        ({"rated_flow": "18 L/min", "max_speed": "3000 deg/s"}, ["times largest speed", "units"]),
        ({"relief_pressure": "13.5 bar"}, ["relief setting, 13.5 bar, is below the rated 120 bar"]),
        ({"charge_pressure": "49 bar", "rated_pressure": "40 bar"}, ["charge, 49 bar, is not below"]),
        ({"chamber_volume_1": "47 cm^3"}, ["chamber 1 holds 47 cm³", "300 cm³ that the piston sweeps"]),
        ({"leakage": "1e-9 m^3/(s*Pa)"}, ["of the rated flow leaks away"]),
        ({"breakaway_pressure": "40 bar", "rated_pressure": "60 bar"}, ["breaks away at", "friction"]),
        ({"piston_area_2": "1000 cm^2"}, ["areas differ by a factor of 50"]),
    ],
    ids=str,
)  # fmt: skip
def test_a_slip_is_refused_in_one_line(run, one_line, tmp_path, changes, words):
    path, out = typed(tmp_path, **changes), tmp_path / "base.yaml"
    result = run("profile", "new", "--from", path, "-o", out)
    one_line(result, "answers", *words)
    assert not out.exists()


@pytest.mark.parametrize("text", ["", "- 1\n- 2\n", "name: [", "just words"])
def test_a_file_that_holds_no_answers_is_refused(run, one_line, tmp_path, text):
    path = tmp_path / "answers.yaml"
    path.write_text(text)
    one_line(run("profile", "new", "--from", path, "-o", tmp_path / "base.yaml"), str(path))
    one_line(run("profile", "new", "--from", tmp_path / "none", "-o", tmp_path / "base.yaml"), "none")


def test_questions_are_asked_again_until_they_can_be(ran, tmp_path):
    """A wrong unit is asked for at once, the three numbers that disagree once all are known."""
    sheet = {**SHEET, "torque_constant": "0.8", "inertia": "3e-3", "rated_flow": "3.15 L/min"}
    lines = [str(sheet["name"])]
    for key in QUESTIONS:
        if key == "rated_pressure":
            lines.append("120")
        lines.append(str(sheet.get(key, "")))
    lines += ["", "", "18 L/min"]  # Return keeps displacement and speed
    out = tmp_path / "base.yaml"
    result = ran("profile", "new", "-o", out, input="\n".join(lines) + "\n")
    assert "did you mean 120 bar" in result.stderr and "This cannot be" in result.stderr
    unit = Unit.load(out)
    assert unit.accumulator.relief_pressure == pytest.approx(1.1 * 12e6)
    assert unit.pump.total_leakage == pytest.approx(0.05 * 18e-3 / 60 / 12e6)


def test_check_shows_what_follows(ran):
    """By hand from the thesis's tables: D·ω/A = 115 mm/s, 5.57e-7·314.16 m³/s = 10.5 L/min,
    6.52e-12 · 3.44e6 m³/s = 1.346 L/min of leakage, 510.2 N / 15.2 cm² = 3.36 bar."""
    result = ran("profile", "check", "axis_a")
    for words in ("115.1", "10.5", "1.346", "3.357", "Nothing is odd"):
        assert words in result.stdout
    # Expected: √(2·β·A²/(M·V)) for equal areas and volumes V each, the thesis's eq. 3.40 with V = 2 V_o.
    unit = Unit.load("axis_a")
    c = unit.cylinder
    natural = np.sqrt(2.0 * unit.oil.bulk_modulus * c.area_1**2 / (c.moving_mass * c.volume_1)) / (2 * np.pi)
    row = next(r for r in derived(unit) if r.quantity == "hydraulic resonance")
    assert row.value == pytest.approx(natural)


def test_check_finds_a_slip_in_a_profile_and_gas_that_cannot_give_way_to_the_oil(run, tmp_path):
    unit = Unit.load("axis_a")
    unit.oil.bulk_modulus = 210.0  # MPa typed as Pa
    unit.save(tmp_path / "slip.yaml")
    result = run("profile", "check", tmp_path / "slip.yaml")
    assert result.exit_code == 2 and "impossible: oil.bulk_modulus is 210 Pa" in result.stdout
    assert len(result.stderr.splitlines()) == 1 and "oil.bulk_modulus" in result.stderr
    # Expected: mineral oil swells by 0.07 % a kelvin, so that 229 cm³ grow by 3.2 cm³ in 20 K.
    unit = Unit.load(EXAMPLES / "rig6.base.yaml")
    assert unit.cylinder.volume_1 + unit.cylinder.volume_2 == pytest.approx(229e-6, rel=0.05)
    unit.accumulator.gas_volume, unit.accumulator.oil_volume = 3e-6, 1e-6
    (remark,) = unit_remarks(unit)
    assert remark.keys == ("gas_volume",) and not remark.impossible and "gas is 3 cm³" in remark.problem


@pytest.mark.parametrize("profile", ["axis_a", "axis_b", *(EXAMPLES / f"rig{k}.base.yaml" for k in (6, 7))])
def test_real_units_are_not_odd(ran, profile):
    result = ran("profile", "check", profile)
    assert "Nothing is odd" in result.stdout
    left_out = EXAMPLES / "bench.base.yaml"
    ran("profile", "check", left_out)  # it says nothing of the accumulator's oil


@pytest.mark.parametrize("rig", ["rig6", "rig7"])
def test_the_examples_are_what_their_data_sheets_make(run, tmp_path, rig):
    out = tmp_path / "base.yaml"
    run("profile", "new", "--from", EXAMPLES / f"{rig}.datasheet.yaml", "-o", out)
    assert out.read_text("utf-8") == (EXAMPLES / f"{rig}.base.yaml").read_text("utf-8")


@pytest.mark.parametrize("shifted", [0.0, -1.2e-4])
@pytest.mark.parametrize(("cooling", "heating"), [(30.0, 30.0), (70.0, 10.0), (0.0, 60.0)])
def test_the_accumulator_keeps_its_pressures_and_is_no_larger(shifted, cooling, heating):
    """Expected: by Boyle's law both bounds hold, and with 10 cm³ less one is broken; so for the oil."""
    total, loaded = 4.32e-3, 2.16e-3
    gas, oil = accumulator_volumes(total, loaded, 3.44e6, 2.1e8, shifted, cooling, heating)
    arriving = 7e-4 * total * heating + abs(shifted)
    leaving = 7e-4 * total * cooling + loaded * 3.44e6 / 2.1e8 + abs(shifted)

    def keeps(volume: float) -> bool:
        least, most = volume / (volume + leaving), volume / (volume - arriving)
        return volume > arriving and most <= 1.6 and least >= 0.6

    assert keeps(gas) and not keeps(gas - 1e-5)
    assert oil >= 1.1 * leaving > oil - 1e-5
    assert math.isclose(1e5 * gas, round(1e5 * gas)) and math.isclose(1e5 * oil, round(1e5 * oil))
