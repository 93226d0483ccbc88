"""The experiments on units and curves whose answer is known."""

import numpy as np
import pytest

from fdd.identification.experiments.friction import fit_curve
from fdd.identification.friction import curve
from fdd.unit import Unit
from reports.thesis import control, flow
from reports.thesis.friction import MODES, creeping_peaks, run_up, start_of
from reports.thesis.response import HIGH, HIGH_SPEED, LOW, LOW_SPEED, split_poles
from reports.thesis.runs import VOLT, TransferFunction, holding_leakage, run_position, with_leakage

pytestmark = pytest.mark.slow
MOTOR = 0.0011
"""V: the motor's dead band, Table 6.1."""


@pytest.fixture
def unit() -> Unit:
    return Unit.load("axis_a")


def flat(unit: Unit, force: float) -> Unit:
    """The unit with one friction at all speeds and in all trials."""
    changed = unit.model_copy(deep=True)
    changed.friction.trial_spread = 0.0
    for branch in (changed.friction.forward, changed.friction.reverse):
        branch.coulomb = branch.static = force
        branch.viscous = 0.0
    return changed


@pytest.mark.parametrize("mode", MODES, ids=lambda m: m.name)
def test_the_thesis_curve_is_fitted_back(mode):
    """Table 5.2 from points on its own curve, with noise of 1 N: the curve returns, where it was measured."""
    speed = np.linspace(0.011, 0.22, 200)
    friction = curve(mode.branch, speed) + np.random.default_rng(3).standard_normal(200)
    found = fit_curve(speed, friction, *start_of(mode, friction))
    assert np.max(np.abs(curve(found, speed) - curve(mode.branch, speed))) < 1.5
    assert found.stribeck_exponent == pytest.approx(mode.branch.stribeck_exponent, abs=0.1)


def test_the_thesis_poles_are_those_of_its_equations():
    for region, model in ((LOW_SPEED, LOW), (HIGH_SPEED, HIGH)):
        pair, single = split_poles(model)
        assert pair.real == pytest.approx(region.pair.real, abs=0.3)
        assert pair.imag == pytest.approx(region.pair.imag, abs=0.3)
        assert single == pytest.approx(region.single, abs=0.5)
        # Its printed bandwidth is against unit gain where its own gain differs.
        assert model.bandwidth_hz() == pytest.approx(region.bandwidth, abs=0.5)


def test_leakage_from_port_to_port_is_the_slope(unit, monkeypatch):
    """Without a case drain eq. 5.3 shows L_T, but for the pump's own compression, D·ω/(2β)."""
    monkeypatch.setattr(flow, "_THROTTLES", (0.5e6, 1.6e6, 5e6))
    sealed, partner = flow.with_case_share(unit, 0.0), Unit.load("axis_b")
    compression = unit.pump.displacement * 104.7 / (2.0 * unit.oil.bulk_modulus)
    assert flow.strokes(sealed, partner, 1).slope == pytest.approx(
        unit.pump.total_leakage + compression, rel=0.02
    )
    # With one, all of the case leakage shows, as the low side is refed.
    pump = unit.pump
    shown = pump.cross_port_leakage + pump.case_leakage + compression
    assert flow.strokes(unit, partner, 1).slope == pytest.approx(shown, rel=0.02)


def test_flat_friction_is_measured_flat(unit):
    units = {"A": flat(unit, 250.0), "B": Unit.load("axis_b")}
    assert creeping_peaks(MODES[0], units, 2, trials=2) == pytest.approx(250.0, abs=8.0)
    speed, friction = run_up(MODES[1], units, 5)
    assert speed[-1] > 0.2
    assert np.median(friction) == pytest.approx(250.0, abs=4.0)


def test_the_dead_band_is_leakage_under_friction(unit):
    """(ξ + C_ep)·F/(A·Dp), the low side refed, and the motor's own: half the friction halves it."""
    for force in (200.0, 400.0):
        flattened = flat(unit, force)
        holding = unit.pump.cross_port_leakage + unit.pump.case_leakage
        expected = holding * force / (unit.cylinder.area_1 * unit.pump.displacement * VOLT) + MOTOR
        levels = expected * np.array([0.5, 1.8, 2.2, 2.6, 3.5])
        found = control.slides_from(flattened, levels, 1.0, 1)
        assert found == pytest.approx(expected, rel=0.03)


def offset_of_equations(unit: Unit, axis: str, leakage: float) -> float:
    """Mean offset (V) of the velocity by eqs 5.3 and 5.12, `leakage` in m³/(s·Pa) of section 5.2."""
    area, displacement = unit.cylinder.area_1, unit.pump.displacement
    velocity = np.empty_like(flow.SPEEDS)
    for mode in (m for m in MODES if m.axis == axis):
        way = mode.sign * flow.SPEEDS > 0.0
        pumped = np.abs(flow.SPEEDS[way]) * displacement / area
        found = pumped
        for _ in range(60):
            leak = leakage * curve(mode.branch, np.maximum(found, 1e-6)) / area
            found = 0.5 * (found + pumped - leak / area)
        velocity[way] = mode.sign * found
    return float(np.mean(control.offsets(flow.SPEEDS, velocity)))


def test_the_thesis_s_own_equations_have_its_dead_band(unit):
    """Table 6.1's 0.06 V out of eqs 5.3 and 5.12 and Table 5.2, without the plant; by hand at one speed."""
    assert offset_of_equations(unit, "A", 6.52e-12) == pytest.approx(0.06, abs=0.005)
    assert offset_of_equations(Unit.load("axis_b"), "B", 4.27e-12) == pytest.approx(0.033, abs=0.003)
    command = np.array([-2.0, -1.0, 1.0, 2.0]) * VOLT
    shifted = np.sign(command) * (np.abs(command) - 0.1 * VOLT)
    np.testing.assert_allclose(control.offsets(command, shifted), 0.1)


def test_linear_ultimate_gain_is_routh_hurwitz_s():
    """K/(s(s + 1)²) is on the verge at K = 2."""
    triple = TransferFunction((1.0,), (1.0, 2.0, 1.0), 0.0)
    assert control.linear_ultimate_gain(triple) == pytest.approx(2.0, rel=1e-3)
    assert control.linear_ultimate_gain(LOW) == pytest.approx(2.2e5, rel=0.02)
    assert control.linear_ultimate_gain(HIGH) == pytest.approx(2.6e5, rel=0.02)


def test_the_final_error_is_what_holds_the_friction(unit):
    """Kp·e = (ξ + C_ep)·F/(A·Dp) + the drive's dead band, F the friction that still holds at the end."""
    changed = with_leakage(unit, unit, 0.5)
    setpoint = np.concatenate([np.zeros(100), np.full(6000, 0.1)])
    out = run_position(changed, setpoint, control.GAIN, seed=3)
    holding = holding_leakage(changed)
    area, displacement = changed.cylinder.area_1, changed.pump.displacement
    speed = holding * out.truth["friction_force"][-1] / (area * displacement) + VOLT * MOTOR
    error = 0.1 - float(np.mean(out.truth["position"][-50:]))
    assert control.GAIN * error == pytest.approx(speed, rel=0.05)
