"""Nothing is made or lost: oil to a millionth, energy to a millionth of what went through."""

from typing import Any

import numpy as np
import pytest

from fdd.plant import state as s
from fdd.plant.faults.injection import PLANT_FAULTS
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.unit import Unit
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
