"""Forces on the rod: Newton's balance, friction's curves, end stops, cushions, the current behind it."""

from typing import Any

import numpy as np
import pytest

from fdd.plant import state as s
from fdd.plant.prepare import prepare
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.plant.truth import Truth
from fdd.unit import Unit
from reports.plant.energies import fine_run

UNIT = Unit.load("axis_a")
WHOLE = Recording.perfect()
SPEED = {"mode": "speed"}


def _truth(unit: Unit = UNIT, **scenario: Any) -> Truth:
    return simulate(unit, Scenario(recording=WHOLE, **scenario)).truth


@pytest.mark.parametrize(
    "load", [{"name": "constant", "level": 1500.0}, {"name": "throttle"}, {"name": "spring"}]
)
def test_forces_balance(load):
    """M·v gained = ∫(A1 p1 - A2 p2 - friction - load - stop) dt, each millisecond, from the findings."""
    duty = {"name": "sines", "amplitude": 0.04, "lead_in": 0.1}
    run = fine_run(UNIT, Scenario(duration=0.6, duty=duty, load=load), nodes=40)
    net = UNIT.cylinder.area_1 * run.at(s.P1) - UNIT.cylinder.area_2 * run.at(s.P2)
    net = net - run.finding(s.FRICTION_FORCE) - run.finding(s.LOAD_FORCE) - run.finding(s.STOP_FORCE)
    v = run.states[:, :, s.V]
    mass = UNIT.cylinder.moving_mass
    gained = mass * (v[:, -1] - v[:, 0])
    # The load's own law, not the finding alone.
    x = run.states[:, :, s.X]
    if load["name"] == "constant":
        assert np.all(run.finding(s.LOAD_FORCE) == 1500.0)
    elif load["name"] == "spring":
        np.testing.assert_allclose(run.finding(s.LOAD_FORCE), 1.5e4 * x, atol=1e-9)
    assert np.abs(gained).max() > 3e-3  # N·s
    # Where the rod turns round, friction has a corner that the quadrature must get round.
    np.testing.assert_allclose(net @ run.weights, gained, rtol=0.0, atol=1e-5 * np.abs(gained).max())


def test_a_stuck_piston_yields_as_a_spring_and_comes_back():
    """Below static friction the seal's bristles carry: σ0 over small deflections, and nothing slides."""
    details = {"bristle_stiffness": 1e6, "pump_ripple": 0.0}
    load = {"name": "gust", "deviation": 30.0, "bandwidth_hz": 2.0}
    duty = {"name": "standstill"}
    truth = _truth(duration=4.0, duty=duty, control=SPEED, load=load, details=details)
    x, force = truth["position"], truth["friction_force"]
    assert 20.0 < np.ptp(force) < 300.0
    assert np.ptp(x) < 3e-4
    slope = np.polyfit(x, force, 1)[0]
    assert slope == pytest.approx(1e6, rel=0.15)


def test_the_current_carries_pump_torque_and_friction():
    """Torque constant times current is D·Δp, what gears rub, viscous and dry friction, at steady speed."""
    duty = {"name": "constant_speed", "speeds": [105.0], "amplitude": 0.12, "dwell": 0.0, "lead_in": 0.1}
    details = {"pump_ripple": 0.0, "pump_coulomb_torque": 0.05, "cogging_torque": 0.0, "pump_friction": 0.06}
    truth = _truth(duration=2.6, duty=duty, control=SPEED, load={"name": "throttle"}, details=details)
    at = -200
    torque = 1.06 * UNIT.pump.displacement * truth["port_difference"][at]
    sheared = 2e4 * UNIT.oil.density * UNIT.oil.viscosity_40 * UNIT.pump.displacement
    torque += (UNIT.drive.viscous_friction + sheared) * 105.0 + 0.05
    assert UNIT.drive.torque_constant * truth["motor_current"][at] == pytest.approx(torque, rel=2e-3)


def _into_the_stop(**details: Any) -> Truth:
    """A weight pulls the rod out over an open by-pass."""
    return _truth(
        duration=1.5,
        duty={"name": "standstill", "offset": 0.05},
        control=SPEED,
        load={"name": "constant", "level": -3000.0},
        circuit={"bypass": 1.0},
        details=details,
    )


def test_end_stops_hold_the_piston():
    truth = _into_the_stop()
    half = 0.5 * UNIT.cylinder.stroke
    end = truth["position"][-1]
    assert truth["stop_force"][-1] > 2000.0
    assert end - half == pytest.approx(truth["stop_force"][-1] / 2e7, rel=1e-3)
    assert truth["position"].max() < half + 1e-3


def test_cushions_slow_the_piston_before_the_stop():
    """Over the last 12 mm a cushion takes c·v²: the impact is weaker, and the way up to there is the same."""
    with_, without = _into_the_stop(), _into_the_stop(cushion_damping=0.0)
    half = 0.5 * UNIT.cylinder.stroke

    for position, ratio in ((half - 0.013, (1.0 - 1e-6, 1.0 + 1e-6)), (half, (0.2, 0.6))):
        assert ratio[0] < _before(with_, position) / _before(without, position) < ratio[1]


def _before(truth: Truth, position: float) -> float:
    """Velocity in the last millisecond before the piston first gets there."""
    first = int(np.flatnonzero(truth["position"] >= position)[0])
    return float(truth["velocity"][first - 1])


def test_friction_follows_equation_5_12_when_sliding():
    """Steady sliding at several speeds gives each direction's curve, times the run's spread."""
    duty = {
        "name": "constant_speed",
        "speeds": [80.0, 160.0, 250.0],
        "amplitude": 0.11,
        "dwell": 0.3,
        "turn": 6.0,
    }
    scenario = Scenario(duration=20.0, duty=duty, control=SPEED, recording=WHOLE, seed=4)
    truth, par = simulate(UNIT, scenario).truth, prepare(UNIT, scenario).parameters[0]
    assert abs(par.coulomb_forward / UNIT.friction.forward.coulomb - 1.0) > 1e-3
    v = truth["velocity"]
    steady = np.abs(v - np.roll(v, 100)) < 2e-4
    for sign, branch, ratio in (
        (1.0, UNIT.friction.forward, par.coulomb_forward / UNIT.friction.forward.coulomb),
        (-1.0, UNIT.friction.reverse, par.coulomb_reverse / UNIT.friction.reverse.coulomb),
    ):
        rows = steady & (sign * v > 0.02)
        assert rows.sum() > 1000
        curve = branch.coulomb + (branch.static - branch.coulomb) * np.exp(
            -((np.abs(v) / branch.stribeck_velocity) ** branch.stribeck_exponent)
        )
        expected = sign * (ratio * curve + branch.viscous * np.abs(v))
        assert np.median(np.abs(truth["friction_force"] - expected)[rows]) < 2.0
