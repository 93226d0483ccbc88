"""The rig's valves: what they write into the conditions, and which settings are refused."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.errors import InputError
from fdd.plant import conditions as c
from fdd.plant.circuit import Circuit, ExternalAccumulators, apply, check_charging
from fdd.plant.prepare import axis_conditions, prepare
from fdd.plant.scenario import Scenario
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
TIME = np.arange(3000) * 1e-3


ZEROS = np.zeros(TIME.size)


def rows_of(scenario: Scenario, axis: int = 1) -> np.ndarray:
    return axis_conditions(UNIT, scenario, TIME, ZEROS, ZEROS, axis=axis).rows


def changed_by(circuit: Circuit) -> np.ndarray:
    rows = np.zeros((TIME.size, c.COLUMNS))
    apply(circuit, rows, TIME)
    return rows


def test_a_rig_as_it_stands_is_healthy_bit_for_bit() -> None:
    assert rows_of(Scenario()).tobytes() == c.healthy_conditions(UNIT, ZEROS, ZEROS).tobytes()


def test_by_pass_and_throttle_add_across_the_cylinder() -> None:
    rows = changed_by(Circuit(bypass="0:0/2:1", throttle=0.5, bypass_flow=2e-4, throttle_flow=1e-4))
    assert np.flatnonzero(rows.any(axis=0)).tolist() == [c.BYPASS]
    np.testing.assert_allclose(rows[[0, 1000, 2500], c.BYPASS], [5e-5, 1.5e-4, 2.5e-4])


def test_the_by_pass_drops_what_the_thesis_says_at_full_flow() -> None:
    """4.4: about 137 kPa at 1.39e-4 m³/s."""
    flow_at_1_mpa = changed_by(Circuit(bypass=1))[0, c.BYPASS]
    assert 1e6 * (1.39e-4 / flow_at_1_mpa) ** 2 == pytest.approx(137e3, rel=0.01)


def test_power_and_valves_go_to_their_own_axis() -> None:
    partner = {"power": "0:1/2:0", "circuit": {"throttle": 1.0}}
    worn = {"fault": "motor_degradation", "severity": 1.0, "axis": 2}
    scenario = Scenario(power=0.8, circuit={"bypass": 0.1}, partner=partner, warming=0.01, faults=[worn])
    one, two = rows_of(scenario), rows_of(scenario, axis=2)
    np.testing.assert_allclose(one[:, c.CURRENT_LIMIT], 0.8)
    np.testing.assert_allclose(two[[0, 1000, 2500], c.CURRENT_LIMIT], [0.8, 0.4, 0.0])
    assert one[0, c.BYPASS] == pytest.approx(0.1 * Circuit().bypass_flow)
    assert two[0, c.BYPASS] == pytest.approx(Circuit().throttle_flow)
    assert np.all(one[:, c.WARMING] == 0.01) and np.all(two[:, c.WARMING] == 0.01)


def test_the_partners_own_speeds() -> None:
    own = {"drive": "own", "duty": {"name": "levels", "points": "0:40/1:-60"}}
    setpoint = prepare(UNIT, Scenario(duration=1.5, partner=own)).setpoints[1]
    assert setpoint[[0, 999, 1000, 1499]].tolist() == [40.0, 40.0, -60.0, -60.0]
    for partner in ({"drive": "still"}, {"drive": "same"}):
        assert not prepare(UNIT, Scenario(duration=0.01, partner=partner)).setpoints[1].any()


SHUT = {"blocked": True}
OPEN = {"blocked": True, "throttle": 0.5}
BOTH = {"line_1": 1, "line_2": 1}
# What contradicts itself: one case for each line of the table in fdd.plant.scenario.
REFUSED = {
    "connect without partner": ({"connect": {"line_1": 1}}, "no partner"),
    "two throttled partners": ({"partner": {}, "load": {"name": "throttle"}}, "the partner's own throttle"),
    "both blocked": ({"circuit": OPEN, "partner": {"circuit": OPEN}}, "both axes are blocked"),
    "blocked alone": ({"circuit": OPEN}, "no partner moves its cylinder"),
    "lock of the partner": ({"partner": {"circuit": SHUT}}, "hydraulic lock: the partner"),
    "lock although connected": ({"partner": {"circuit": SHUT}, "connect": BOTH}, "hydraulic lock"),
    "lock of the first": ({"circuit": SHUT, "partner": {}}, "hydraulic lock: the first axis"),
    "lock by the partner's own drive": (
        {
            "circuit": SHUT, "duty": {"name": "standstill"}, "control": {"mode": "speed"},
            "partner": {"drive": "own", "duty": {"name": "steps"}},
        },
        "hydraulic lock: the first axis",
    ),
    "lock by the own pump over the connect valves": (
        {"circuit": SHUT, "partner": {"drive": "still"}, "connect": BOTH}, "hydraulic lock: the first axis",
    ),
    "position loop without its cylinder": (
        {"circuit": OPEN, "partner": {"drive": "still"}}, "position loop would not see",
    ),
    "two charging pumps": (
        {"circuit": {"charging": 1}, "partner": {"circuit": {"charging": "0:0/1:1"}}}, "one charging pump",
    ),
    "charging above its rating": ({"circuit": {"charging_pressure": 9.7e6}}, "9650000"),
    "drive own without duty": ({"partner": {"drive": "own"}}, "needs a duty"),
    "shuttle of the partner": (
        {"partner": {"drive": "own", "duty": {"name": "constant_speed"}}}, "its own encoder",
    ),
    "fault of no partner": (
        {"faults": [{"fault": "aeration", "severity": 0.1, "axis": 2}]}, "there is no axis 2",
    ),
    "unknown valve": ({"circuit": {"by_pass": 1}}, "the parameters are: blocked, bypass"),
}  # fmt: skip

ALLOWED = {
    "leakage coefficient by throttling (5.2)": {"partner": {"drive": "still", "circuit": OPEN}},
    "its mirror image": {"circuit": OPEN, "partner": {}},
    "both pumps on one cylinder (4.6.7)": {"partner": {"circuit": OPEN}, "connect": BOTH},
    "charging while leaking (4.6.4)": {"circuit": {"charging": 1, "external_leakage": 0.3}},
    "by-pass on a driving axis (4.6.8)": {"circuit": {"bypass": 1}},
    "a way out that opens late": {"partner": {"circuit": {"blocked": True, "throttle": "0:0/5:1"}}},
    "blocked partner, nothing moves": {"duty": {"name": "standstill"}, "partner": {"circuit": SHUT}},
    "blocked partner, first axis without power": {"power": 0, "partner": {"circuit": SHUT}},
    "a pump against its relief valve": {
        "circuit": SHUT, "control": {"mode": "speed"}, "partner": {"drive": "still"},
    },
    "one fault on each axis": {
        "partner": {}, "faults": [{"fault": "aeration", "severity": 0.1, "axis": k} for k in (1, 2)],
    },
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_contradictory_valves_are_told_in_one_line(name) -> None:
    arguments, told = REFUSED[name]
    with pytest.raises(InputError) as caught:
        Scenario(**arguments)
    assert told in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ALLOWED)
def test_what_the_rig_can_do_is_allowed_and_travels(name) -> None:
    scenario = Scenario(**ALLOWED[name])
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario


def test_charging_is_checked_against_the_units_pressures() -> None:
    check_charging(Circuit(charging=1), UNIT)
    check_charging(Circuit(charging_pressure=1.0), UNIT)  # the pump stands
    with pytest.raises(InputError, match="adds nothing"):
        check_charging(Circuit(charging=1, charging_pressure=0.9 * UNIT.accumulator.charge_pressure), UNIT)
    with pytest.raises(InputError, match="adds nothing"):
        check_charging(Circuit(charging=1), UNIT, charge_factor=2.0)
    # 3.44 + 9.30 = 12.74 MPa exceed 10.34 MPa; the bulk-modulus circuit's relief valve protects (4.6.3).
    high = {"charging": 1, "charging_pressure": 9.30e6}
    with pytest.raises(InputError, match=r"exceeds the rated 10.34 MPa.*accumulators"):
        check_charging(Circuit(**high), UNIT)
    check_charging(Circuit(**high, accumulators=ExternalAccumulators()), UNIT)
    check_charging(Circuit(charging=1, charging_pressure=6.8e6), UNIT)
    with pytest.raises(InputError, match="exceeds the rated"):
        rows_of(Scenario(partner={"circuit": high}), axis=2)
