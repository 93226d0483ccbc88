"""One run of one case: data, both filters, the bound, least squares, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.eha import layout
from estimators.eha import model as eha
from evidence.estimators import bound, consistency, drawing, matched
from evidence.estimators.cases import DURATION, WINDOW, Case
from evidence.estimators.least_squares import Window, fit_balance
from evidence.estimators.model import N_RELIEF, Assumed, assumed, encoders_share, tested_channels
from evidence.estimators.trajectory import QUANTITIES, TRACKED, Trajectory, quantities
from fdd.plant.simulate import simulate
from fdd.residuals.tracking import METHODS, Channels, Tracking, estimates, observability
from fdd.unit import Unit

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

WORLDS = ("matched", "plant")
CHECKS = 5
"""Times over the last window at which errors are counted."""
NIS_FROM = 1.0 / 3.0
"""Share of the run after which the NIS is counted."""


@dataclass(frozen=True)
class Data:
    """One run before any filter has seen it.

    Attributes
    ----------
    unit : the profile that the filters have.
    tracking : both filters, untouched.
    prior : what they assume.
    block : (n, 9) their input.
    truth : what really was.
    """

    unit: Unit
    tracking: Tracking
    prior: Assumed
    block: Array
    truth: Trajectory


@dataclass(frozen=True)
class Outcome:
    """What came of a run. Methods are `METHODS`, quantities `QUANTITIES`, checks `CHECKS` times; SI.

    Attributes
    ----------
    truth : (quantities, checks).
    errors, stds, flags : (methods, quantities, checks) estimate less truth, what the filter claims, whether
        it calls
        the quantity observable.
    bound : (quantities, checks) standard deviation.
    fitted : (2, checks) error of least squares, leakage and bulk modulus.
    nees : (methods,) of the four parameters at the end. scores : (methods, quantities) their errors in
        sigmas.
    nis : (methods, 4) mean over its expectation, band, effective samples; NaN where no channel can be tested.
    """

    truth: Array
    errors: Array
    stds: Array
    flags: Flags
    bound: Array
    fitted: Array
    nees: Array
    scores: Array
    nis: Array


def prepare(world: str, case: Case, seed: tuple[int, ...], duration: float = DURATION,
            jump: matched.Jump | None = None, faults: list[dict[str, object]] | None = None,
            scales: dict[str, float] | None = None) -> Data:  # fmt: skip
    """Make one run's data.

    Parameters
    ----------
    world : of `WORLDS`. case : what is run. seed : fixes everything random.
    duration : s.
    jump : in the matched world; faults, scales : in the plant.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    unit = Unit.load("axis_a")
    if world == "matched":
        unit = matched.matched_unit(unit)
    tracking = Tracking(unit, Channels(case.channels), 1e-3)
    prior = assumed(tracking.trackers["ekf"])
    if world == "matched":
        truth, block = matched.draw(case, duration, tracking.model, prior, rng, jump)
        return Data(unit, tracking, prior, block, truth)
    rig = drawing.draw_rig(unit, prior, rng)
    scenario = drawing.scenario_of(case, rig, duration, int(rng.integers(2**62)), faults, scales)
    out = simulate(rig.unit, scenario)
    truth = drawing.plant_trajectory(out, unit, tracking.model, rig.gain)
    return Data(unit, tracking, prior, tracking.block(out.samples), truth)


def evaluate(case: Case, data: Data) -> Outcome:
    """Run both filters, the bound and least squares over one run's data."""
    n = len(data.truth)
    decimation = data.tracking.trackers["ekf"].decimation
    window = min(round(WINDOW * 1e3), n // 2)
    ends = np.linspace(n - window, n, CHECKS).round().astype(np.int64) // decimation * decimation
    rows = ends - 1
    model = data.tracking.model
    true, stds = true_and_bound(case, data, rows)
    errors, claimed = np.empty((2, len(METHODS), len(QUANTITIES), CHECKS))
    flags = np.empty((len(METHODS), len(QUANTITIES), CHECKS), dtype=np.bool_)
    nees, scores, nis = (
        np.empty(len(METHODS)),
        np.empty((len(METHODS), len(TRACKED))),
        np.empty((len(METHODS), 4)),
    )
    late = slice(int(NIS_FROM * n), None)
    driven = encoders_share(data.truth.states[late], data.prior.sizes)
    channels = tested_channels(
        data.truth.states[late], data.truth.accumulator[late], model, data.prior.sizes, pressures=not
        case.minimum, known=not case.minimum,
    )  # fmt: skip
    pushed = data.tracking.push(data.block)
    for m, method in enumerate(METHODS):
        records = pushed[method]
        with np.errstate(invalid="ignore"):  # a filter that lost its covariance counts as not observable
            values, sigmas = estimates(records, data.unit, model)
        shown = observability(values, sigmas)
        at = ends // decimation - 1
        for i, name in enumerate(QUANTITIES):
            errors[m, i] = values[name][at] - true[i]
            claimed[m, i], flags[m, i] = sigmas[name][at], shown[name][at]
        tracker = data.tracking.trackers[method]
        error = tracker.x[list(TRACKED)] - data.truth.states[-1, list(TRACKED)]
        if case.minimum:  # without the oil's temperature leakage is that of the oil as it is
            error[0] = tracker.x[eha.LEAK] - data.truth.states[-1, eha.LEAK] / data.truth.viscosity[-1]
        covariance = _claimed(tracker.P, records[-1])
        nees[m] = consistency.nees(error, covariance)
        scores[m] = error / np.sqrt(np.diag(covariance))
        nis[m] = consistency.nis_of_run(
            records[int(NIS_FROM * records.shape[0]) :], decimation, channels, driven
        )
    return Outcome(true, errors, claimed, flags, stds, _fitted(case, data, ends, true), nees, scores, nis)


def _claimed(P: Array, record: np.void) -> Array:
    """The tracker's covariance of the tracked parameters, widened as its records are."""
    block = P[np.ix_(TRACKED, TRACKED)]
    reported = record["variance"][list(TRACKED)]
    factor = np.sqrt(reported / np.diag(block))
    return np.asarray(block * np.outer(factor, factor))


def true_and_bound(case: Case, data: Data, rows: NDArray[np.int64]) -> tuple[Array, Array]:
    """The true quantities at some rows and the bound of their standard deviations, (4, k) each, SI."""
    variances = bound.eha_bound(
        data.truth, data.tracking.model, data.prior, pressures=not case.minimum, accumulator=not case.minimum,
        rows=rows,
    )  # fmt: skip
    return quantities(
        data.truth.states[rows], variances, data.truth.viscosity[rows], data.unit, data.tracking.model
    )


def _fitted(case: Case, data: Data, ends: NDArray[np.int64], true: Array) -> Array:
    """Errors of the volume balance fitted over the window before each check."""
    window = min(round(WINDOW * 1e3), int(ends[0]))
    out = np.full((2, ends.size), np.nan)
    block, model = data.block, data.tracking.model
    sealed = bool(model.case_leakage == 0.0)
    for i, end in enumerate(ends):
        part = block[end - window : end]
        signals = _window(part, case.minimum, float(model.accumulator_pressure))
        leak, air = fit_balance(
            signals, model, relief=float(data.prior.sizes[N_RELIEF]), sealed=sealed and not case.minimum
        )
        states = np.full((1, eha.STATES), np.nan)
        states[0, eha.LEAK], states[0, eha.AIR] = leak, air
        viscosity = data.truth.viscosity[end - 1 : end] if not case.minimum else np.ones(1)
        values, _ = quantities(states, np.zeros_like(states), viscosity, data.unit, model)
        out[:, i] = values[:2, 0] - true[:2, i]
    return out


def _window(part: Array, minimum: bool, charge: float) -> Window:
    position = part[:, layout.POSITION] * 1e3
    if minimum:
        angle = np.cumsum(part[:, layout.SPEED]) * 1e-3
        return Window.of_difference(position, angle, part[:, layout.DIFFERENCE] * 1e-6, charge)
    return Window(
        position, part[:, layout.ANGLE], part[:, layout.PRESSURE_1] * 1e-6, part[:, layout.PRESSURE_2] * 1e-6,
        part[:, layout.ACCUMULATOR] * 1e-6,
    )  # fmt: skip
