"""Which estimates differ between two logs of a unit by more than their uncertainty."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr

from fdd.diagnosis.findings import Diagnosis, Estimate
from fdd.history.answers import EstimateChange
from fdd.history.line import holm
from fdd.unit import Unit

LEVEL = 0.05
TEST = (
    "two-sided z test of each difference over its standard deviation, 95 % over all rows together (Holm); "
    "which is made of both filters' own and of what healthy logs differ by"
)
BETWEEN = {"leakage": 0.05, "bulk_modulus": 0.03, "coulomb_friction": 0.09, "viscous_friction": 0.09}
"""Relative std from healthy log to healthy log: 1 to 2 K between the gap and the temperature's sensor, at
4 % a kelvin; a model that is fitted to long and to short strokes (2.4 % on a rig of another make). Air that
came or went is a change. Friction: thesis Table 5.1, where no profile tells its own (trial_spread)."""
UNMEASURED = 0.4
"""The same of leakage, where nobody measures the oil's temperature: 10 K."""
VISCOSITY_LAW_DOUBT = 0.05
"""Assumption: by how much (ln) the viscosity law errs for each factor of e that it takes out."""
UNTOLD = ("a", "a_std", "b", "b_std", "difference", "std", "p_value", "p_holm", "changed")
"""Of an estimate that a log does not show."""


def estimate_changes(a: Diagnosis, b: Diagnosis, unit: Unit, *, measured: bool) -> list[EstimateChange]:
    """All estimates of both logs, under the same conditions, tested.

    Parameters
    ----------
    a, b : answers on the same profile. measured : whether both logs have the oil's temperature.
    """
    rows = [_row(name, a.estimates[name], b.estimates[name], unit, measured) for name in a.estimates]
    told = [row for row in rows if row.p_value is not None]
    for row, p in zip(told, holm([row.p_value or 0.0 for row in told]), strict=True):
        row.p_holm, row.changed = p, p < LEVEL
    return rows


def seen(estimate: Estimate) -> tuple[float, float] | None:
    """The value that may be used, and its standard deviation; None of what the log never showed.

    While it is not observable: that at the end or the last observable one, whichever is known better.
    """
    if not estimate.observable and estimate.held is None:
        return None
    pairs = [(estimate.value, estimate.std), (estimate.held, estimate.held_std)]
    known = [(v, s) for v, s in pairs if v is not None and s is not None and s > 0.0]
    return min(known[:1] if estimate.observable else known, key=lambda pair: pair[1], default=None)


def _row(name: str, a: Estimate, b: Estimate, unit: Unit, measured: bool) -> EstimateChange:
    scales, law, conditions = (1.0, 1.0), 0.0, ""
    if name == "leakage" and a.baseline and b.baseline:
        # The healthy value at each log's own temperature tells what the viscosity law makes of it.
        scales = (unit.pump.total_leakage / a.baseline, unit.pump.total_leakage / b.baseline)
        law = VISCOSITY_LAW_DOUBT * abs(math.log(a.baseline / b.baseline)) if measured else UNMEASURED
        conditions = f"at {unit.oil.reference_temperature:g} °C" if measured else "temperature not measured"
    elif name == "bulk_modulus":
        conditions = f"at {unit.oil.reference_pressure * 1e-5:.3g} bar"
    row = EstimateChange(quantity=name, unit=a.unit, conditions=conditions, **dict.fromkeys(UNTOLD))
    one, other = (
        None if (pair := seen(e)) is None else (pair[0] * k, pair[1] * k)
        for e, k in zip((a, b), scales, strict=True)
    )
    if one is not None:
        row.a, row.a_std = one
    if other is not None:
        row.b, row.b_std = other
    if one is None or other is None:
        return row
    (value_a, std_a), (value_b, std_b) = one, other
    between = unit.friction.trial_spread if "friction" in name else BETWEEN[name]
    usual = math.hypot(value_a, value_b) * between
    row.difference = value_b - value_a
    row.std = float(np.linalg.norm([std_a, std_b, usual, 0.5 * (abs(value_a) + abs(value_b)) * law]))
    row.p_value = float(2.0 * ndtr(-abs(row.difference) / row.std))
    return row
