"""What many runs say together: errors beside bound and least squares, coverage, whether goals are met."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np
import pandas as pd

from estimators.consistency import nees_band
from reports.estimators.cases import QUANTITIES, TRACKED
from reports.estimators.measure import Measured

WITHIN_BOUND, COVERED, HALF_WITHIN = 1.5, 0.9, 2.0
"""Goals: RMSE over the bound; share of runs inside the 95 % bands; s until half of a change is followed."""
LEAST_FLAGGED = 0.05
"""Share of flagged estimates below which a quantity counts as not observable in a case."""
ABSOLUTE = "viscous_friction"
"""Its errors are given as they are and not in percent of the truth: healthy values may be nought."""

Key = tuple[str, ...]


def grouped(frame: pd.DataFrame, *by: str) -> Iterator[tuple[Key, pd.DataFrame]]:
    """Groups by columns or levels, in the order in which they come."""
    for key, rows in frame.groupby(list(by), sort=False):
        yield cast(Key, key), rows


def _each(frame: pd.DataFrame, figures: Callable[[pd.DataFrame], dict[str, float]], *by: str) -> pd.DataFrame:
    found = {key: figures(rows) for key, rows in grouped(frame, *by)}
    return pd.DataFrame(list(found.values()), index=pd.MultiIndex.from_tuples(list(found), names=by))


def within(frame: pd.DataFrame, world: str) -> pd.DataFrame:
    """One world of a frame of figures."""
    return cast(pd.DataFrame, frame.loc[world])


def rows_of(frame: pd.DataFrame) -> Iterator[tuple[Key, pd.Series]]:
    """Rows of a frame of figures."""
    for key, row in frame.iterrows():
        yield cast(Key, key), row


def relative(errors: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Those columns in percent of the truth, `ABSOLUTE`'s as they are."""
    scale = np.where(errors["quantity"] == ABSOLUTE, 1.0, 0.01 * errors["truth"].abs())
    return errors.assign(**errors[columns].div(scale, axis=0))


def rms(values: pd.Series) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def words(name: str) -> str:
    """A quantity's name as it is read."""
    return name.replace("_", " ")


def accuracy(errors: pd.DataFrame) -> pd.DataFrame:
    """Of each world, case, quantity and method, in percent of the truth, viscous friction in N·s/m.

    Columns: flagged (share of the checks at which the filter calls it observable), counted (whether that is
    often enough: the rest is over those checks, else over all), rmse, bias and spread of the errors, claimed
    and bound (rms of the standard deviations), fitted (rmse of least squares, NaN for friction).
    """

    def figures(rows: pd.DataFrame) -> dict[str, float]:
        flagged = rows["flag"].mean()
        counted = flagged >= LEAST_FLAGGED
        used = rows[(rows["flag"] | (not counted)) & np.isfinite(rows["error"]) & np.isfinite(rows["std"])]
        error, fitted = used["error"], used["fitted"]
        return {
            "flagged": flagged, "counted": counted and len(used) > 0, "rmse": rms(error),
            "bias": error.mean(), "spread": error.std(ddof=0), "claimed": rms(used["std"]),
            "bound": rms(used["bound"]), "fitted": rms(fitted[np.isfinite(fitted)]),
        }  # fmt: skip

    shares = relative(errors, ["error", "std", "bound", "fitted"])
    return _each(shares, figures, "world", "case", "quantity", "method")


def coverage(consistency: pd.DataFrame) -> pd.DataFrame:
    """Of each world, case and method, shares of runs inside the 95 % bands.

    Columns: nees, too_sure (share above its band), each quantity's error within 1.96 standard deviations,
    nis and mean_nis (over its expectation; NaN where no channel can be tested), lost (ended without a
    covariance).
    """
    low, high = nees_band(len(TRACKED))

    def figures(rows: pd.DataFrame) -> dict[str, float]:
        nees, tested = rows["nees"], rows[np.isfinite(rows["nis_low"])]
        return {
            "nees": nees.between(low, high).mean(), "too_sure": (~(nees <= high)).mean(),
            **{q: (rows[q].abs() <= 1.96).mean() for q in QUANTITIES},
            "nis": tested["nis"].between(tested["nis_low"], tested["nis_high"]).mean(),
            "mean_nis": rows.loc[np.isfinite(rows["nis"]), "nis"].mean(),
            "lost": (~np.isfinite(nees)).mean(),
        }  # fmt: skip

    return _each(consistency, figures, "world", "case", "method")


def late_half(half: pd.Series) -> float:
    """s within which half of a change is followed in 90 % of the runs."""
    return float(np.quantile(half, 0.9, method="higher"))


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
    errors, covered = (
        within(frame, world) for frame in (accuracy(found["errors"]), coverage(found["consistency"]))
    )
    counted = errors[errors["counted"].astype(bool)]

    def against(reference: str, most: float) -> Judged:
        for (case, quantity, method), a in rows_of(counted):
            if np.isfinite(a[reference]):
                ratio = a["rmse"] / a[reference]
                yield f"{case}, {method.upper()}, {words(quantity)}", ratio, ratio <= most

    def inside(which: str) -> Judged:
        for (case, method), c in rows_of(covered):
            if np.isfinite(share := c[which]):
                yield f"{case}, {method.upper()}", share, share >= COVERED

    def halves() -> Judged:
        if "steps" in found:
            steps = found["steps"][found["steps"]["world"] == world]
            for (quantity, method), runs in grouped(steps, "case", "method"):
                late = late_half(runs["half"])
                yield f"{words(quantity)}, {method.upper()}", late, late <= HALF_WITHIN

    return [
        _goal(f"RMSE within {WITHIN_BOUND:g} times the bound where observable",
              against("bound", WITHIN_BOUND), "{:.2f} times"),
        _goal("never worse than least squares over the same window", against("fitted", 1.0),
              "{:.2f} times its RMSE"),
        _goal(f"NEES inside its 95 % band in {COVERED:.0%} of runs", inside("nees"), "{:.0%}"),
        _goal(f"NIS inside its 95 % band in {COVERED:.0%} of runs", inside("nis"), "{:.0%}"),
        _goal(f"half of a change followed within {HALF_WITHIN:g} s in 90 % of runs", halves(), "{:.2f} s"),
    ]  # fmt: skip


def _goal(name: str, judged: Judged, form: str) -> Goal:
    each = list(judged)
    short = sorted(((label, value) for label, value, met in each if not met), key=lambda item: -item[1])
    return Goal(
        name,
        len(each) - len(short),
        len(each),
        tuple(f"{label}: {form.format(value)}" for label, value in short),
    )
