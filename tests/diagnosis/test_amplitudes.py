"""A fault of the plant is as large in the balances as it was put in: each law against the plant's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from simulated_logs import DURATION_S, LOADS

from fdd.diagnosis.baseline import effects_of, history_of
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.hypotheses import hypotheses
from fdd.plant.details import Details
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.residuals.bins import FRAME_S
from fdd.unit import Unit

SEVERITY = 0.6
BEGINS_S = 16.0
CASES = {
    "internal leakage": ("internal_leakage", "push", {}),
    "outside 1": ("external_leakage", "gust", {"side": 1}),
    "outside 2": ("external_leakage", "gust", {"side": 2}),
    "pump wear": ("pump_wear", "pull", {}),
    "case": ("case_drain_seal_failure", "pull", {}),
    "loose": ("seal_wear", "push", {"variant": "loose"}),
    "loose leaking": ("seal_wear", "push", {"variant": "loose"}),
    "tight": ("seal_wear", "spring", {"variant": "tight"}),
    "air": ("aeration", "gust", {}),
    "air 1": ("aeration", "gust", {"law": "chamber_1"}),
    "air 2": ("aeration", "gust", {"law": "chamber_2"}),
    "valve 1": ("check_valve_stuck_open", "push", {"side": 1}),
    "valve 2": ("check_valve_stuck_open", "pull", {"side": 2}),
    "relief": ("relief_valve_stuck_open", "spring", {}),
    "thick": ("oil_degradation", "spring", {"variant": "thick"}),
    "motor": ("motor_degradation", "spring", {}),
    "bias dp": ("pressure_sensor_bias", "push", {}),
}


LEAKS = Details(loose_seal_leakage=1e-12)
"""A loose piston seal's; the other cases have none."""


@pytest.fixture(scope="module")
def evidence_of(unit: Unit) -> Callable[..., Evidence]:
    """Evidence of a log under a load; the healthy one of each load is made once."""
    effects = effects_of(unit)

    @cache
    def made(load: str, details: Details, *fault: tuple[str, object]) -> Evidence:
        scenario = Scenario(
            duration=DURATION_S, load=LOADS[load], seed=77, faults=[dict(fault)] if fault else [],
            details=details,
        )  # fmt: skip
        samples = simulate(Unit.load("axis_a"), scenario).samples
        return Evidence(history_of(samples, unit, effects).marginalised(), effects)

    return made


@pytest.mark.parametrize("label", CASES)
def test_an_amplitude_is_the_plants_severity(
    unit: Unit, evidence_of: Callable[..., Evidence], label: str
) -> None:
    """By the fault's own columns alone, from its onset on; healthy logs make it none."""
    fault, load, which = CASES[label]
    (h,) = (h for h in hypotheses(unit, effects_of(unit)) if (h.fault, h.label) == (fault, label))
    given = {"fault": fault, "severity": SEVERITY, "onset": BEGINS_S, **which}
    sizes = []
    details = LEAKS if label == "loose leaking" else Details()
    for evidence in (evidence_of(load, details), evidence_of(load, details, *given.items())):
        (found,) = evidence.fitted([(h, "step", round(BEGINS_S / FRAME_S), np.zeros(1))], [])
        sizes.append(found.size)
    assert sizes == pytest.approx([0.0, SEVERITY], abs=0.12)
