"""The plant linearised: eq. 5.22 for the hydraulics, eq. 6.11 for the drive, softer with accumulators."""

from typing import Any

import numpy as np
import pytest

from fdd import Unit, simulate
from fdd.plant import state as s
from fdd.plant.equations import right_hand_side
from fdd.plant.oil import bulk_modulus
from fdd.plant.prepare import Prepared, prepare
from fdd.plant.scenario import Control, Scenario

ABOVE = 60e3
"""Pa above the accumulator, so that case leakage drains and no check valve refeeds."""
PLAIN = {"pump_ripple": 0.0, "air_law": "free"}
"""Of what eq. 5.22 has not: flow pulses, and air that goes into solution as the pressure rises."""
NUDGE = {s.X: 1e-7, s.V: 1e-6, s.DROP: 1.0}
AXIS_NUDGE = {
    s.P1: 1.0, s.P2: 1.0, s.LINE_1: 1.0, s.LINE_2: 1.0, s.EXTERNAL_1: 1e-12, s.EXTERNAL_2: 1e-12,
    s.SPEED: 1e-3, s.DRIVE: 1.0, s.CURRENT: 1e-5,
}  # fmt: skip


def own(state: int, axis: int = 0) -> int:
    """Where a state of an axis stands in the whole one."""
    return s.SHARED + axis * s.AXIS_STATES + state


class AtRest:
    """A plant at rest whose friction is viscous alone, and its slopes there."""

    def __init__(self, ready: Prepared, viscous: float, above: float, **changes: Any) -> None:
        plain = dict.fromkeys(("bristle_stiffness", "bristle_damping", "seal_damping"), 0.0)
        plain |= {"viscous_forward": viscous, "viscous_reverse": viscous, **changes}
        self.parameters = [par.copy() for par in ready.parameters]
        for par in self.parameters:
            for name, value in plain.items():
                par[name] = value
        self.rows = ready.row(ready.state, 0, ready.conditions(0, 1))
        self.y = np.zeros(ready.state.size)
        for axis, unit in enumerate(ready.units):
            for p in (s.P1, s.P2, s.LINE_1, s.LINE_2):
                self.y[own(p, axis)] = unit.accumulator.charge_pressure + above
            # All but the pressures as it is at rest: oil in the accumulator, air, temperature.
            for state in (s.STORE, s.GAS, s.FREE_1, s.FREE_2, s.TEMPERATURE):
                self.y[own(state, axis)] = ready.state[own(state, axis)]

    def rates(self, y: np.ndarray, command: float = 0.0) -> np.ndarray:
        dy, found = np.empty(y.size), np.empty(len(self.parameters) * s.FINDINGS)
        right_hand_side(y, command, command, self.rows, self.parameters[0], self.parameters[-1], dy, found)
        return dy

    def slope(self, of: list[int], by: int) -> np.ndarray:
        step = NUDGE[by] if by < s.SHARED else AXIS_NUDGE[(by - s.SHARED) % s.AXIS_STATES]
        nudge = np.zeros(self.y.size)
        nudge[by] = step
        return ((self.rates(self.y + nudge) - self.rates(self.y - nudge)) / (2.0 * step))[of]

    def jacobian(self, states: list[int]) -> np.ndarray:
        return np.column_stack([self.slope(states, by) for by in states])


def _stiffness(unit: Unit) -> float:
    """β/V_o."""
    beta = float(bulk_modulus(unit.oil, unit.accumulator.charge_pressure + ABOVE))
    return beta / (0.5 * unit.cylinder.volume_1)


@pytest.mark.parametrize("name", ["axis_a", "axis_b"])
@pytest.mark.parametrize("viscous", [0.0, 760.0])
def test_linearised_it_is_equation_5_22(name, viscous):
    unit = Unit.load(name)
    rest = AtRest(prepare(unit, Scenario(duration=0.01, details=PLAIN)), viscous, ABOVE)
    hydraulic = [s.V, own(s.P1), own(s.P2)]
    jacobian = rest.jacobian(hydraulic)
    area, mass, leakage = unit.cylinder.area_1, unit.cylinder.moving_mass, unit.pump.total_leakage
    stiffness = _stiffness(unit)
    damping, spring = viscous / mass + leakage * stiffness, (area**2 + viscous * leakage) * stiffness / mass
    expected = np.roots([1.0, damping, spring])
    poles = np.linalg.eigvals(jacobian)
    pair = poles[np.argsort(np.abs(poles))[1:]]  # the third is the slow common pressure
    np.testing.assert_allclose(np.sort_complex(pair), np.sort_complex(expected), rtol=1e-4)
    gain = -np.linalg.solve(jacobian, rest.slope(hydraulic, own(s.SPEED)))[0]  # velocity over pump speed
    assert gain == pytest.approx(unit.pump.displacement * area / (area**2 + viscous * leakage), rel=1e-4)


def test_two_axes_linearised_are_both_springs_on_one_mass():
    """Axis A and B on one rod: s² + (2·A²β/V_o)/(M_A + M_B) without friction and leakage's small part."""
    units = [Unit.load("axis_a"), Unit.load("axis_b")]
    scenario = Scenario(duration=0.01, partner={}, details=PLAIN)
    rest = AtRest(prepare(units[0], scenario, partner=units[1]), 0.0, ABOVE)
    states = [s.V, *(own(p, axis) for axis in range(2) for p in (s.P1, s.P2))]
    poles = np.linalg.eigvals(rest.jacobian(states))
    springs = [unit.cylinder.area_1**2 * _stiffness(unit) for unit in units]
    spring = sum(springs)
    damping = sum(k * u.pump.total_leakage * _stiffness(u) for k, u in zip(springs, units, strict=True))
    mass = sum(unit.cylinder.moving_mass for unit in units)
    pair = poles[np.abs(poles.imag) > 1.0]
    assert pair.size == 2
    assert np.abs(pair[0]) == pytest.approx(np.sqrt(spring / mass), rel=1e-4)
    # Damping of each spring's leakage, weighted: a six-hundredth of the pole, and by differences.
    assert -2.0 * pair[0].real == pytest.approx(damping / spring, rel=5e-3)


def test_external_accumulators_lower_the_resonance():
    """Through wide valves a chamber's compliance is oil and gas together; through shut ones oil's alone."""
    unit = Unit.load("axis_a")
    scenario = Scenario(duration=0.01, circuit={"accumulators": {"gas_charge": 4e5}})
    ready = prepare(unit, scenario)
    pressure = unit.accumulator.charge_pressure + ABOVE
    hydraulic = [s.V, own(s.P1), own(s.P2), own(s.EXTERNAL_1), own(s.EXTERNAL_2)]
    charged, absolute = 4e5 + ready.parameters[0].ambient, pressure + ready.parameters[0].ambient

    def resonance(valve_flow: float) -> float:
        rest = AtRest(ready, 0.0, ABOVE, external_flow=valve_flow)
        for external in (s.EXTERNAL_1, s.EXTERNAL_2):
            rest.y[own(external)] = 13e-6 * (1.0 - charged / absolute)
        poles = np.linalg.eigvals(rest.jacobian(hydraulic))
        return float(np.abs(poles if valve_flow < 1e-6 else poles[np.abs(poles.imag) > 1.0]).max())

    oil = unit.cylinder.volume_1 / float(bulk_modulus(unit.oil, pressure))
    gas = 13e-6 * charged / absolute**2  # isothermal, dV/dp
    per_compliance = 2.0 * unit.cylinder.area_1**2 / unit.cylinder.moving_mass
    shut, opened = (np.sqrt(per_compliance / compliance) for compliance in (oil, oil + gas))
    assert resonance(1e-9) == pytest.approx(shut, rel=1e-3)
    assert resonance(1.0) == pytest.approx(opened, rel=1e-2)
    assert opened < 0.75 * shut


def _unloaded() -> Unit:
    unit = Unit.load("axis_a")
    pump = unit.pump.model_copy(update={"displacement": 1e-12})
    drive = unit.drive.model_copy(update={"current_limit": 1e4, "voltage_limit": 1e6})
    return unit.model_copy(update={"pump": pump, "drive": drive})


def _drive_poles(unit: Unit) -> tuple[float, float, float]:
    """Eq. 6.11's two, and the third that a current loop of 0.4 ms adds: their sum is 1/τ."""
    a, b = unit.drive.pole_1, unit.drive.pole_2
    return a, b, 1.0 / 4e-4 - a - b


def test_the_drives_step_follows_its_command_by_its_delay():
    """Step response without hydraulic load: three poles, one zero, unit gain, a millisecond late."""
    unit = _unloaded()
    duty = {"name": "prbs", "bit": 1.0, "speed": 100.0, "lead_in": 0.1}
    details = {"pump_coulomb_torque": 0.0, "command_dead_band": 0.0, "cogging_torque": 0.0}
    run = {"duration": 0.3, "control": Control(mode="speed"), "recording": {"dropped": 0.0}}
    truth = simulate(unit, Scenario(**run, duty=duty, details=details)).truth
    speed, since = truth["pump_speed"], truth.time - 0.1 - unit.drive.delay
    poles, zero = np.array(_drive_poles(unit)), unit.drive.zero
    step = np.ones_like(since)
    for p in poles:
        others = poles[poles != p]
        share = poles.prod() * (zero - p) / (zero * p * (others - p).prod())
        step -= share * np.exp(-p * since)
    expected = np.where(since > 0.0, 100.0 * step, 0.0)
    np.testing.assert_allclose(np.sign(speed[-1]) * speed, expected, atol=1e-3)
    # Section 6.3: 33.3 Hz at -3 dB, the current loop's lag with it.
    jw = 2j * np.pi * 33.3
    response = np.abs(poles.prod() * (jw / zero + 1.0) / np.prod(jw + poles))
    assert 20.0 * np.log10(response) == pytest.approx(-3.01, abs=0.15)


def test_a_dead_band_and_its_edges():
    """Table 6.1: a command within the dead band turns nothing, one beyond it turns by what is beyond."""
    unit = _unloaded()
    rest = AtRest(prepare(unit, Scenario(duration=0.01)), 0.0, 0.0)
    for command, expected in ((0.03, 0.0), (-0.03, 0.0), (1.0346, 1.0), (-1.0346, -1.0)):
        entry = rest.rates(rest.y, command)[own(s.DRIVE)]
        assert entry == pytest.approx(np.prod(_drive_poles(unit)) * 4e-4 * expected, rel=1e-9, abs=1e-6)
