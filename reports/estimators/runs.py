"""What is run: a case in either world, filterpy beside it, and a sudden change of one parameter.

In the plant world the estimators get axis A's profile, and the unit that is simulated differs from it as the
filter's initial spread says: leakage, free air (and with it the bulk modulus), pump gain, the friction
curve's height and viscous friction are drawn around the profile's; what no profile knows (bristles, ripple,
line losses, …) is drawn from its usual range. Geometry and sensors are as the profile says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from estimators.consistency import nis_band, squared_distance
from estimators.eha import layout
from estimators.eha import model as eha
from fdd.plant.details import Details
from fdd.plant.oil import air_compliance, viscosity_ratio
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.plant.truth import Truth
from fdd.residuals.tracking import Channels, Tracking, estimates, observability
from fdd.unit import Unit
from reports.estimators import matched
from reports.estimators.bound import eha_bound
from reports.estimators.cases import (
    DURATION,
    LOADS,
    MOTIONS,
    QUANTITIES,
    TRACKED,
    WINDOW,
    Case,
    Trajectory,
    quantities,
)
from reports.estimators.least_squares import Window, fit_balance
from reports.estimators.model import Assumed, assumed, encoders_share, tested_channels
from reports.estimators.peers import PEERS, run_peer

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

WORLDS = ("matched", "plant")
CHECKS = 5
"""Times over the last window at which errors are counted."""
NIS_FROM = 1.0 / 3.0
"""Share of the run after which the NIS is counted."""
LEAST_TESTED, LONGEST_LAG = 0.05, 200
"""Channels, mean over a run, below which its NIS says nothing; records up to which it is correlated."""

CHANGE = {"leakage": 1.5, "bulk_modulus": 0.7, "coulomb_friction": 1.5}
"""Factor of each sudden change."""
STEP_CASE = Case("sines", "spring")
ONSET, AFTER, BEFORE = 10.0, 6.0, 0.5
"""s of the change, s that are watched from then on, and s over which the estimate before is averaged."""
GRID = np.arange(0.0, AFTER, 0.05)
"""s after the change at which the response is kept."""

PEER_DURATION = 8.0
"""s; filterpy is slow."""


@dataclass(frozen=True)
class Data:
    """One run before any filter has seen it.

    `unit`: the profile that the filters have. `tracking`: both filters, untouched. `prior`: what they assume.
    `block`: (n, 9) their input. `truth`: what really was.
    """

    unit: Unit
    tracking: Tracking
    prior: Assumed
    block: Array
    truth: Trajectory


def prepare(
    world: str, case: Case, seed: tuple[int, ...], duration: float = DURATION, change: str = ""
) -> Data:
    """Make one run's data, with a sudden change of a quantity of `CHANGE` where one is named."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    unit = Unit.load("axis_a")
    if world == "matched":
        unit = matched.matched_unit(unit)
    tracking = Tracking(unit, Channels(case.channels), 1e-3)
    prior = assumed(tracking.trackers["ekf"])
    if world == "matched":
        jump = _jump(change, unit, tracking.model) if change else None
        truth, block = matched.draw(case, duration, tracking.model, prior, rng, jump)
        return Data(unit, tracking, prior, block, truth)
    rig, details, gain = draw_rig(unit, prior, rng)
    scenario = Scenario(
        unit=rig.name, duration=duration, duty=MOTIONS[case.duty], load=LOADS[case.load], details=details,
        seed=int(rng.integers(2**62)), recording=Recording.perfect(),
        **(_fault(change, rig) if change else {}),
    )  # fmt: skip
    out = simulate(rig, scenario)
    truth = plant_states(out.truth, unit, tracking.model, gain)
    return Data(unit, tracking, prior, tracking.block(out.samples), truth)


def draw_rig(profile: Unit, prior: Assumed, rng: np.random.Generator) -> tuple[Unit, Details, float]:
    """A unit that the profile describes as well as the prior says, its details, and its pump's gain error."""
    z = np.clip(rng.standard_normal(5), -2.5, 2.5)
    leak = max(1.0 + prior.spread[eha.LEAK] * z[0], 0.2)
    gain = prior.spread[eha.GAIN] * z[2]
    rub = max(1.0 + prior.spread[eha.FRIC] * z[3], 0.2)
    rig = profile.model_copy(deep=True)
    rig.pump.cross_port_leakage *= leak
    rig.pump.case_leakage *= leak
    rig.pump.displacement *= 1.0 + gain
    oil = rig.oil
    air = max(oil.air_fraction + prior.spread[eha.AIR] * 1e-3 * z[1], 2e-4)
    added = (air - oil.air_fraction) * float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    rig.oil = oil.model_copy(
        update={"air_fraction": air, "bulk_modulus": 1.0 / (1.0 / oil.bulk_modulus + added)}
    )
    for name in ("forward", "reverse"):
        branch = getattr(rig.friction, name)
        drawn = {
            "coulomb": branch.coulomb * rub,
            "static": branch.static * rub,
            "viscous": max(branch.viscous + prior.spread[eha.VISC] * z[4], 0.0),
        }
        setattr(rig.friction, name, branch.model_copy(update=drawn))
    details: dict[str, Any] = {name: float(rng.uniform(*bounds)) for name, bounds in Details.usual.items()}
    details["pump_teeth"] = round(details["pump_teeth"])
    return rig, Details(**details), gain


def _jump(quantity: str, unit: Unit, model: eha.Parameters) -> matched.Jump:
    """The change in the matched world."""
    if quantity == "bulk_modulus":
        per_air = 1e-3 * eha.air_curve(unit.oil.reference_pressure * 1e-6, model.polytropic_index)
        shift = 1e6 / unit.oil.bulk_modulus * (1.0 / CHANGE[quantity] - 1.0) / per_air
        return matched.Jump(eha.AIR, ONSET, shift=shift)
    state = eha.LEAK if quantity == "leakage" else eha.FRIC
    return matched.Jump(state, ONSET, factor=CHANGE[quantity])


def _fault(quantity: str, rig: Unit) -> dict[str, Any]:
    """The change in the plant, as faults of a scenario with their scales."""
    fault: dict[str, Any] = {"severity": 1.0, "onset": ONSET}
    if quantity == "leakage":
        more = rig.pump.total_leakage * (CHANGE[quantity] - 1.0)
        fault["fault"] = "internal_leakage"
        scales = {"internal_leakage": more, "internal_leakage_orifice_share": 0.0}
    elif quantity == "bulk_modulus":
        per_air = float(air_compliance(rig.oil.reference_pressure, rig.oil.polytropic_index))
        fault["fault"] = "aeration"
        scales = {"free_air": (1.0 / CHANGE[quantity] - 1.0) / rig.oil.bulk_modulus / per_air}
    else:
        fault |= {"fault": "seal_wear", "variant": "tight"}
        scales = {"tight_friction": CHANGE[quantity]}
    return {"faults": [fault], "fault_scales": scales}


def plant_states(truth: Truth, profile: Unit, model: eha.Parameters, gain: float) -> Trajectory:
    """The plant's truth as the estimators' states, so far as they have one for it."""
    x = np.zeros((len(truth), eha.STATES))
    x[:, eha.X], x[:, eha.V] = truth["position"] * 1e3, truth["velocity"]
    x[:, eha.TH], x[:, eha.W] = truth["pump_angle"], truth["pump_speed"] * 1e-3
    x[:, eha.P1], x[:, eha.P2] = truth["pressure_1"] * 1e-6, truth["pressure_2"] * 1e-6
    viscosity = viscosity_ratio(profile.oil, truth["oil_temperature"])
    x[:, eha.LEAK] = truth["leakage"] / profile.pump.total_leakage * viscosity
    per_air = 1e-3 * eha.air_curve(profile.oil.reference_pressure * 1e-6, model.polytropic_index)
    x[:, eha.AIR] = (1e6 / truth["bulk_modulus"] - model.stiff_compliance) / per_air
    x[:, eha.GAIN] = gain
    healthy = 0.5 * (profile.friction.forward.coulomb + profile.friction.reverse.coulomb)
    x[:, eha.FRIC] = truth["coulomb_friction"] / healthy
    x[:, eha.VISC] = truth["viscous_friction"]
    x[:, eha.LOAD] = truth["load_force"]
    return Trajectory(x, truth["pressure_accumulator"] * 1e-6, viscosity)


def rows_of(method: str, **each: Array) -> pd.DataFrame:
    """A row for each quantity and check; arrays (quantities, checks), SI."""
    frame = pd.DataFrame({name: np.ravel(values) for name, values in each.items()})
    checks = len(frame) // len(QUANTITIES)
    return frame.assign(method=method, quantity=np.repeat(QUANTITIES, checks))


def evaluate(case: Case, data: Data) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Run both filters, the bound and least squares over one run's data.

    Gives `errors`: a row for each method, quantity and check: truth, bound (standard deviation), error
    (estimate less truth), std (claimed), flag (whether the filter calls it observable), fitted (error of
    least squares, NaN for friction); SI. `consistency`: a row for each method: nees of the four parameters at
    the end, their errors in sigmas, nis (mean over its expectation) and its band; NaN where no channel can be
    tested.
    """
    truth, model, decimation = data.truth, data.tracking.model, data.tracking.trackers["ekf"].decimation
    n = truth.states.shape[0]
    window = min(round(WINDOW * 1e3), n // 2)
    ends = np.linspace(n - window, n, CHECKS).round().astype(np.int64) // decimation * decimation
    true, bound = true_and_bound(case, data, ends - 1)
    fitted = np.vstack([_fitted(case, data, ends, true), np.full((2, CHECKS), np.nan)])
    late = slice(int(NIS_FROM * n), None)
    driven = encoders_share(truth.states[late], data.prior.sizes)
    channels = tested_channels(
        truth.states[late], truth.accumulator[late], model, data.prior.sizes, minimum=case.minimum
    )
    errors, consistency = [], []
    for method, records in data.tracking.push(data.block).items():
        with np.errstate(invalid="ignore"):  # a filter that lost its covariance counts as not observable
            values, sigmas = estimates(records, data.unit, model)
        shown = observability(values, sigmas)
        at = ends // decimation - 1
        found, std, flag = (np.array([x[q][at] for q in QUANTITIES]) for x in (values, sigmas, shown))
        errors.append(
            rows_of(method, truth=true, bound=bound, error=found - true, std=std, flag=flag, fitted=fitted)
        )
        tracker = data.tracking.trackers[method]
        error = tracker.x[list(TRACKED)] - truth.states[-1, list(TRACKED)]
        if case.minimum:  # without the oil's temperature leakage is that of the oil as it is
            error[0] = tracker.x[eha.LEAK] - truth.states[-1, eha.LEAK] / truth.viscosity[-1]
        # The tracker's covariance, widened as its records are.
        covariance = tracker.P[np.ix_(TRACKED, TRACKED)]
        wider = np.sqrt(records[-1]["variance"][list(TRACKED)] / np.diag(covariance))
        covariance = covariance * np.outer(wider, wider)
        nis = nis_of_run(records["nis"][int(NIS_FROM * records.size) :], decimation, channels, driven)
        scores = error / np.sqrt(np.diag(covariance))
        consistency.append({
            "method": method, "nees": _nees(error, covariance), **dict(zip(QUANTITIES, scores, strict=True)),
            **dict(zip(("nis", "nis_low", "nis_high"), nis, strict=True)),
        })  # fmt: skip
    return pd.concat(errors), pd.DataFrame(consistency)


def _nees(error: Array, covariance: Array) -> float:
    try:
        return float(squared_distance(error, covariance))
    except ValueError:
        return float("nan")


def true_and_bound(case: Case, data: Data, rows: Rows) -> tuple[Array, Array]:
    """The true quantities at some rows and the bound of their standard deviations, (4, k) each, SI."""
    truth, model = data.truth, data.tracking.model
    variances = eha_bound(truth, model, data.prior, minimum=case.minimum, rows=rows)
    return quantities(truth.states[rows], variances, truth.viscosity[rows], data.unit, model)


def _fitted(case: Case, data: Data, ends: Rows, true: Array) -> Array:
    """Errors of the volume balance fitted over the window before each check, (2, checks)."""
    window = min(round(WINDOW * 1e3), int(ends[0]))
    model, out = data.tracking.model, np.full((2, ends.size), np.nan)
    relief, sealed = float(data.prior.sizes.relief), bool(model.case_leakage == 0.0) and not case.minimum
    for i, end in enumerate(ends):
        part = data.block[end - window : end]
        position = part[:, layout.POSITION] * 1e3
        if case.minimum:
            angle, difference = np.cumsum(part[:, layout.SPEED]) * 1e-3, part[:, layout.DIFFERENCE] * 1e-6
            signals = Window.of_difference(position, angle, difference, float(model.accumulator_pressure))
        else:
            p1, p2, p_acc = 1e-6 * part[:, [layout.PRESSURE_1, layout.PRESSURE_2, layout.ACCUMULATOR]].T
            signals = Window(position, part[:, layout.ANGLE], p1, p2, p_acc)
        states = np.full((1, eha.STATES), np.nan)
        states[0, [eha.LEAK, eha.AIR]] = fit_balance(signals, model, relief=relief, sealed=sealed)
        viscosity = data.truth.viscosity[end - 1 : end] if not case.minimum else np.ones(1)
        values, _ = quantities(states, np.zeros_like(states), viscosity, data.unit, model)
        out[:, i] = values[:2, 0] - true[:2, i]
    return out


def correlation_time(series: Array) -> float:
    """Integrated autocorrelation time of a series in samples: ``1 + 2 Σ ρ_k``, at least 1.

    A mean over n samples is worth n over this many independent ones. The sum ends where the lag is five times
    what it has come to (Sokal 1997, doi 10.1007/978-1-4899-0319-8_6), since beyond it only noise is added.
    """
    if not np.isfinite(series).all():
        return 1.0
    y = series - series.mean()
    power, time = float(y @ y), 1.0
    for lag in range(1, min(LONGEST_LAG, y.size - 1)):
        if not power > 0.0 or lag > 5.0 * time:
            break
        time += 2.0 * float(y[:-lag] @ y[lag:]) / power
    return max(1.0, time)


def nis_of_run(series: Array, decimation: int, channels: float, driven: float = 0.0) -> tuple[float, ...]:
    """Mean NIS of a run over its expectation, with the band that 95 % of consistent runs fall in.

    `series`: (n,) of the records, each a mean over `decimation` samples. `channels`: degrees of freedom of a
    sample, `tested_channels`; driven : what the others add.
    """
    if channels < LEAST_TESTED:
        return float("nan"), float("nan"), float("nan")
    effective = series.size * decimation / correlation_time(series)
    low, high = nis_band(1, max(int(effective * channels), 1))
    return (float(series.mean()) - driven) / channels, low, high


def step_run(world: str, quantity: str, seed: tuple[int, ...]) -> pd.DataFrame:
    """One run with a change of `quantity` by `CHANGE` at `ONSET`, all sensors, in motion.

    The change is that of the truth. Before it counts what the filter estimates there, right or wrong.

    Gives a row for each method: half (s until half of the change is followed, infinite where it never was)
    and response, (len(GRID),) share of the change that is followed.
    """
    data = prepare(world, STEP_CASE, seed, ONSET + AFTER, quantity)
    model, row = data.tracking.model, round(ONSET * 1e3)
    states, viscosity = (x[[row - 1, row + 2]] for x in (data.truth.states, data.truth.viscosity))
    values, _ = quantities(states, np.zeros_like(states), viscosity, data.unit, model)
    before, after = values[QUANTITIES.index(quantity)]
    rows = []
    for method, records in data.tracking.push(data.block).items():
        with np.errstate(invalid="ignore"):
            value = estimates(records, data.unit, model)[0][quantity]
        time = records["time"] - ONSET
        share = (value - value[(time >= -BEFORE) & (time < 0.0)].mean()) / (after - before)
        since = time >= 0.0
        reached = time[since][share[since] >= 0.5]
        half = reached[0] if reached.size else np.inf
        response = np.interp(GRID, time[since], share[since])
        rows.append({"method": method, "half": half, "response": response})
    return pd.DataFrame(rows)


def peer_run(world: str, case: Case, seed: tuple[int, ...], duration: float = PEER_DURATION) -> pd.DataFrame:
    """Errors of filterpy's filters and of the estimators on one short run, NaN where one was lost."""
    data = prepare(world, case, seed, duration)
    decimation, n = data.tracking.trackers["ekf"].decimation, round(duration * 1e3)
    ends = np.linspace(n // 2, n, CHECKS).round().astype(np.int64) // decimation * decimation
    model, viscosity = data.tracking.model, data.truth.viscosity[ends - 1]
    truth, bound = true_and_bound(case, data, ends - 1)
    found = {}
    for name in PEERS:
        states, variances = run_peer(name, model, data.prior, data.block, case.minimum, ends - 1)
        seen = np.ones(ends.size) if case.minimum else viscosity
        found[name] = quantities(states, variances, seen, data.unit, model)[0]
    for method, records in data.tracking.push(data.block).items():
        values, _ = estimates(records, data.unit, model)
        found[method] = np.array([values[q][ends // decimation - 1] for q in QUANTITIES])
    return pd.concat(rows_of(name, truth=truth, bound=bound, error=x - truth) for name, x in found.items())
