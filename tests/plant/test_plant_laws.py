"""Laws of other machines: what each does that the usual one does not, against its own definition."""

from typing import Any

import numpy as np
import pytest

from fdd.plant import conditions as c
from fdd.plant import state as s
from fdd.plant.details import Details
from fdd.plant.friction import friction_rates
from fdd.plant.load import ConstantLoad, NoLoad
from fdd.plant.parameters import as_record, plant_parameters
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.plant.truth import Truth
from fdd.unit import Unit

UNIT = Unit.load("axis_a")


def _truth(details: dict[str, Any], unit: Unit = UNIT, **scenario: Any) -> Truth:
    return simulate(unit, Scenario(recording=Recording.perfect(), details=details, **scenario)).truth


def _steady_friction(law: str, v: float, pressure: float = 0.0, **details: float) -> float:
    """Friction once the bristle has settled at that speed."""
    par = as_record(plant_parameters(UNIT, Details(friction_law=law, **details), NoLoad()))
    y, dy, now = np.zeros(s.AXIS_STATES), np.zeros(s.AXIS_STATES), np.ones(c.COLUMNS)
    y[s.P1] = y[s.P2] = pressure
    y[s.MEMORY] = v if law == "elastoplastic" else 0.0
    for _ in range(40_000):
        force = friction_rates(y, v, now, par, dy)
        y[s.Z] += 2e-5 * dy[s.Z]
    return float(force)


@pytest.mark.parametrize("law", ["elastoplastic", "lugre", "smooth"])
@pytest.mark.parametrize("v", [0.02, 0.08, -0.02, -0.08])
def test_stribeck_laws_end_on_the_units_curve(law, v):
    """Eq. 5.12 is the steady friction of each of them."""
    branch = UNIT.friction.forward if v > 0.0 else UNIT.friction.reverse
    falling = np.exp(-((abs(v) / branch.stribeck_velocity) ** branch.stribeck_exponent))
    curve = branch.coulomb + (branch.static - branch.coulomb) * falling + branch.viscous * abs(v)
    assert _steady_friction(law, v) == pytest.approx(np.sign(v) * curve, rel=0.01)


@pytest.mark.slow
def test_dahls_friction_does_not_fall_with_speed_and_a_smooth_one_holds_nothing():
    forward = UNIT.friction.forward
    slow, fast = (_steady_friction("dahl", v) for v in (0.005, 0.08))
    assert slow == pytest.approx(fast, rel=0.01) == pytest.approx(forward.coulomb, rel=0.01)
    assert abs(_steady_friction("smooth", 1e-6)) < 1e-3 * forward.static
    assert _steady_friction("lugre", 1e-3) > 0.8 * forward.coulomb


def test_pressure_presses_the_seals_on_by_its_share_of_the_area():
    without, pressed = (_steady_friction("elastoplastic", 0.05, p, seal_pressure=0.005) for p in (0.0, 2e6))
    assert pressed - without == pytest.approx(0.005 * 2e6 * UNIT.cylinder.area_1, rel=1e-3)


def test_a_slow_refeeding_valve_lets_oil_back_until_it_has_closed():
    """At each reversal; a valve that follows at once never lets any back."""
    duty = {"name": "prbs", "bit": 0.2, "speed": 120.0, "lead_in": 0.1}
    run = {
        "duration": 4.0,
        "duty": duty,
        "control": {"mode": "speed"},
        "load": {"name": "throttle"},
        "seed": 3,
    }
    quick, slow = _truth({}, **run), _truth({"check_lag": 0.01}, **run)
    back = [max(-t["refeed_flow_1"].min(), -t["refeed_flow_2"].min()) for t in (quick, slow)]
    assert back[0] == 0.0
    assert back[1] > 1e-6


def test_unequal_areas_move_freely_with_piloted_valves_only():
    """Retracting, chamber 1 gives more than the pump takes; with plain valves it presses both up."""
    cylinder = UNIT.cylinder.model_copy(update={"area_2": 0.6 * UNIT.cylinder.area_1})
    store = UNIT.accumulator.model_copy(update={"gas_volume": 1e-3})
    unit = UNIT.model_copy(update={"cylinder": cylinder, "accumulator": store})
    duty = {"name": "strokes", "amplitude": 0.08, "rate": 0.03, "dwell": 0.3}
    run = {"duration": 20.0, "duty": duty, "load": ConstantLoad(level=600.0), "seed": 1}
    plain, piloted = _truth({}, unit, **run), _truth({"pilot_ratio": 3.0, "check_lag": 0.005}, unit, **run)
    assert np.ptp(piloted["position"]) > 0.15
    setting = unit.accumulator.relief_pressure
    assert piloted["pressure_1"].max() < 0.4 * setting
    assert min(plain["pressure_1"].max(), plain["pressure_2"].max()) > setting
    # What the accumulator gives and takes over a stroke is the difference of the areas.
    held = store.gas_volume
    start = UNIT.accumulator.charge_pressure + 101_325.0
    gas = held * start / (piloted["pressure_accumulator"] + 101_325.0)
    differs = (cylinder.area_1 - cylinder.area_2) * np.ptp(piloted["position"])
    assert np.ptp(gas) == pytest.approx(differs, rel=0.08)


def test_dissolving_air_stiffens_a_pressed_chamber_in_its_own_time_and_keeps_the_oil():
    law = {"air_law": "dissolving", "dissolving_pressure": 1e6, "dissolving_time": 1.0, "releasing_time": 0.1}
    oil = UNIT.oil.model_copy(update={"air_fraction": 0.008})
    unit = UNIT.model_copy(update={"oil": oil})
    run = {"duration": 12.0, "load": {"name": "gust", "deviation": 600.0}, "seed": 2}
    free, dissolving = _truth({}, unit, **run), _truth(law, unit, **run)
    for truth in (free, dissolving):
        assert np.ptp(truth["oil_mass"]) < 1e-9 * truth["oil_mass"][0]
    # At charge pressure, half the dissolving one, 55 % of the air stays free.
    assert np.median(dissolving["bulk_modulus"]) > 1.2 * np.median(free["bulk_modulus"])
