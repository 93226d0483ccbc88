"""More healthy logs of a unit that has a profile: its healthy balances are narrowed, its numbers stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdd.diagnosis.baseline import BASELINE_VERSION, baseline_of, histories_of
from fdd.errors import InputError
from fdd.identification.identify import identify_unit
from fdd.identification.profile import Identification, TableRow
from fdd.residuals.balances import BALANCES
from fdd.samples import Samples
from fdd.unit import Baseline, Unit

SHOWN = {
    "travel per rad of the pump": ("volume", "gain"),
    "leakage": ("volume", "leak"),
    "compliance of the oil": ("volume", "compliance"),
    "friction extending": ("force", "friction_forward"),
    "friction retracting": ("force", "friction_reverse"),
    "torque per pressure": ("torque", "pressure"),
}
"""What the healthy balances know, as a multiple of the profile's number."""


def add_logs(
    logs: Sequence[Samples], profile: Unit, labels: Sequence[str] | None = None
) -> tuple[Identification, Unit]:
    """Add healthy logs to a profile.

    A profile's numbers are the scale in which its balances are written, so they stay; what the logs tell
    goes into the balances, whose statistics add up.

    Parameters
    ----------
    logs : more healthy logs of the unit. profile : identified, with its baseline. labels : of the logs.

    Returns
    -------
    What the new logs alone identify, with the table of the balances before and after; the profile with the
    narrowed baseline.

    Raises
    ------
    InputError : the profile has no baseline of this version, or a log cannot be used.
    """
    before = profile.baseline
    columns = {n: list(b.columns) for n, b in BALANCES.items()}
    if before is None or before.version != BASELINE_VERSION:
        raise InputError(
            f"profile {profile.name} has no healthy baseline of this version of fdd",
            mend="identify it anew from all logs",
        )
    if any(columns.get(name) != balance.columns for name, balance in before.balances.items()):
        raise InputError(
            f"profile {profile.name} has balances that this fdd does not know", mend="identify it anew"
        )
    found = identify_unit(logs, profile, labels=labels)
    unit = profile.model_copy(deep=True)
    unit.baseline = after = baseline_of(histories_of(profile, logs), before)
    rows = []
    for quantity, (balance, column) in SHOWN.items():
        if balance in before.balances and balance in after.balances:
            (old, old_std), (new, std) = (_coefficient(b, balance, column) for b in (before, after))
            rows.append(
                TableRow(quantity, "of the profile's", old, new, std, f"± {1.96 * old_std:.2g} before")
            )
    return Identification(found.unit, found.table, found.notes, rows), unit


def _coefficient(baseline: Baseline, balance: str, column: str) -> tuple[float, float]:
    known = baseline.balances[balance]
    k = known.columns.index(column)
    # The gain's coefficient is the share of the pump's flow that moves nothing.
    mean = 1.0 - known.mean[k] if column == "gain" else known.mean[k]
    return mean, float(np.sqrt(known.covariance[k][k]))
