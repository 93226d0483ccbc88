"""What many runs say together: errors beside bound and least squares, coverage, whether goals are met."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.consistency import nees_band
from fdd.residuals.tracking import METHODS
from reports.estimators.cases import QUANTITIES, TRACKED
from reports.estimators.measure import Measured, PeerOutcome
from reports.estimators.runs import Outcome

Array = NDArray[np.float64]

WITHIN_BOUND, COVERED, HALF_WITHIN, STILL_WITHIN = 1.5, 0.9, 2.0, 1.0
"""Goals: RMSE over the bound; share of runs inside the 95 % bands; s until half of a change is followed;
standard deviations that an estimate moves in an hour at standstill."""
LEAST_FLAGGED = 0.05
"""Share of flagged estimates below which a quantity counts as not observable in a case."""
ABSOLUTE = "viscous_friction"
"""Its errors are given as they are and not in percent of the truth: healthy values may be nought."""


@dataclass(frozen=True)
class Accuracy:
    """One quantity by one method in one case. Errors in percent of the truth, viscous friction in N·s/m.

    Attributes
    ----------
    flagged : share of the checks at which the filter calls it observable. The other figures are over those
        checks, or over all where `counted` is False.
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
        where no channel can be tested.
    lost : share of runs that ended without a covariance.
    """

    nees: float
    too_sure: float
    scores: Array
    nis: float
    mean_nis: float
    lost: float


def scale_of(truth: Array, quantity: int) -> Array:
    """What an error is divided by: a hundredth of the truth, but for `ABSOLUTE`."""
    return np.ones_like(truth) if QUANTITIES[quantity] == ABSOLUTE else 0.01 * np.abs(truth)


def accuracy(outcomes: Sequence[Outcome], method: int, quantity: int) -> Accuracy:
    """Errors of one method and quantity over the runs of a case."""
    scale = scale_of(np.array([o.truth[quantity] for o in outcomes]), quantity)
    errors = np.array([o.errors[method, quantity] for o in outcomes]) / scale
    stds = np.array([o.stds[method, quantity] for o in outcomes]) / scale
    bound = np.array([o.bound[quantity] for o in outcomes]) / scale
    flags = np.array([o.flags[method, quantity] for o in outcomes])
    fitted = (
        np.array([o.fitted[quantity] if quantity < 2 else np.nan * o.truth[quantity] for o in outcomes])
        / scale
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
    mean, least, most = np.array([o.nis[method] for o in outcomes]).T
    low, high = nees_band(len(TRACKED))
    tested, whole = np.isfinite(least), mean[np.isfinite(mean)]
    return Coverage(
        nees=float(((nees >= low) & (nees <= high)).mean()),
        too_sure=float((~(nees <= high)).mean()),
        scores=np.asarray((np.abs(scores) <= 1.96).mean(axis=0)),
        nis=float(((mean >= least) & (mean <= most))[tested].mean()) if tested.any() else float("nan"),
        mean_nis=float(whole.mean()) if whole.size else float("nan"),
        lost=float((~np.isfinite(nees)).mean()),
    )


def beside_peers(outcomes: Sequence[PeerOutcome], quantity: int) -> tuple[Array, Array, float]:
    """Rms errors of peers and methods, in how many runs each was lost, and the rms of the bound."""
    scale = scale_of(np.array([o.truth[quantity] for o in outcomes]), quantity)
    errors = np.array([o.errors[:, quantity] for o in outcomes]) / scale[:, None]
    bound = np.array([o.bound[quantity] for o in outcomes]) / scale
    rms = np.sqrt(np.nanmean(errors**2, axis=(0, 2)))
    return rms, np.isnan(errors).any(axis=2).sum(axis=0), _rms(bound)


@dataclass(frozen=True)
class Goal:
    """One goal over many cases: how many meet it, and those that do not, with their figure."""

    name: str
    met: int
    total: int
    short: tuple[str, ...]


Judged = Iterator[tuple[str, float, bool]]
"""Label, figure, and whether it meets the goal."""


def goals(found: Measured, world: str) -> list[Goal]:
    """The goals of the benchmark in one world, judged by both methods' figures."""
    runs = [
        (f"{name}, {method.upper()}", m, outcomes)
        for (at, name), outcomes in found.runs.items() if at == world
        for m, method in enumerate(METHODS)
    ]  # fmt: skip
    errors = [
        (f"{label}, {quantity.replace('_', ' ')}", accuracy(outcomes, m, i))
        for label, m, outcomes in runs
        for i, quantity in enumerate(QUANTITIES)
    ]
    counted = [(label, a) for label, a in errors if a.counted]
    covered = [(label, coverage(outcomes, m)) for label, m, outcomes in runs]

    def halves() -> Judged:
        for (at, quantity), steps in found.steps.items():
            for m, method in enumerate(METHODS if at == world else ()):
                late = float(np.quantile([s.half[m] for s in steps], 0.9, method="higher"))
                yield f"{quantity.replace('_', ' ')}, {method.upper()}", late, late <= HALF_WITHIN

    def still() -> Judged:
        for outcome in (o for (at, _), each in found.still.items() if at == world for o in each):
            for (m, i), most in np.ndenumerate(outcome.moved):
                label = f"{outcome.case}, {METHODS[m].upper()}, {QUANTITIES[i].replace('_', ' ')}"
                yield label, float(most), bool(most <= STILL_WITHIN)

    return [
        _goal(f"RMSE within {WITHIN_BOUND:g} times the bound where observable",
              ((label, a.over_bound, a.over_bound <= WITHIN_BOUND) for label, a in counted), "{:.2f} times"),
        _goal("never worse than least squares over the same window",
              ((label, a.rmse / a.fitted, a.rmse <= a.fitted)
               for label, a in counted if np.isfinite(a.fitted)),
              "{:.2f} times its RMSE"),
        _goal(f"NEES inside its 95 % band in {COVERED:.0%} of runs",
              ((label, c.nees, c.nees >= COVERED) for label, c in covered), "{:.0%}"),
        _goal(f"NIS inside its 95 % band in {COVERED:.0%} of runs",
              ((label, c.nis, c.nis >= COVERED) for label, c in covered if np.isfinite(c.nis)), "{:.0%}"),
        _goal(f"half of a change followed within {HALF_WITHIN:g} s in 90 % of runs", halves(), "{:.2f} s"),
        _goal("an hour at standstill moves no estimate by more than its standard deviation", still(),
              "{:.1f} standard deviations"),
    ]  # fmt: skip


def _goal(name: str, judged: Judged, form: str) -> Goal:
    worst: dict[str, float] = {}
    met = total = 0
    for label, value, meets in judged:
        total, met = total + 1, met + meets
        if not meets:
            worst[label] = max(value, worst.get(label, -np.inf))
    ranked = sorted(worst.items(), key=lambda item: -item[1])
    return Goal(name, met, total, tuple(f"{label}: {form.format(value)}" for label, value in ranked))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
