"""What many runs say together: errors beside the bound and least squares, coverage, and whether goals are
met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.consistency import nees_band
from evidence.estimators.measure import Measured
from evidence.estimators.run import Outcome
from evidence.estimators.trajectory import QUANTITIES, TRACKED
from fdd.residuals.tracking import METHODS

Array = NDArray[np.float64]

WITHIN_BOUND, COVERED, HALF_WITHIN, STILL_WITHIN = 1.5, 0.9, 2.0, 1.0
"""Goals: RMSE over the bound; share of runs inside the 95 % bands; s until half of a change is followed;
standard deviations that an estimate moves in an hour at standstill."""
LEAST_FLAGGED = 0.05
"""Share of flagged estimates below which a quantity counts as not observable in a case."""
ABSOLUTE = ("viscous_friction",)
"""Quantities whose errors are given as they are and not in percent of the truth: healthy values may be
nought."""


@dataclass(frozen=True)
class Accuracy:
    """One quantity by one method in one case. Errors in percent of the truth, viscous friction in N·s/m.

    Attributes
    ----------
    flagged : share of the checks at which the filter calls it observable. The other figures are over those
        checks,
        or over all where `counted` is False.
    rmse, bias, spread : of the errors; spread is their standard deviation.
    claimed, bound : rms of the standard deviation that the filter gives, and of the bound's.
    fitted : rmse of least squares at the same checks; NaN for friction.
    """

    flagged: float
    counted: bool
    rmse: float
    bias: float
    spread: float
    claimed: float
    bound: float
    fitted: float

    @property
    def over_bound(self) -> float:
        """RMSE over the bound."""
        return self.rmse / self.bound


@dataclass(frozen=True)
class Coverage:
    """Consistency of one method in one case.

    Attributes
    ----------
    nees : share of runs whose NEES of the four parameters at the end is inside its 95 % band.
    too_sure : share above it.
    scores : (quantities,) share of runs whose error at the end is within 1.96 standard deviations.
    nis : share of runs whose mean NIS is inside its band. mean_nis : over its expectation, over all runs. NaN
        where
        no channel can be tested.
    lost : share of runs that ended without a covariance.
    """

    nees: float
    too_sure: float
    scores: Array
    nis: float
    mean_nis: float
    lost: float


def accuracy(outcomes: Sequence[Outcome], method: int, quantity: int) -> Accuracy:
    """Errors of one method and quantity over the runs of a case."""
    scale = 1.0
    truth = np.array([o.truth[quantity] for o in outcomes])
    if QUANTITIES[quantity] not in ABSOLUTE:
        scale = 0.01 * np.abs(truth)
    errors = np.array([o.errors[method, quantity] for o in outcomes]) / scale
    stds = np.array([o.stds[method, quantity] for o in outcomes]) / scale
    bound = np.array([o.bound[quantity] for o in outcomes]) / scale
    flags = np.array([o.flags[method, quantity] for o in outcomes])
    fitted = (
        np.array([o.fitted[quantity] for o in outcomes]) / scale
        if quantity < 2
        else np.full(truth.shape, np.nan)
    )
    counted = bool(flags.mean() >= LEAST_FLAGGED)
    at = (flags if counted else np.ones_like(flags)) & np.isfinite(errors) & np.isfinite(stds)
    if not at.any():
        return Accuracy(float(flags.mean()), False, *[float("nan")] * 6)
    return Accuracy(
        float(flags.mean()), counted, _rms(errors[at]), float(errors[at].mean()), float(errors[at].std()),
        _rms(stds[at]), _rms(bound[at]), _rms(fitted[at & np.isfinite(fitted)]),
    )  # fmt: skip


def coverage(outcomes: Sequence[Outcome], method: int) -> Coverage:
    """Consistency of one method over the runs of a case."""
    nees = np.array([o.nees[method] for o in outcomes])
    scores = np.array([o.scores[method] for o in outcomes])
    nis = np.array([o.nis[method] for o in outcomes])
    low, high = nees_band(len(TRACKED))
    inside = (nis[:, 0] >= nis[:, 1]) & (nis[:, 0] <= nis[:, 2])
    tested = np.isfinite(nis[:, 1])
    whole = nis[np.isfinite(nis[:, 0]), 0]
    return Coverage(
        nees=float(((nees >= low) & (nees <= high)).mean()),
        too_sure=float((~(nees <= high)).mean()),
        scores=np.asarray((np.abs(scores) <= 1.96).mean(axis=0)),
        nis=float(inside[tested].mean()) if tested.any() else float("nan"),
        mean_nis=float(whole.mean()) if whole.size else float("nan"),
        lost=float((~np.isfinite(nees)).mean()),
    )


@dataclass(frozen=True)
class Goal:
    """One goal over many cases: how many meet it, and those that do not, with their figure."""

    name: str
    met: int
    total: int
    short: tuple[str, ...]


def goals(found: Measured, world: str) -> list[Goal]:
    """The goals of the benchmark in one world, judged by both methods' figures."""
    bound: list[tuple[str, float, bool]] = []
    fitted: list[tuple[str, float, bool]] = []
    covered: dict[str, list[tuple[str, float, bool]]] = {"NEES": [], "NIS": []}
    for (at, name), outcomes in found.runs.items():
        if at != world:
            continue
        for m, method in enumerate(METHODS):
            label = f"{name}, {method.upper()}"
            for i, quantity in enumerate(QUANTITIES):
                a = accuracy(outcomes, m, i)
                if not a.counted:
                    continue
                words = f"{label}, {quantity.replace('_', ' ')}"
                bound.append((words, a.over_bound, a.over_bound <= WITHIN_BOUND))
                if np.isfinite(a.fitted):
                    fitted.append((words, a.rmse / a.fitted, a.rmse <= a.fitted))
            c = coverage(outcomes, m)
            covered["NEES"].append((label, c.nees, c.nees >= COVERED))
            if np.isfinite(c.nis):
                covered["NIS"].append((label, c.nis, c.nis >= COVERED))
    halves, still = [], []
    for (at, quantity), steps in found.steps.items():
        for m, method in enumerate(METHODS):
            if at == world:
                late = float(np.quantile([s.half[m] for s in steps], 0.9, method="higher"))
                halves.append((f"{quantity.replace('_', ' ')}, {method.upper()}", late, late <= HALF_WITHIN))
    for outcome in found.still if world == "plant" else ():
        for m, method in enumerate(METHODS):
            for i, quantity in enumerate(QUANTITIES):
                most = float(np.abs(outcome.moved[m, i]).max())
                words = f"{outcome.case}, {method.upper()}, {quantity.replace('_', ' ')}"
                still.append((words, most, most <= STILL_WITHIN))
    return [
        _goal(f"RMSE within {WITHIN_BOUND:g} times the bound where observable", bound, "{:.2f} times"),
        _goal("never worse than least squares over the same window", fitted, "{:.2f} times its RMSE"),
        _goal(f"NEES inside its 95 % band in {COVERED:.0%} of runs", covered["NEES"], "{:.0%}"),
        _goal(f"NIS inside its 95 % band in {COVERED:.0%} of runs", covered["NIS"], "{:.0%}"),
        _goal(f"half of a change followed within {HALF_WITHIN:g} s in 90 % of runs", halves, "{:.2f} s"),
        *(
            [_goal("an hour at standstill moves no estimate by more than its standard deviation", still,
                   "{:.1f} standard deviations")] if world == "plant" else []
        ),
    ]  # fmt: skip


def _goal(name: str, judged: list[tuple[str, float, bool]], form: str) -> Goal:
    worst: dict[str, float] = {}
    for label, value, met in judged:
        if not met:
            worst[label] = max(value, worst.get(label, -np.inf))
    ranked = sorted(worst.items(), key=lambda item: -item[1])
    return Goal(name, sum(met for *_, met in judged), len(judged),
                tuple(f"{label}: {form.format(value)}" for label, value in ranked))  # fmt: skip


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
