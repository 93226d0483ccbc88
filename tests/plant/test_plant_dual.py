"""Two axes on one rod: symmetry, sums of flows, one axis as the other's load, an axis without power."""

from typing import Any

import numpy as np
import pytest

from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import Simulation, simulate
from fdd.unit import Unit

A, B = Unit.load("axis_a"), Unit.load("axis_b")
WHOLE = Recording.perfect()
SPEED = {"mode": "speed"}
ONE_WAY = {"name": "levels", "points": "0:0/0.1:80"}


def _dual(partner: dict[str, Any], **scenario: Any) -> Simulation:
    defaults = {"duration": 1.2, "duty": ONE_WAY, "control": SPEED, "recording": WHOLE, "seed": 2}
    return simulate(A, Scenario(**{**defaults, **scenario, "partner": partner}), partner=B)


def _steady(out: Simulation, column: str, rows: int = 200) -> float:
    return float(out.truth[column][-rows:].mean())


@pytest.mark.parametrize("mode", ["speed", "position"])
@pytest.mark.parametrize(
    ("load", "size"),
    [
        # No load at the start, so that both axes start alike.
        ({"name": "spring", "slack": 0.0}, {"rate": 2e4}),
        ({"name": "spring", "slack": 0.01}, {"rate": 4e4}),
        ({"name": "inertia"}, {"added": 60.0}),
    ],
)
def test_two_alike_move_like_one_with_half_the_load(mode, load, size):
    """Identical units, friction and command: (2·F_axis - load)/(2·M + m) = (F_axis - load/2)/(M + m/2)."""
    unit = A.model_copy(update={"friction": A.friction.model_copy(update={"trial_spread": 0.0})})
    duty = {"name": "prbs", "bit": 0.3, "speed": 90.0, "amplitude": 0.01}
    duty["offset"] = load.get("slack", 0.0)
    same: dict[str, Any] = {"duration": 2.0, "duty": duty, "control": {"mode": mode}, "recording": WHOLE}
    same["accumulator"] = "each"
    two = simulate(unit, Scenario(**same, load={**load, **size}, partner={}), partner=unit)
    half = {name: 0.5 * value for name, value in size.items()}
    one = simulate(unit, Scenario(**same, load={**load, **half}))
    assert two.partner is not None
    assert np.ptp(one.truth["position"]) > 5e-3
    for column, scale in (
        ("position", 1e-9), ("velocity", 1e-7), ("pressure_1", 1.0), ("pressure_2", 1.0),
        ("pump_speed", 1e-5), ("motor_current", 1e-6), ("pressure_accumulator", 1.0),
    ):  # fmt: skip
        np.testing.assert_allclose(two.truth[column], one.truth[column], rtol=0.0, atol=scale, err_msg=column)
        np.testing.assert_allclose(two.partner.truth[column], two.truth[column], rtol=0.0, atol=scale)


def test_connected_two_pumps_drive_one_cylinder_at_twice_the_speed():
    """Section 4.6.6: both lines joined, one ball valve shut; the other cylinder follows over its throttle."""
    shut_off = {"blocked": True, "throttle": 1.0}
    both = _dual({"circuit": shut_off}, connect={"line_1": 1.0, "line_2": 1.0})
    alone = _dual({"circuit": shut_off, "drive": "still"})
    displaced = A.pump.displacement + B.pump.displacement
    ratio = _steady(both, "velocity") / _steady(alone, "velocity")
    assert ratio == pytest.approx(displaced / A.pump.displacement, rel=0.03)
    assert both.partner is not None
    # All that the second pump moves goes over the connect valves, both ways.
    given = _steady(both, "connect_flow_1")
    assert given == pytest.approx(_steady(both.partner, "pump_flow"), rel=0.03)
    assert _steady(both, "connect_flow_2") == pytest.approx(-given, rel=0.03)


@pytest.mark.parametrize("opening", [0.2, 0.4])
def test_a_blocked_axis_throttled_loads_the_other(opening):
    """Section 4.6.7: its drop is the throttle's law at the flow of the moving cylinder."""
    out = _dual({"drive": "still", "circuit": {"blocked": True, "throttle": opening}})
    assert out.partner is not None
    flow = B.cylinder.area_1 * _steady(out, "velocity")
    drop = -_steady(out.partner, "pressure_difference")
    assert drop > 5e4
    # Nothing refeeds the blocked cylinder: beyond twice the charge its low side would cavitate.
    assert drop < 0.5e6
    assert flow == pytest.approx(opening * 3e-4 * np.sqrt(drop / 1e6), rel=0.01)
    # Axis A carries both frictions and that drop.
    pushed = A.cylinder.area_1 * _steady(out, "pressure_difference")
    rubs = _steady(out, "friction_force") + _steady(out.partner, "friction_force")
    assert pushed == pytest.approx(rubs + B.cylinder.area_1 * drop, rel=0.01)


def test_an_axis_whose_motor_holds_stops_the_other_unless_its_by_pass_is_open():
    carried = _dual({"drive": "still", "circuit": {"bypass": 1.0}})
    fought = _dual({"drive": "still"}, duration=5.0)
    full = A.pump.displacement * 80.0 / A.cylinder.area_1
    assert _steady(carried, "velocity") == pytest.approx(full, rel=0.05)
    # The axes fight up to the relief valves, and what still moves is the second one's leakage: at its mean
    # with half the case leakage, of the high side alone with all of it.
    assert fought.partner is not None
    drop = -_steady(fought.partner, "pressure_difference")
    leakage = B.cylinder.area_1 * _steady(fought, "velocity") / drop
    assert 0.95 * B.pump.total_leakage < leakage < 1.1 * (B.pump.cross_port_leakage + B.pump.case_leakage)
    assert _steady(fought, "velocity") < 0.4 * full
    # Its valve once open, friction holds it within its hysteresis of 5 %.
    assert 1.0 > _steady(fought, "port_difference") / A.accumulator.relief_pressure > 0.95
    assert fought.truth["port_difference"].max() > A.accumulator.relief_pressure
    assert _steady(fought, "relief_flow") > 1e-6


def test_an_axis_without_power_is_carried_and_its_pump_turns_only_where_the_by_pass_is_shut():
    """A gear pump is a motor: shut in, the oil turns it against its dry friction; by-passed, it stands."""
    opened = _dual({"power": 0.0, "circuit": {"bypass": 1.0}})
    # Its rotor, 14 t seen from the rod, swings on the oil for seconds.
    shut = _dual({"power": 0.0}, duration=7.0, duty={**ONE_WAY, "offset": -0.12})
    assert opened.partner is not None and shut.partner is not None
    full = A.pump.displacement * 80.0 / A.cylinder.area_1
    assert _steady(opened, "velocity") == pytest.approx(full, rel=0.05)
    assert abs(_steady(opened.partner, "pump_speed")) < 0.5
    turned, carried = _steady(shut.partner, "pump_speed"), _steady(shut, "velocity") * B.cylinder.area_1
    assert turned == pytest.approx(carried / B.pump.displacement, rel=0.05)
    # It takes the torque of its friction, as a pressure.
    sheared = 2e4 * B.oil.density * B.oil.viscosity_40 * B.pump.displacement
    torque = (B.drive.viscous_friction + sheared) * turned + 0.045
    drop = -_steady(shut.partner, "port_difference", 4000)
    assert drop * B.pump.displacement * (1.0 - 0.04) == pytest.approx(torque, rel=0.1)
    assert _steady(shut.partner, "motor_current") == pytest.approx(0.0, abs=1e-6)
