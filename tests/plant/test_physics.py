"""The plant against what it obeys: conservation, Newton, a reference solver, the thesis's linear model."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fdd.plant import conditions as c
from fdd.plant import equations as e
from fdd.plant.details import Details
from fdd.plant.duty import ConstantSpeed, Prbs, Sines, Standstill, Steps, Strokes
from fdd.plant.load import ConstantLoad, GustLoad, SpringLoad, ThrottleLoad
from fdd.plant.scenario import Control, Recording, Scenario
from fdd.plant.simulate import prepare, simulate
from fdd.unit import Unit

WHOLE = Recording.perfect()
SPEED = Control(mode="speed")


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit.load("axis_a")


@pytest.mark.parametrize("load", [SpringLoad(), ThrottleLoad(pressure=2e6), GustLoad()])
def test_no_oil_is_made_or_lost(unit, load):
    """A closed cycle without external leakage keeps the oil to a millionth, whatever flows where."""
    faults = [
        {"fault": "check_valve_stuck_open", "severity": 0.3, "onset": 1.0, "side": 2},
        {"fault": "internal_leakage", "severity": 1.0, "onset": 3.0},
    ]
    scenario = Scenario(duration=12.0, duty=Strokes(rate=0.05), load=load, faults=faults, recording=WHOLE)
    truth = simulate(unit, scenario).truth
    assert np.ptp(truth["position"]) > 0.05 and np.abs(truth["drain_flow"]).max() > 1e-9
    assert np.abs(truth["oil_mass"] / truth["oil_mass"][0] - 1.0).max() < 1e-6


def test_oil_is_kept_with_an_inlet_filled_pump_and_unlike_areas(unit):
    cylinder = unit.cylinder.model_copy(update={"area_2": 1.3e-3})
    unlike = unit.model_copy(update={"cylinder": cylinder})
    scenario = Scenario(
        duration=8.0, duty=Steps(amplitude=0.03), details=Details(pump_compression=1.0), recording=WHOLE
    )
    truth = simulate(unlike, scenario).truth
    assert np.abs(truth["oil_mass"] / truth["oil_mass"][0] - 1.0).max() < 1e-6


@pytest.mark.parametrize("load", [ConstantLoad(level=1500.0), ThrottleLoad(), SpringLoad()])
def test_forces_balance(unit, load):
    """M dv/dt = A1 p1 - A2 p2 - friction - load, by the velocity's gain over each millisecond."""
    truth = simulate(unit, Scenario(duration=5.0, duty=Sines(), load=load, recording=WHOLE)).truth
    net = (
        unit.cylinder.area_1 * truth["pressure_1"]
        - unit.cylinder.area_2 * truth["pressure_2"]
        - truth["friction_force"]
        - truth["load_force"]
        - truth["stop_force"]
    )
    # Simpson over two milliseconds: the mass's own motion is resolved, so little is left.
    simpson = (net[:-2:2] + 4.0 * net[1:-1:2] + net[2::2]) / 6.0
    gained = unit.cylinder.moving_mass * np.diff(truth["velocity"][::2])[: simpson.size] / 2e-3
    assert np.std(gained) > 0.5
    assert np.sqrt(np.mean((gained - simpson) ** 2)) < 1e-3 * np.std(truth["friction_force"])


@pytest.mark.parametrize(
    ("load", "faults"),
    [
        (SpringLoad(), []),
        (ThrottleLoad(), [{"fault": "check_valve_stuck_open", "severity": 0.7}]),
        (ConstantLoad(), [{"fault": "aeration", "severity": 1.0}, {"fault": "seal_wear", "severity": 1.0}]),
    ],
)
def test_a_reference_solver_agrees_within_a_tenth_of_the_sensors(unit, load, faults):
    """Radau of SciPy on the same equations, restarted wherever the command changes."""
    # Below 100 rad/s of step the current stays within its limit, whose corners no solver likes.
    duty = Prbs(bit=0.25, speed=40.0, lead_in=0.05)
    scenario = Scenario(
        duration=1.2, duty=duty, load=load, control=SPEED, faults=faults, recording=WHOLE, seed=3
    )
    ready = prepare(unit, scenario)
    truth = simulate(unit, scenario).truth
    delayed = np.concatenate([[0.0], ready.conditions[:-1, c.SETPOINT]])
    changes = [0, *(np.flatnonzero(np.diff(delayed)) + 1), delayed.size]
    dy, found = np.empty(e.STATES), np.empty(e.FINDINGS)

    def rate(_time, y, command, now):
        e.right_hand_side(y, command, now, ready.parameters, dy, found)
        return dy.copy()

    nudge = np.array([1e-9, 1e-8, 1.0, 1.0, 1e-10, 1e-6, 1e-5, 1e-2, 1e-12, 1.0, 1e-8])

    def jacobian(time, y, command, now):
        ends = [rate(time, y + s * np.diag(nudge)[i], command, now) for i in range(e.STATES) for s in (1, -1)]
        return ((np.array(ends[::2]) - np.array(ends[1::2])) / (2.0 * nudge[:, None])).T

    y = ready.state.copy()
    reference = np.empty((delayed.size, e.STATES))
    scale = np.array([1e-9, 1e-7, 1e-1, 1e-1, 1e-10, 1e-7, 1e-6, 1e-3, 1e-13, 1e-1, 1e-7])
    for start, stop in pairwise(changes):
        times = np.arange(start, stop + 1) * 1e-3
        solved = solve_ivp(
            rate, (times[0], times[-1]), y, "Radau", times, rtol=1e-8, atol=scale,
            jac=jacobian, args=(delayed[start], ready.conditions[0]),
        )  # fmt: skip
        reference[start:stop] = solved.y.T[:-1]
        y = solved.y[:, -1]
    assert np.ptp(reference[:, e.X]) > 0.003
    difference = reference[:, e.P1] - reference[:, e.P2] - truth["pressure_difference"]
    for column, state, noise in (
        ("position", e.X, 1e-6 / np.sqrt(12.0)),
        ("pressure_1", e.P1, unit.sensors["pressure_1"].noise),
        ("pump_angle", e.ANGLE, unit.sensors["pump_angle"].resolution / np.sqrt(12.0)),
    ):
        assert np.sqrt(np.mean((truth[column] - reference[:, state]) ** 2)) < 0.1 * noise, column
    assert np.sqrt(np.mean(difference**2)) < 0.1 * unit.sensors["pressure_difference"].noise


def test_ten_times_shorter_steps_give_the_same_run(unit):
    scenario = Scenario(duration=4.0, duty=Sines(), control=SPEED, recording=WHOLE)
    coarse, fine = (simulate(unit, scenario, substeps=k).truth for k in (10, 100))
    assert np.sqrt(np.mean((coarse["position"] - fine["position"]) ** 2)) < 5e-8
    assert np.sqrt(np.mean((coarse["pressure_difference"] - fine["pressure_difference"]) ** 2)) < 20.0


@pytest.mark.parametrize("name", ["axis_a", "axis_b"])
@pytest.mark.parametrize("viscous", [0.0, 760.0])
def test_linearised_it_is_equation_5_22(name, viscous):
    """With viscous friction alone the Jacobian has eq. 5.22's poles and gain."""
    unit = Unit.load(name)
    ready = prepare(unit, Scenario(duration=0.01, details=Details(pump_ripple=0.0)))
    par = ready.parameters._replace(
        bristle_stiffness=0.0,
        bristle_damping=0.0,
        seal_damping=0.0,
        viscous_forward=viscous,
        viscous_reverse=viscous,
    )
    # Somewhat above the accumulator, so that case leakage drains and no check valve refeeds.
    pressure = unit.accumulator.charge_pressure + 60e3
    y = np.zeros(e.STATES)
    y[e.P1] = y[e.P2] = pressure
    dy, found = np.empty(e.STATES), np.empty(e.FINDINGS)
    hydraulic = [e.V, e.P1, e.P2]
    step = {e.V: 1e-6, e.P1: 1.0, e.P2: 1.0, e.SPEED: 1e-3}

    def slope(state):
        ends = []
        for sign in (1.0, -1.0):
            at = y.copy()
            at[state] += sign * step[state]
            e.right_hand_side(at, 0.0, ready.conditions[0], par, dy, found)
            ends.append(dy[hydraulic].copy())
        return (ends[0] - ends[1]) / (2.0 * step[state])

    jacobian = np.column_stack([slope(s) for s in hydraulic])
    area, mass, leakage = unit.cylinder.area_1, unit.cylinder.moving_mass, unit.pump.total_leakage
    e.right_hand_side(y, 0.0, ready.conditions[0], par, dy, found)
    beta, _ = e.oil_at(
        pressure, unit.oil.air_fraction, par.ambient, par.stiff_compliance, par.polytropic_inverse
    )
    stiffness = beta / (0.5 * unit.cylinder.volume_1)  # β/V_o
    expected = np.roots(
        [1.0, viscous / mass + leakage * stiffness, (area**2 + viscous * leakage) * stiffness / mass]
    )
    poles = np.linalg.eigvals(jacobian)
    pair = poles[np.argsort(np.abs(poles))[1:]]  # the third is the slow common pressure
    np.testing.assert_allclose(np.sort_complex(pair), np.sort_complex(expected), rtol=1e-4)
    gain = -np.linalg.solve(jacobian, slope(e.SPEED))[0]  # velocity over pump speed
    assert gain == pytest.approx(unit.pump.displacement * area / (area**2 + viscous * leakage), rel=1e-4)


def _throttled(unit: Unit, pressure: float) -> tuple[float, float, float, float]:
    # The long stroke back, to its end: the pressure needs seconds to settle.
    duty = ConstantSpeed(speeds=(105.0,), amplitude=0.12, dwell=0.0, lead_in=0.1)
    scenario = Scenario(
        duration=9.0,
        duty=duty,
        control=SPEED,
        load=ThrottleLoad(pressure=pressure),
        details=Details(pump_ripple=0.0),
        recording=WHOLE,
    )
    truth = simulate(unit, scenario).truth
    steady = slice(8200, 9000)
    lost = truth["pump_flow"] - unit.cylinder.area_1 * truth["velocity"]
    refed = 0.5 * (truth["refeed_flow_2"] - truth["refeed_flow_1"])
    mean = [float(np.mean(v[steady])) for v in (truth["pressure_difference"], lost, refed, truth["leakage"])]
    return mean[0], mean[1], mean[2], mean[3]


@pytest.mark.parametrize("name", ["axis_a", "axis_b"])
def test_throttled_strokes_show_the_leakage_coefficient(name):
    """Section 5.2's experiment: flow lost over pressure is L_T, the refeeding counted (eq. 3.50)."""
    unit = Unit.load(name)
    drop, lost, refed, leakage = np.array([_throttled(unit, p) for p in (0.5e6, 1e6, 2e6, 4e6)]).T
    assert 0.0 > drop[0] > -0.9e6 and drop[-1] < -2.2e6
    assert leakage[0] == pytest.approx(unit.pump.total_leakage, rel=1e-9)
    slope = np.polyfit(drop, lost - refed, 1)[0]
    assert slope == pytest.approx(unit.pump.total_leakage, rel=0.01)
    # Without counting it, refeeding shows the whole case leakage, not half, and the pump's compression.
    raw = np.polyfit(drop, lost, 1)[0]
    assert 1.05 * unit.pump.total_leakage < raw < 1.25 * unit.pump.total_leakage


def test_the_drive_is_equation_6_11(unit):
    """Step response without hydraulic load: two poles, one zero, unit gain, after the delay."""
    free = unit.model_copy(
        update={
            "pump": unit.pump.model_copy(update={"displacement": 1e-12}),
            "drive": unit.drive.model_copy(update={"current_limit": 1e4}),
        }
    )
    duty = Prbs(bit=1.0, speed=100.0, lead_in=0.1)
    details = Details(pump_coulomb_torque=0.0)
    scenario = Scenario(duration=0.3, duty=duty, control=SPEED, details=details, recording=WHOLE)
    speed = simulate(free, scenario).truth["pump_speed"]
    sign = np.sign(speed[-1])
    drive = unit.drive
    since = np.arange(300) * 1e-3 - 0.1 - drive.delay
    a, b, zero = drive.pole_1, drive.pole_2, drive.zero
    # Partial fractions of ab(s + zero)/(zero·s(s + a)(s + b)).
    step = 1.0 - (
        b * (zero - a) / (zero * (b - a)) * np.exp(-a * since)
        - a * (zero - b) / (zero * (b - a)) * np.exp(-b * since)
    )
    expected = np.where(since > 0.0, 100.0 * step, 0.0)
    np.testing.assert_allclose(sign * speed, expected, atol=1e-3)


def test_the_current_carries_pump_torque_and_friction(unit):
    """At steady speed: torque constant times current is D·Δp, viscous and dry friction."""
    duty = ConstantSpeed(speeds=(105.0,), amplitude=0.12, dwell=0.0, lead_in=0.1)
    details = Details(pump_ripple=0.0)
    scenario = Scenario(
        duration=2.6, duty=duty, control=SPEED, load=ThrottleLoad(), details=details, recording=WHOLE
    )
    truth = simulate(unit, scenario).truth
    at = -200
    torque = unit.pump.displacement * truth["pressure_difference"][at]
    torque += unit.drive.viscous_friction * 105.0 + details.pump_coulomb_torque
    assert unit.drive.torque_constant * truth["motor_current"][at] == pytest.approx(torque, rel=0.01)


def test_relief_valves_hold_the_pressure(unit):
    duty = ConstantSpeed(speeds=(150.0,), amplitude=0.12)
    load = ThrottleLoad(pressure=2e7)
    scenario = Scenario(duration=2.0, duty=duty, control=SPEED, load=load, recording=WHOLE)
    truth = simulate(unit, scenario).truth
    highest = truth["pressure_difference"].max()
    assert unit.accumulator.relief_pressure < highest < 1.15 * unit.accumulator.relief_pressure
    assert truth["relief_flow"].max() > 1e-5


def test_cavitation_keeps_the_absolute_pressure_positive(unit):
    """A discharged accumulator and hard strokes against a throttle: the air carries the low side."""
    duty = ConstantSpeed(speeds=(250.0,), amplitude=0.1, dwell=0.0)
    scenario = Scenario(
        duration=4.0, duty=duty, control=SPEED, load=ThrottleLoad(), charge_factor=0.2, recording=WHOLE
    )
    truth = simulate(unit, scenario).truth
    lowest = min(truth["pressure_1"].min(), truth["pressure_2"].min()) + scenario.ambient
    assert 0.0 < lowest < 1e5
    assert np.abs(truth["oil_mass"] / truth["oil_mass"][0] - 1.0).max() < 1e-6


def test_end_stops_hold_the_piston(unit):
    wide = unit.model_copy(update={"cylinder": unit.cylinder.model_copy(update={"stroke": 0.05})})
    duty = Standstill(offset=0.02)
    scenario = Scenario(
        duration=2.0, duty=duty, load=ConstantLoad(level=-4500.0), control=SPEED, recording=WHOLE
    )
    leaking = wide.model_copy(update={"pump": wide.pump.model_copy(update={"cross_port_leakage": 1e-10})})
    truth = simulate(leaking, scenario).truth
    assert 0.025 < truth["position"][-1] < 0.0256
    assert truth["stop_force"][-1] > 3000.0


def test_friction_follows_equation_5_12_when_sliding(unit):
    """Steady sliding at several speeds gives each direction's curve, times the run's spread."""
    scenario = Scenario(
        duration=20.0,
        duty=ConstantSpeed(speeds=(80.0, 160.0, 250.0), amplitude=0.11, dwell=0.3, turn=6.0),
        control=SPEED,
        recording=WHOLE,
        seed=4,
    )
    truth, par = simulate(unit, scenario).truth, prepare(unit, scenario).parameters
    v = truth["velocity"]
    steady = np.abs(v - np.roll(v, 100)) < 2e-4
    for sign, branch, ratio in (
        (1.0, unit.friction.forward, par.coulomb_forward / unit.friction.forward.coulomb),
        (-1.0, unit.friction.reverse, par.coulomb_reverse / unit.friction.reverse.coulomb),
    ):
        rows = steady & (sign * v > 0.02)
        assert rows.sum() > 1000
        curve = branch.coulomb + (branch.static - branch.coulomb) * np.exp(
            -((np.abs(v) / branch.stribeck_velocity) ** branch.stribeck_exponent)
        )
        expected = sign * (ratio * curve + branch.viscous * np.abs(v))
        assert np.median(np.abs(truth["friction_force"] - expected)[rows]) < 2.0
