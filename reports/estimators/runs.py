"""What is run: a case in either world, a sudden change of one parameter, and both filters' speed.

In the plant world the estimators get axis A's profile, and the unit that is simulated differs from it as the
filter's initial spread says: leakage, free air (and with it the bulk modulus), pump gain, the friction
curve's height and viscous friction are drawn around the profile's; what no profile knows (bristles, ripple,
line losses, …) is drawn from its usual range. Geometry and sensors are as the profile says.
"""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from estimators.eha import layout
from estimators.eha import model as eha
from fdd.campaign.dataset import for_each_unit
from fdd.plant.details import Details
from fdd.plant.oil import air_compliance, viscosity_ratio
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import simulate
from fdd.plant.state import Truth
from fdd.residuals.tracking import Tracking, channels_of, estimates, observability
from fdd.unit import Unit
from reports.estimators import cases, matched
from reports.estimators.cases import QUANTITIES, Array, Assumed, Case, Rows, Trajectory
from reports.writing import timed

WORLDS = ("matched", "plant")
CHECKS = 5
"""Times over the last window at which errors are counted."""

CHANGE = {"leakage": 1.5, "bulk_modulus": 0.7, "coulomb_friction": 1.5}
"""Factor of each sudden change."""
STEP_CASE = Case("sines", "spring")
ONSET, AFTER, BEFORE = 10.0, 6.0, 0.5
"""s of the change, s that are watched from then on, and s over which the estimate before is averaged."""
GRID = np.arange(0.0, AFTER, 0.05)
"""s after the change at which the response is kept."""

PEER = "filterpy EKF"
BY_NAME = {case.name: case for case in cases.CASES}


class Data(NamedTuple):
    """One run before any filter has seen it: profile, both filters, what they assume, their input (n, 9)."""

    case: Case
    unit: Unit
    tracking: Tracking
    prior: Assumed
    block: Array
    truth: Trajectory


def prepare(
    world: str, case: Case, seed: tuple[int, ...], duration: float = cases.DURATION, change: str = ""
) -> Data:
    """Make one run's data, with a sudden change of a quantity of `CHANGE` where one is named."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    unit = Unit.load("axis_a")
    if world == "matched":
        unit = matched.matched_unit(unit)
    tracking = Tracking(unit, case.channels, 1e-3)
    prior = cases.assumed(tracking.trackers["ekf"])
    if world == "matched":
        jump = _jump(change, unit, tracking.model) if change else None
        truth, block = matched.draw(case, duration, tracking.model, prior, rng, jump)
        return Data(case, unit, tracking, prior, block, truth)
    rig, details, gain = draw_rig(unit, prior, rng)
    scenario = Scenario(
        unit=rig.name, duration=duration, duty=cases.MOTIONS[case.duty], load=cases.LOADS[case.load],
        details=details, seed=int(rng.integers(2**62)), recording=Recording.perfect(),
        **(_fault(change, rig) if change else {}),
    )  # fmt: skip
    out = simulate(rig, scenario)
    truth = plant_states(out.truth, unit, tracking.model, gain)
    return Data(case, unit, tracking, prior, tracking.block(out.samples), truth)


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
    modulus = 1.0 / (1.0 / oil.bulk_modulus + added)
    rig.oil = oil.model_copy(update={"air_fraction": air, "bulk_modulus": modulus})
    for branch in (rig.friction.forward, rig.friction.reverse):
        branch.coulomb, branch.static = branch.coulomb * rub, branch.static * rub
        branch.viscous = max(branch.viscous + prior.spread[eha.VISC] * z[4], 0.0)
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
    """The change in the plant, as a fault of a scenario with its scales."""
    fault, factor = {"severity": 1.0, "onset": ONSET}, CHANGE[quantity]
    if quantity == "leakage":
        more = rig.pump.total_leakage * (factor - 1.0)
        scales = {"internal_leakage": more, "internal_leakage_orifice_share": 0.0}
        return {"faults": [{"fault": "internal_leakage", **fault}], "fault_scales": scales}
    if quantity == "bulk_modulus":
        per_air = float(air_compliance(rig.oil.reference_pressure, rig.oil.polytropic_index))
        scales = {"free_air": (1.0 / factor - 1.0) / rig.oil.bulk_modulus / per_air}
        return {"faults": [{"fault": "aeration", **fault}], "fault_scales": scales}
    worn = {"fault": "seal_wear", "variant": "tight", **fault}
    return {"faults": [worn], "fault_scales": {"tight_friction": factor}}


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


def evaluate(data: Data) -> dict[str, pd.DataFrame]:
    """Run both filters and the bound over one run's data.

    Gives `errors`, for each method, quantity and check: truth, bound and claimed standard deviation, error,
    flag (called observable), SI; `consistency`, for each method: nees at the end, and errors in sigmas.
    """
    truth, decimation, tracked = data.truth, data.tracking.trackers["ekf"].decimation, list(cases.TRACKED)
    n = truth.states.shape[0]
    window = min(round(cases.WINDOW * 1e3), n // 2)
    ends = np.linspace(n - window, n, CHECKS).round().astype(np.int64) // decimation * decimation
    rows, model = ends - 1, data.tracking.model
    variances = matched.eha_bound(truth, model, data.prior, data.case.minimum, rows)
    true, bound = cases.quantities(truth.states[rows], variances, truth.viscosity[rows], data.unit, model)
    at, errors, consistency = ends // decimation - 1, [], []
    for method, records in data.tracking.push(data.block).items():
        values, sigmas = estimates(records, data.unit, data.tracking.model)
        shown = observability(values, sigmas)
        found, std, flag = (np.ravel([x[q][at] for q in QUANTITIES]) for x in (values, sigmas, shown))
        frame = pd.DataFrame({"truth": true.ravel(), "bound": bound.ravel(), "std": std, "flag": flag})
        frame = frame.assign(error=found - frame["truth"], method=method)
        errors.append(frame.assign(quantity=np.repeat(QUANTITIES, CHECKS)))
        tracker = data.tracking.trackers[method]
        error = tracker.x[tracked] - truth.states[-1, tracked]
        if data.case.minimum:  # without the oil's temperature leakage is that of the oil as it is
            error[0] = tracker.x[eha.LEAK] - truth.states[-1, eha.LEAK] / truth.viscosity[-1]
        # The tracker's correlations, and standard deviations widened as its records are.
        covariance = tracker.P[np.ix_(tracked, tracked)]
        own, scores = np.sqrt(np.diag(covariance)), error / np.sqrt(records[-1]["variance"][tracked])
        try:
            factor = np.linalg.cholesky(covariance / np.outer(own, own))
            nees = float(np.sum(np.linalg.solve(factor, scores) ** 2))
        except np.linalg.LinAlgError:
            nees = float("nan")
        consistency.append({"method": method, "nees": nees, **dict(zip(QUANTITIES, scores, strict=True))})
    return {"errors": pd.concat(errors), "consistency": pd.DataFrame(consistency)}


def step_run(data: Data, quantity: str) -> pd.DataFrame:
    """Of one run with a change at `ONSET`, for each method: half (s until half of the true change is followed
    from what was estimated before, infinite where it never was) and response, (len(GRID),) share followed."""
    at = round(ONSET * 1e3) + np.array([-1, 2])
    truth, none = data.truth, np.zeros((2, eha.STATES))
    true, _ = cases.quantities(truth.states[at], none, truth.viscosity[at], data.unit, data.tracking.model)
    before, after = true[QUANTITIES.index(quantity)]
    rows = []
    for method, records in data.tracking.push(data.block).items():
        value = estimates(records, data.unit, data.tracking.model)[0][quantity]
        time_s = records["time"] - ONSET
        share = (value - value[(time_s >= -BEFORE) & (time_s < 0.0)].mean()) / (after - before)
        since = time_s >= 0.0
        reached = time_s[since][share[since] >= 0.5]
        response = np.interp(GRID, time_s[since], share[since])
        half = reached[0] if reached.size else np.inf
        rows.append({"method": method, "half": half, "response": response})
    return pd.DataFrame(rows)


class Plan(NamedTuple):
    """How much is measured: runs of each case and change, s of a run, which ones."""

    runs: int = 100
    duration: float = cases.DURATION
    cases: tuple[str, ...] = tuple(BY_NAME)
    stepped: tuple[str, ...] = tuple(CHANGE)
    seed: int = 0


Measured = dict[str, pd.DataFrame]
"""Frames by kind (errors, consistency, steps), each with the columns world, case (or the quantity that was
changed) and run; and speed, see `measure_speed`. What was left out has none."""


def measure(plan: Plan, workers: int = 1, progress: Callable[[float], None] = lambda share: None) -> Measured:
    """Measure everything but speed; the number of processes changes no figure."""
    jobs = [
        (kind, world, name, run)
        for kind, names in (("run", plan.cases), ("step", plan.stepped))
        for world, name, run in product(WORLDS, names, range(plan.runs))
    ]
    told = for_each_unit(partial(_work, plan), jobs, workers=workers, progress=lambda n, of: progress(n / of))
    kinds = dict.fromkeys(kind for kind, _ in told)
    return {k: pd.concat([f for kind, f in told if kind == k], ignore_index=True) for k in kinds}


def _work(plan: Plan, job: tuple[str, str, str, int]) -> list[tuple[str, pd.DataFrame]]:
    """One run; its seed is made of what it is, so that a report can be made again."""
    kind, world, name, run = job
    seed = (plan.seed, zlib.crc32(f"{kind}|{world}|{name}".encode()), run)
    with threadpool_limits(1), warnings.catch_warnings():
        # A filter that loses its covariance overflows; it is counted, and need not be told here too.
        warnings.simplefilter("ignore", RuntimeWarning)
        if kind == "step":
            frames = {"steps": step_run(prepare(world, STEP_CASE, seed, ONSET + AFTER, name), name)}
        else:
            frames = evaluate(prepare(world, BY_NAME[name], seed, plan.duration))
    return [(k, frame.assign(world=world, case=name, run=run)) for k, frame in frames.items()]


def filterpy_ekf(q: eha.Parameters, prior: Assumed, block: Array, rows: Rows) -> tuple[Array, Array]:
    """Run filterpy's EKF over a block as the tracker takes it, all sensors, without gaps.

    It has the same model, noise and first estimate. What a textbook filter cannot say is left out: it
    linearises at its own estimate, learns friction sample by sample, is not robust and knows no bounds.

    Gives `states`, `variances`: (k, STATES) at `rows` (k,), ascending.
    """
    from filterpy.kalman import ExtendedKalmanFilter

    F, G, new = np.empty((eha.STATES, eha.STATES)), np.empty((eha.STATES, 4)), np.empty(eha.STATES)
    measured, sizes = [eha.X, eha.TH, eha.P1, eha.P2], prior.sizes
    columns = [layout.POSITION, layout.ANGLE, layout.PRESSURE_1, layout.PRESSURE_2]
    z = block[:, columns] * [1e3, 1.0, 1e-6, 1e-6]
    viscosity = np.nan_to_num(block[:, layout.VISCOSITY], nan=1.0)
    accumulator, H = block[:, layout.ACCUMULATOR] * 1e-6, np.eye(eha.STATES)[measured]
    peer = ExtendedKalmanFilter(eha.STATES, 4)
    peer.x, peer.P, peer.F = prior.start.copy(), np.diag(prior.spread**2), F
    peer.x[measured] = z[0]
    peer.R = np.diag(np.array([sizes.position, sizes.angle, sizes.pressure, sizes.pressure]) ** 2)
    peer.predict_x = lambda u=0: setattr(peer, "x", new.copy())
    found = np.empty((2, rows.size, eha.STATES))
    for k in range(rows[-1] + 1):
        if k > 0:
            low, x = accumulator[k - 1], peer.x
            eha.step(x, 1.0, viscosity[k - 1], low, np.nan, np.nan, q, new, F, G)
            flows = cases.chamber_noise(x[eha.P1], x[eha.P2], low, True, sizes)
            noise = np.array([sizes.force, sizes.acceleration, *flows]) ** 2
            peer.Q = (G * noise) @ G.T + np.diag(prior.walk**2 * 1e-3)
            peer.predict()
        peer.update(z[k], lambda x: H, lambda x: x[measured])
        found[:, rows == k] = np.stack([peer.x, np.diag(peer.P)])[:, None]
    return found[0], found[1]


def measure_speed(duration: float = 60.0, repeats: int = 9, peer_samples: int = 3000) -> pd.DataFrame:
    """µs of processor time a sample (median, best) of both filters and of filterpy's EKF, by name.

    On one simulated log of `duration` s with a spring load, one core, in turns: whatever else runs hits all.
    """
    unit, recording = Unit.load("axis_a"), Recording(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0)
    scenario = Scenario(duration=duration, seed=1, load={"name": "spring"}, recording=recording)
    samples = simulate(unit, scenario).samples
    tracking = Tracking(unit, channels_of(samples), 1e-3)
    block, prior = tracking.block(samples), cases.assumed(tracking.trackers["ekf"])
    took = dict[str, list[float]]()
    part, last = block[:peer_samples], np.array([peer_samples - 1])
    for turn in range(repeats):
        for method, tracker in tracking.trackers.items():
            fresh = tracker.state()
            tracker.push(block[:1000])  # compiling is not its work
            tracker.restore(fresh)
            spent = timed(lambda: tracker.push(block))  # noqa: B023
            took.setdefault(method.upper(), []).append(spent / len(block))
            tracker.restore(fresh)
        if turn % 3 == 0:
            spent = timed(lambda: filterpy_ekf(tracking.model, prior, part, last))
            took.setdefault(PEER, []).append(spent / peer_samples)
    rows = {name: {"median": 1e6 * np.median(s), "best": 1e6 * min(s)} for name, s in took.items()}
    return pd.DataFrame.from_dict(rows, orient="index").assign(samples=len(block))
