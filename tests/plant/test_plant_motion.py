"""Forces on the rod, and the valves beside it: friction, stops, current, leakage, relief, charging."""

from typing import Any

import numpy as np
import pytest

from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.plant.truth import Truth
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
WHOLE = Recording.perfect()
SPEED = {"mode": "speed"}
STILL = {"name": "standstill"}
TO_AN_END = {"name": "constant_speed", "speeds": [105.0], "amplitude": 0.12, "dwell": 0.0, "lead_in": 0.1}


def _truth(unit: Unit = UNIT, **scenario: Any) -> Truth:
    return simulate(unit, Scenario(recording=WHOLE, **scenario)).truth


def test_a_stuck_piston_yields_as_a_spring_and_comes_back():
    """Below static friction the seal's bristles carry: σ0 over small deflections, and nothing slides."""
    details = {"bristle_stiffness": 1e6, "pump_ripple": 0.0}
    load = {"name": "gust", "deviation": 30.0, "bandwidth_hz": 2.0}
    truth = _truth(duration=4.0, duty=STILL, control=SPEED, load=load, details=details)
    x, force = truth["position"], truth["friction_force"]
    assert 20.0 < np.ptp(force) < 300.0
    assert np.ptp(x) < 3e-4
    assert np.polyfit(x, force, 1)[0] == pytest.approx(1e6, rel=0.15)


def test_the_current_carries_pump_torque_and_friction():
    """Torque constant times current is D·Δp, what gears rub, viscous and dry friction, at steady speed."""
    details = {"pump_ripple": 0.0, "pump_coulomb_torque": 0.05, "cogging_torque": 0.0, "pump_friction": 0.06}
    truth = _truth(duration=2.6, duty=TO_AN_END, control=SPEED, load={"name": "throttle"}, details=details)
    torque = 1.06 * UNIT.pump.displacement * truth["port_difference"][-200]
    sheared = 2e4 * UNIT.oil.density * UNIT.oil.viscosity_40 * UNIT.pump.displacement
    torque += (UNIT.drive.viscous_friction + sheared) * 105.0 + 0.05
    assert UNIT.drive.torque_constant * truth["motor_current"][-200] == pytest.approx(torque, rel=2e-3)


def _into_the_stop(**details: Any) -> Truth:
    """A weight pulls the rod out over an open by-pass."""
    weight, opened = {"name": "constant", "level": -3000.0}, {"bypass": 1.0}
    duty = {**STILL, "offset": 0.05}
    return _truth(duration=1.5, duty=duty, control=SPEED, load=weight, circuit=opened, details=details)


def test_end_stops_hold_the_piston():
    truth = _into_the_stop()
    beyond = truth["position"] - 0.5 * UNIT.cylinder.stroke
    assert truth["stop_force"][-1] > 2000.0
    assert beyond[-1] == pytest.approx(truth["stop_force"][-1] / 2e7, rel=1e-3)
    assert beyond.max() < 1e-3


def test_cushions_slow_the_piston_before_the_stop():
    """Over the last 12 mm a cushion takes c·v²: the impact is weaker, and the way up to there is the same."""
    with_, without = _into_the_stop(), _into_the_stop(cushion_damping=0.0)
    half = 0.5 * UNIT.cylinder.stroke
    for position, least, most in ((half - 0.013, 1.0 - 1e-6, 1.0 + 1e-6), (half, 0.2, 0.6)):
        assert least < _before(with_, position) / _before(without, position) < most


def _before(truth: Truth, position: float) -> float:
    """Velocity in the last millisecond before the piston first gets there."""
    return float(truth["velocity"][np.flatnonzero(truth["position"] >= position)[0] - 1])


def _throttled(unit: Unit, pressure: float) -> list[float]:
    """Pressure drop, flow lost, refed and the low side's pressure over the accumulator's, at steady speed."""
    # The long stroke back, to its end: the pressure needs seconds to settle.
    details = {"pump_ripple": 0.0, "line_loss": 0.0, "heat_capacity": 1e7, "cushion_damping": 0.0}
    run = {"duration": 9.0, "duty": TO_AN_END, "control": SPEED, "details": details, "charge_factor": 3.0}
    truth = _truth(unit, load={"name": "throttle", "pressure": pressure}, **run)
    lost = truth["pump_flow"] - unit.cylinder.area_1 * truth["velocity"]
    refed = 0.5 * (truth["refeed_flow_2"] - truth["refeed_flow_1"])
    low = np.minimum(truth["pressure_1"], truth["pressure_2"]) - truth["pressure_accumulator"]
    return [float(np.mean(v[8200:9000])) for v in (truth["pressure_difference"], lost, refed, low)]


def test_modes_of_section_3_2_1_arise_by_themselves():
    """Loss of the driven chamber over pressure: half of C_ep in mode 1, whose mean stays, all in mode 2,
    whose low side is held. (The thesis takes C_ep as 0 there, eq. 3.63: oil comes back through the case.)"""
    leaky = UNIT.pump.model_copy(update={"case_leakage": 8e-12, "cross_port_leakage": 3e-12})
    unit = UNIT.model_copy(update={"pump": leaky})
    stiff = unit.accumulator.model_copy(update={"refeed_cracking_pressure": 2e6})
    kept = unit.model_copy(update={"accumulator": stiff})
    pressures = (0.5e6, 1e6, 2e6, 4e6)
    rising, held = (np.array([_throttled(machine, p) for p in pressures]).T for machine in (kept, unit))
    slopes = [np.polyfit(drop, lost, 1)[0] for drop, lost, _, _ in (rising, held)]
    assert np.abs(rising[2]).max() < 1e-12
    assert rising[3].max() < -1e5 and np.ptp(rising[3]) > 5e5
    assert np.abs(held[2]).min() > 1e-7 and np.ptp(held[3]) < 2e3
    xi, case = leaky.cross_port_leakage, leaky.case_leakage
    # Against the ports' mean density, most.
    compressed = leaky.displacement * 105.0 / (2.0 * UNIT.oil.bulk_modulus)
    assert slopes[0] == pytest.approx(xi + 0.5 * case, rel=0.03)
    assert xi + case < slopes[1] < xi + case + 1.2 * compressed


def test_charging_refills_the_accumulator_up_to_its_setting():
    """With the drain shut again the charging pump brings the pressure to the relief setting, and holds it."""
    circuit = {"external_leakage": "0:1/4:1/4.001:0", "external_leakage_coefficient": 2e-11}
    circuit |= {"charging": "0:0/6:0/6.001:0.05", "charging_pressure": 6e5}
    truth = _truth(duration=80.0, circuit=circuit, duty=STILL, load={"name": "constant", "level": 1200.0})
    pressure = truth["pressure_accumulator"]
    assert pressure[5900] < 0.8 * UNIT.accumulator.charge_pressure
    assert pressure[-1] == pytest.approx(6e5, rel=2e-3)
    assert pressure.max() < 6e5 + 100.0  # the loaded chamber's case leakage still comes in
    rising = (truth.time > 6.2) & (pressure < 5e5)
    # Full flow, a twentieth of 2.83e-7·314.16 m³/s, until the relief valve's last 20 kPa.
    charged = -np.gradient(truth["oil_lost"], truth.time)[rising]
    assert np.median(charged) == pytest.approx(0.05 * 2.83e-7 * 314.16, rel=0.02)
