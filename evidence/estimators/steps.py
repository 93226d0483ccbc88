"""How soon a sudden change of one parameter is followed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimators.eha import model as eha
from evidence.estimators import drawing, matched
from evidence.estimators.cases import Case
from evidence.estimators.model import assumed
from evidence.estimators.run import Data, prepare
from evidence.estimators.trajectory import QUANTITIES, quantities
from fdd.plant.oil import air_compliance
from fdd.plant.simulate import simulate
from fdd.residuals.tracking import METHODS, Channels, Tracking, estimates
from fdd.unit import Unit

Array = NDArray[np.float64]

STEPPED = ("leakage", "bulk_modulus", "coulomb_friction")
CHANGE = {"leakage": 1.5, "bulk_modulus": 0.7, "coulomb_friction": 1.5}
"""Factor of each."""
STEP_CASE = Case("sines", "spring")
ONSET, AFTER = 10.0, 6.0
"""s of the change, and s that are watched from then on."""
BEFORE = 0.5
"""s over which the estimate before the change is averaged."""
GRID = np.arange(0.0, AFTER, 0.05)
"""s after the change at which the response is kept."""


@dataclass(frozen=True)
class StepOutcome:
    """Response of one run.

    Attributes
    ----------
    half : (methods,) s until half of the change is followed; infinite where it never was.
    response : (methods, len(GRID)) share of the change that is followed.
    """

    half: Array
    response: Array


def step_run(world: str, quantity: str, seed: tuple[int, ...], case: Case = STEP_CASE) -> StepOutcome:
    """One run with a change of `quantity` by `CHANGE` at `ONSET`, all sensors, in motion.

    The change is that of the truth. Before it counts what the filter estimates there, right or wrong.
    """
    duration = ONSET + AFTER
    data = (
        _matched(case, quantity, seed, duration)
        if world == "matched"
        else _plant(case, quantity, seed, duration)
    )
    q = QUANTITIES.index(quantity)
    states = data.truth.states
    row = round(ONSET * 1e3)
    around = np.array([row - 1, row + 2])
    true, _ = quantities(
        states[around], np.zeros((2, states.shape[1])), data.truth.viscosity[around], data.unit,
        data.tracking.model,
    )  # fmt: skip
    change = true[q, 1] - true[q, 0]
    half, response = np.empty(len(METHODS)), np.empty((len(METHODS), GRID.size))
    for m, (_method, records) in enumerate(data.tracking.push(data.block).items()):
        with np.errstate(invalid="ignore"):
            value = estimates(records, data.unit, data.tracking.model)[0][quantity]
        time = records["time"] - ONSET
        start = value[(time >= -BEFORE) & (time < 0.0)].mean()
        share = (value - start) / change
        after = time >= 0.0
        half[m] = time_to_half(time[after], share[after])
        response[m] = np.interp(GRID, time[after], share[after])
    return StepOutcome(half, response)


def time_to_half(time: Array, share: Array) -> float:
    """First time at which half is reached; infinite if never.

    Examples
    --------
    >>> time_to_half(np.arange(3.0), np.array([0.0, 0.6, 0.9])), time_to_half(np.zeros(1), np.zeros(1))
    (1.0, inf)
    """
    reached = np.flatnonzero(share >= 0.5)
    return float(time[reached[0]]) if reached.size else float("inf")


def _matched(case: Case, quantity: str, seed: tuple[int, ...], duration: float) -> Data:
    model = Tracking(Unit.load("axis_a"), Channels(case.channels), 1e-3).model
    pressure = Unit.load("axis_a").oil.reference_pressure * 1e-6
    if quantity == "bulk_modulus":
        per_air = 1e-3 * eha.air_curve(pressure, model.polytropic_index)
        nominal = 1e6 / Unit.load("axis_a").oil.bulk_modulus
        jump = matched.Jump(eha.AIR, ONSET, shift=nominal * (1.0 / CHANGE[quantity] - 1.0) / per_air)
    else:
        state = eha.LEAK if quantity == "leakage" else eha.FRIC
        jump = matched.Jump(state, ONSET, factor=CHANGE[quantity])
    return prepare("matched", case, seed, duration, jump)


def _plant(case: Case, quantity: str, seed: tuple[int, ...], duration: float) -> Data:
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    unit = Unit.load("axis_a")
    tracking = Tracking(unit, Channels(case.channels), 1e-3)
    prior = assumed(tracking.trackers["ekf"])
    rig = drawing.draw_rig(unit, prior, rng)
    fault: dict[str, Any] = {"severity": 1.0, "onset": ONSET}
    if quantity == "leakage":
        more = rig.unit.pump.total_leakage * (CHANGE[quantity] - 1.0)
        fault["fault"], scales = (
            "internal_leakage",
            {"internal_leakage": more, "internal_leakage_orifice_share": 0.0},
        )
    elif quantity == "bulk_modulus":
        oil = rig.unit.oil
        per_air = float(air_compliance(oil.reference_pressure, oil.polytropic_index))
        fault["fault"], scales = (
            "aeration",
            {"free_air": (1.0 / CHANGE[quantity] - 1.0) / oil.bulk_modulus / per_air},
        )
    else:
        fault |= {"fault": "seal_wear", "variant": "tight"}
        scales = {"tight_friction": CHANGE[quantity]}
    scenario = drawing.scenario_of(case, rig, duration, int(rng.integers(2**62)), [fault], scales)
    out = simulate(rig.unit, scenario)
    truth = drawing.plant_trajectory(out, unit, tracking.model, rig.gain)
    return Data(unit, tracking, prior, tracking.block(out.samples), truth)
