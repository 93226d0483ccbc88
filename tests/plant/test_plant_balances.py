"""Nothing is made or lost, oil or energy; two axes on one rod: symmetry, flows, one as load of the other."""

from typing import Any

import numpy as np
import pytest

from fdd import Scenario, Unit
from fdd.plant import state as s
from fdd.plant.faults import PLANT_FAULTS
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import Simulation, simulate
from reports.plant.energies import Energies, FineRun, energies, fine_run

A, B = Unit.load("axis_a"), Unit.load("axis_b")
WHOLE = Recording.perfect()
THROTTLE = {"name": "throttle", "pressure": 2e6}
BOTH, AJAR = {"line_1": 1.0, "line_2": 1.0}, {"line_1": 0.2, "line_2": 0.1}
DETAILS: dict[str, dict[str, Any]] = {
    "plain LuGre": {"friction_law": "lugre"},
    "Dahl, pressed seals": {"friction_law": "dahl", "seal_pressure": 0.005},
    "smooth": {"friction_law": "smooth"},
    "slow refeeding valves": {"check_lag": 0.01},
    "piloted refeeding valves": {"check_lag": 0.005, "pilot_ratio": 3.0},
    "air that stays free": {"air_law": "free"},
    "air that goes and comes quickly": {"dissolving_time": 0.1, "releasing_time": 0.02},
    "gas that hardly gives its heat": {"gas_time": 100.0},
}
"""Of seals, valves, air and gas as other machines have them."""
LAWS = {name: {"load": THROTTLE, "details": details} for name, details in DETAILS.items()}


def _driven(duration: float, bit: float = 0.2, **changes: Any) -> Scenario:
    """Speeds to and fro, hard enough that every valve has its turn."""
    duty = {"name": "prbs", "bit": bit, "speed": 120.0, "lead_in": 0.05}
    defaults = {"duty": duty, "control": {"mode": "speed"}, "recording": WHOLE, "seed": 5}
    return Scenario(duration=duration, **{**defaults, **changes})


def _fault(name: str, **more: Any) -> list[dict[str, Any]]:
    return [{"fault": name, "severity": 1.0, "onset": 0.0, **more}]


SINGLE: dict[str, dict[str, Any]] = {
    "free": {},
    "spring": {"load": {"name": "spring"}},
    "gust": {"load": {"name": "gust"}},
    "throttle to the relief valves": {"load": {"name": "throttle", "pressure": 2e7}},
    "inlet-filled pump": {"load": THROTTLE, "details": {"pump_compression": 1.0}},
    "little charge": {"load": THROTTLE, "charge_factor": 0.2},
    "by-pass": {"circuit": {"bypass": 0.3}},
    "moving throttle": {"circuit": {"throttle": "0:0/0.3:0.3"}},
    "external leakage": {"circuit": {"external_leakage": 0.5}, "load": {"name": "constant", "level": 1500.0}},
    "charging": {"circuit": {"charging": 0.5}},
    "charging while leaking": {"circuit": {"charging": 0.5, "external_leakage": 1.0}},
    "external accumulators": {"circuit": {"accumulators": {"gas_charge": 4e5}}, "load": {"name": "spring"}},
    "motor without power": {"power": 0.0, "load": {"name": "constant", "level": 1500.0}},
}
# Of oil with faults the checks of each fault tell.
ENERGY = [*SINGLE, *(pytest.param(name, marks=pytest.mark.slow) for name in PLANT_FAULTS)]
FAULTY = {name: {"faults": _fault(name), "load": THROTTLE} for name in PLANT_FAULTS}
FAULTY["drive_failure"]["faults"][0]["severity"] = 0.9  # a dead one moves nothing
DUAL: dict[str, dict[str, Any]] = {
    "same command": {"partner": {}},
    "still, by-pass open": {"partner": {"drive": "still", "circuit": {"bypass": 1.0}}},
    "still, by-pass shut": {"partner": {"drive": "still"}},
    "no power, by-pass open": {"partner": {"power": 0.0, "circuit": {"bypass": 1.0}}},
    "blocked, throttled": {"partner": {"drive": "still", "circuit": {"blocked": True, "throttle": 0.3}}},
    "blocked, connected": {"partner": {"circuit": {"blocked": True, "throttle": 1.0}}, "connect": BOTH},
    "connected, one leaking": {"partner": {"circuit": {"external_leakage": 1.0}}, "connect": AJAR},
}


def _everything(changes: dict[str, Any], duration: float) -> tuple[FineRun, Energies]:
    scenario = _driven(duration, **changes)
    run = fine_run(A, scenario, partner=B if scenario.partner else None)
    return run, energies(run)


@pytest.mark.parametrize("case", [*ENERGY, *DUAL, *LAWS])
def test_energy_is_kept(case):
    """Stored energy gained = shaft and load work - what every element takes, by its own law."""
    run, found = _everything({**SINGLE, **FAULTY, **DUAL, **LAWS}[case], 0.5)
    gap, through = found.gap(run)
    assert through > 5.0
    # A smooth law turns steeply through rest, where the quadrature of the work is coarse.
    assert gap < (1e-5 if case == "smooth" else 1e-6) * through
    # No element gives more than it takes, but for what the lines' losses are charged to another one.
    largest = max(float(np.abs(power).max()) for power in found.supplied.values())
    for name, power in found.lost.items():
        assert power.min() > -3e-4 * largest, name


@pytest.mark.parametrize(
    "case", ["throttle to the relief valves", "motor without power", "pump_wear", "coupling_wear"]
)
def test_the_pump_gives_the_oil_what_its_shaft_takes(case):
    """D·Δp·ω against ṁ(h1 - h2), both ways round: without line losses nothing is left, ripple or not."""
    # The same air on both sides: what dissolves on the one that is pressed makes their densities unlike.
    details = {"line_loss": 0.0, "pump_ripple": 0.02, "coupling_damping": 0.25, "air_law": "free"}
    changes = {**SINGLE, **FAULTY}[case] | {"details": details}
    run, found = _everything(changes, 0.6)
    left = found.lost["axis 1 pump, its lines and coupling"]
    power = np.abs(run.at(s.SPEED) * A.pump.displacement * (run.at(s.P1) - run.at(s.P2)))
    assert power.max() > 10.0
    if case == "coupling_wear":  # its flanks' damping is in it: never negative
        assert left.min() > -5e-4 * power.max() and left.max() > 1e-3 * power.max()
    else:
        # A straight line for the density between the ports is what is left: (Δp/β)²/12, and the air's curve.
        assert np.abs(left).max() < 5e-4 * power.max()


def test_the_fine_run_is_the_simulated_one():
    """What is balanced here is the plant as it is: the same positions and pressures each millisecond."""
    # Much heat capacity, for the fine run does not thin its oil.
    scenario = _driven(0.5, load=THROTTLE, details={"heat_capacity": 1e7})
    run, truth = fine_run(A, scenario, refine=4.0), simulate(A, scenario, refine=4.0).truth
    np.testing.assert_allclose(run.states[:, 0, s.X], truth["position"], atol=2e-9)
    np.testing.assert_allclose(run.at(s.P1)[:, 0], truth["pressure_1"], atol=5.0)


def _drift(mass: np.ndarray) -> float:
    return float(np.abs(mass / mass[0] - 1.0).max())


@pytest.mark.parametrize("case", [*SINGLE, *DUAL])
def test_oil_is_kept(case):
    """Chambers, lines, accumulators and what was lost, less what was charged: constant to 1e-6."""
    changes = {**SINGLE, **DUAL}[case]
    out = simulate(A, _driven(8.0, 0.4, **changes), partner=B if "partner" in changes else None)
    mass = out.truth["oil_mass"].copy()
    if out.partner is not None:
        mass += out.partner.truth["oil_mass"]
    assert np.ptp(out.truth["pressure_1"]) > 1e5
    assert _drift(mass) < 1e-6


def test_oil_is_kept_with_unlike_areas_and_faults_that_come_and_go():
    unlike = A.model_copy(update={"cylinder": A.cylinder.model_copy(update={"area_2": 1.3e-3})})
    faults = [
        *_fault("check_valve_stuck_open", severity=0.5, onset=1.0, profile="intermittent", side=2),
        *_fault("relief_valve_stuck_open", severity=0.3, onset=2.0, profile="ramp"),
        *_fault("shaft_seal_wear", onset=0.5),
    ]
    truth = simulate(unlike, _driven(8.0, 0.3, load={"name": "spring"}, faults=faults)).truth
    assert truth["oil_lost"][-1] > 1e-8
    assert _drift(truth["oil_mass"]) < 1e-6


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
    # All that the second pump moves goes over the connect valves, both ways.
    given = _steady(both, "connect_flow_1")
    assert given == pytest.approx(_steady(both.partner, "pump_flow"), rel=0.03)
    assert _steady(both, "connect_flow_2") == pytest.approx(-given, rel=0.03)


@pytest.mark.parametrize("opening", [0.2, 0.4])
def test_a_blocked_axis_throttled_loads_the_other(opening):
    """Section 4.6.7: its drop is the throttle's law at the flow of the moving cylinder."""
    out = _dual({"drive": "still", "circuit": {"blocked": True, "throttle": opening}})
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
