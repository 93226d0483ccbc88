"""``fdd profile new --duty``: the thesis's designs from what they are for, and what cannot be reached."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import yaml

from fdd.data_sheet import Answers, typed_unit
from fdd.data_sheet.accumulator import accumulator_volumes
from fdd.data_sheet.duty import DUTY, read_duty
from fdd.data_sheet.efficiency import volumetric_efficiency
from fdd.data_sheet.sizing import Sizing, sized
from fdd.unit import Unit

RUDDER = Path(__file__).parents[2] / "examples" / "rudder.duty.yaml"

PROTOTYPE = {
    "name": "prototype", "load": "5.22 kN", "loaded_speed": "0.1 m/s", "stroke": "0.30 m",
    "rated_pressure": "3.44 MPa", "max_speed": "314.16 rad/s", "bore": "2 in", "rod_diameter": "1 in",
    "pump_displacement": "5.57e-7 m^3/rad", "leakage": "6.52e-12 m^3/(s*Pa)", "moving_mass": "3.688 kg",
    "chamber_volume_1": "2.16 L", "chamber_volume_2": "2.16 L", "bulk_modulus": "210 MPa",
    "torque_constant": "1.61 N*m/A", "winding_resistance": "1.04 ohm", "current_limit": "10 A",
    "inertia": "1.84e-3 kg*m^2",
}  # fmt: skip
"""The 3.44 MPa prototype of section 4.6: what its cylinder holds, and its parts (Tables 4.11 and 4.21)."""


def rudder(**changes: object) -> dict[str, object]:
    """The flight design's duty with some keys changed; None leaves one out."""
    duty = {**yaml.safe_load(RUDDER.read_text("utf-8")), **changes}
    return {k: v for k, v in duty.items() if v is not None}


def rows(found: Sizing) -> dict[str, float]:
    return {row.quantity: row.value for row in found.rows}


@pytest.mark.parametrize(
    ("quantity", "thesis", "within"),
    [
        ("load of one circuit", 31.14e3, 1e-4),  # Table 4.5
        ("rod diameter", 22.2e-3, 2e-3),  # eqs 4.1 to 4.3, 160.5 MPa
        ("piston area", 1.52e-3, 1e-3),  # eq. 4.4, Table 4.5
        ("flow needed", 1.39e-4, 6e-3),  # eq. 4.6, Table 4.5: 1.397e-4, cut to three figures
        ("pump displacement", 4.42e-7, 7e-3),  # eq. 4.7, from the cut flow and 314.59 rad/s
        ("power of one motor", 2.41e3, 1e-4),  # section 4.4, half of Table 4.2's
        ("nominal torque", 7.66, 2e-3),  # eq. 4.8; Table 4.5 prints the motor's own, 7.1 N·m
        ("leakage at the rated pressure", 2.085e-5, 0.011),  # section 4.4, of eq. 4.6's flow
        ("port diameter, at least", 1.20e-2, 3e-3),  # eq. 4.9
        ("volumetric efficiency at the rated pressure", 0.85, 1e-9),  # section 4.4; 80 to 85 % in 5.2
        ("speed at the load, leakage counted", 7.62e-2, 0.02),  # Table 4.2: 7.62e-2 to 9.19e-2 m/s
    ],
)  # fmt: skip
def test_the_flight_design_is_the_thesis_s(quantity: str, thesis: float, within: float) -> None:
    assert rows(sized(read_duty(RUDDER)))[quantity] == pytest.approx(thesis, rel=within)


def test_where_the_thesis_contradicts_itself() -> None:
    """Eq. 4.1 gives 1.506e-3 m² where it prints 1.48e-3; eq. 4.5's 5.03e-2 m follows from the printed one.

    The stroke is printed as ±3.37 mm once, ±33.7 mm else. The pump chosen gives 0.0905 m/s without load,
    Table 4.2 asks for 0.13; its torque at 20.68 MPa is 9.06 N·m, above eq. 4.8's 7.66. Table 4.2's power is
    less than its load times its largest loaded speed, and its stall force less than that load.
    """
    found = rows(sized(read_duty(RUDDER)))
    assert found["piston area needed"] == pytest.approx(31.14e3 / 20.68e6) != pytest.approx(1.48e-3, rel=0.01)
    printed = f"{2 * 1.48e-3 * 20.68e6} N"
    smaller = rudder(load=printed, bore=None, stall_load=None)
    assert rows(sized(Answers.of(smaller, questions=DUTY)))["bore"] == pytest.approx(5.03e-2, rel=1e-3)
    assert found["speed without load"] == pytest.approx(0.0905, rel=1e-3)
    assert found["torque at the relief setting"] == pytest.approx(9.06, rel=1e-3)
    problems = " ".join(r.problem for r in sized(read_duty(RUDDER)).remarks)
    assert "0.0905 of 0.13 m/s" in problems and "2.41 kW, load times loaded_speed 2.86 kW" in problems


def test_the_prototype_is_the_shipped_axis() -> None:
    """Expected: what Table 4.21 and sections 4.4 to 4.6 say of it, as axis_a has it."""
    found, axis = sized(Answers.of(PROTOTYPE, questions=DUTY)), Unit.load("axis_a")
    unit = typed_unit(found.answers)
    for section, names in {
        "cylinder": ("area_1", "area_2", "stroke", "moving_mass", "volume_1", "volume_2"),
        "pump": ("displacement", "total_leakage"),
        "accumulator": (
            "relief_pressure",
            "charge_pressure",
            "refeed_cracking_pressure",
            "gas_volume",
            "oil_volume",
        ),
        "drive": ("max_speed", "torque_constant", "winding_resistance", "inertia"),
        "oil": ("bulk_modulus", "viscosity_40"),
    }.items():
        for name in names:
            ours, theirs = getattr(getattr(unit, section), name), getattr(getattr(axis, section), name)
            assert ours == pytest.approx(theirs, rel=1e-3), name
    mean = 0.5 * (unit.friction.forward.static + unit.friction.reverse.static)
    assert mean == pytest.approx((510.4 + 448.0 + 467.7 + 479.2) / 4, rel=1e-3)  # Table 5.1
    assert rows(found)["speed without load"] == pytest.approx(0.1151, rel=1e-3)
    small = sized(Answers.of({**PROTOTYPE, "gas_volume": "13 cm^3"}, questions=DUTY))
    assert any("13 cm^3, is less than the 250 cm^3" in r.problem for r in small.remarks)


def test_a_mass_that_is_not_given_is_the_prototype_s() -> None:
    duty = {k: v for k, v in PROTOTYPE.items() if k != "moving_mass"}
    assert rows(sized(Answers.of(duty, questions=DUTY)))["moving mass"] == pytest.approx(3.688, rel=0.05)


def test_nothing_but_what_must_be_said() -> None:
    """Expected: the calculated sizes carry the load at the relief setting and reach the speed unloaded."""
    least = {
        k: PROTOTYPE[k] for k in ("name", "load", "loaded_speed", "stroke", "rated_pressure", "max_speed")
    }
    unit = typed_unit(sized(Answers.of(least, questions=DUTY)).answers)
    assert unit.cylinder.area_1 * unit.accumulator.relief_pressure == pytest.approx(5220.0)
    assert unit.pump.displacement * unit.drive.max_speed / unit.cylinder.area_1 == pytest.approx(0.1)
    assert unit.drive.torque_constant * unit.drive.current_limit > unit.pump.displacement * 3.44e6


def test_unequal_areas_size_flow_by_the_larger_and_force_by_the_smaller() -> None:
    """A single rod: 20 and 12 cm², 2.4 kN at 2 MPa on the smaller; 100 mm/s on the larger takes 12 L/min."""
    duty = {"name": "press", "load": "2.4 kN", "loaded_speed": "100 mm/s", "stroke": "300 mm",
            "rated_pressure": "20 bar", "max_speed": "3000 rpm", "piston_area_1": "20 cm^2",
            "piston_area_2": "12 cm^2"}  # fmt: skip
    found = rows(sized(Answers.of(duty, questions=DUTY)))
    assert found["flow needed"] == pytest.approx(12e-3 / 60)
    shifted = 0.5 * 8e-4 * 0.3
    assert found["accumulator's oil at rest"] > 1.1 * shifted
    with pytest.raises(ValueError, match=r"carries 2\.4 kN of the 2\.5 kN"):
        sized(Answers.of({**duty, "load": "2.5 kN"}, questions=DUTY))


def test_the_profile_is_whole_and_can_be_simulated(run, tmp_path: Path) -> None:
    out = tmp_path / "rudder.yaml"
    result = run("profile", "new", "--duty", RUDDER, "-o", out)
    assert result.exit_code == 0, result.stderr
    for words in ("thesis eq. 4.1", "31.14", "kN", "pump displacement", "thesis eq. 4.9", "accumulator rule"):
        assert words in result.stdout, words
    unit = Unit.load(out)
    for section in (unit.cylinder, unit.pump, unit.oil, unit.accumulator, unit.friction.forward, unit.drive):
        for name in set(type(section).model_fields) - {"provenance", "refeed_pilots"}:
            source = section.provenance[name].source or ""
            assert source.startswith(("sizing: ", "assumption: ")), (name, source)
    assert unit.cylinder.provenance["area_1"].source == "sizing: thesis eq. 4.4"
    assert unit.cylinder.provenance["stroke"].source == "sizing: duty, 67.4 mm"
    assert run("profile", "check", out).exit_code == 0
    log = tmp_path / "x.mcap"
    result = run("simulate", "--unit", out, "--duration", 1, "-o", log)
    assert result.exit_code == 0 and log.stat().st_size > 1e5, result.stderr


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"lode": "3 kN"}, ["unknown key 'lode'", "loaded_speed"]),
        ({"load": None}, ["missing: load (N)"]),
        ({"stroke": None}, ["missing: stroke (m)"]),
        ({"stroke": "0 mm"}, ["stroke", "not between"]),
        ({"load": "62.28 MPa"}, ["load", "measures pressure, not force"]),
        ({"power": "4.82 kN"}, ["power", "measures force, not power"]),
        ({"max_speed": 3000}, ["max_speed: 3000 rad/s", "3000 rpm"]),
        ({"circuits": 1.5}, ["circuits", "no whole number"]),
        ({"circuits": 1}, ["load: out of reach", "31.44 kN of the 62.28 kN"]),
        ({"stall_load": "80 kN"}, ["stall_load: out of reach", "40 kN"]),
        ({"rod_diameter": "20 mm"}, ["rod_diameter", "needs 22.2 mm"]),
        ({"bore": "25 mm"}, ["bore", "not more than the rod's"]),
        ({"piston_area_1": "15 cm^2"}, ["bore and piston_area_1"]),
        ({"loaded_speed": "0.13 m/s"}, ["loaded_speed: out of reach", "0.0905 of 0.13"]),
        ({"current_limit": "5 A"}, ["current_limit: out of reach", "8.97 N*m"]),
        ({"coldest": "50 degC"}, ["coldest", "not between"]),
        ({"charge_pressure": "3 MPa", "relief_pressure": "2 MPa", "circuits": 4}, ["out of reach"]),
        ({"leakage": "9 L/min"}, ["leaks away"]),
    ],
    ids=str,
)  # fmt: skip
def test_a_bad_duty_is_refused_in_one_line(run, one_line, tmp_path: Path, changes, words) -> None:
    path, out = tmp_path / "some.yaml", tmp_path / "unit.yaml"
    path.write_text(yaml.safe_dump(rudder(**changes)), encoding="utf-8")
    one_line(run("profile", "new", "--duty", path, "-o", out), str(path), *words)
    assert not out.exists()


def test_no_such_duty_and_two_files_are_refused(run, one_line, tmp_path: Path) -> None:
    out = tmp_path / "unit.yaml"
    one_line(run("profile", "new", "--duty", tmp_path / "none.yaml", "-o", out), "no such duty file")
    one_line(run("profile", "new", "--duty", RUDDER, "--from", RUDDER, "-o", out), "--from and --duty")


@pytest.mark.parametrize("shifted", [0.0, -1.2e-4])
@pytest.mark.parametrize(("cooling", "heating"), [(30.0, 30.0), (70.0, 10.0), (0.0, 60.0)])
def test_the_accumulator_keeps_its_pressures_and_is_no_larger(shifted, cooling, heating) -> None:
    """Expected: by Boyle's law both bounds hold, and with 10 cm³ less one is broken; so for the oil."""
    total, loaded = 4.32e-3, 2.16e-3
    gas, oil = accumulator_volumes(total, loaded, 3.44e6, 2.1e8, shifted, cooling, heating)
    arriving = 7e-4 * total * heating + abs(shifted)
    leaving = 7e-4 * total * cooling + loaded * 3.44e6 / 2.1e8 + abs(shifted)

    def keeps(volume: float) -> bool:
        return (
            volume > arriving and volume / (volume - arriving) <= 1.6 and volume / (volume + leaving) >= 0.6
        )

    assert keeps(gas) and not keeps(gas - 1e-5)
    assert oil >= 1.1 * leaving > oil - 1e-5
    assert math.isclose(1e5 * gas, round(1e5 * gas)) and math.isclose(1e5 * oil, round(1e5 * oil))


def test_efficiency_is_that_of_equation_5_4() -> None:
    """Axis A at 1000 rpm and 3.36 MPa.

    Expected: 3.39e-5 of 5.76e-5 m³/s arrive at the end point, 58.9 %, whose coefficient is 7.05e-12; the
    printed slope, 6.52e-12, gives 62 %. The thesis draws the curve (figure 5.5) and prints no number of it.
    5.76e-5 m³/s is D_p = 5.50e-7 m³/rad.
    """
    end_point = (5.76e-5 - 3.39e-5) / 3.36e6
    assert volumetric_efficiency(5.76e-5 / 104.7, 104.7, end_point, 3.36e6) == pytest.approx(3.39 / 5.76)
    assert volumetric_efficiency(5.50e-7, 104.7, 6.52e-12, 3.36e6) == pytest.approx(0.620, abs=1e-3)
    assert volumetric_efficiency(5.50e-7, 104.7, 4.27e-12, 3.36e6) == pytest.approx(0.751, abs=1e-3)  # axis B
