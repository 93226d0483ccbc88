"""What each fault does to the conditions of the plant.

The faults' own modules (`fdd.faults`) say which parameters they change and by what; here this is done. Faults
of sensors are in `fdd.plant.sensors.faults`. Severity 0 leaves every number as it was, bit for bit. Leakages
go in at the oil's reference temperature, as all conditions do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from fdd.faults import CATALOGUE, Effect, unusable
from fdd.plant import Array
from fdd.plant import conditions as c
from fdd.plant.details import Details
from fdd.plant.faults.spec import FaultScales, FaultSpec

PARAMETERS: dict[str, int] = {
    name.lower(): column for name, column in vars(c).items() if name.isupper() and column in range(c.COLUMNS)
}
"""Name that an effect gives to a parameter, to its column of the conditions."""

STATE_BORNE = ("load", "heat")
"""Profiles that go with the plant's state, which the loop alone knows."""

PLANT_FAULTS = tuple(entry.id for entry in CATALOGUE.values() if entry.effects)
"""Faults of the plant, in the order in which a scenario's faults take effect."""


def inject(
    rows: Array, time: Array, specs: Sequence[FaultSpec], scales: FaultScales, details: Details, *,
    axis: int = 1, profile: str | None = None,
) -> None:  # fmt: skip
    """Put an axis's plant faults into its conditions, in place.

    Parameters
    ----------
    rows, time : (n, COLUMNS) conditions of any stretch of a run, and (n,) s.
    specs : the scenario's faults; those of sensors and of the other axis are passed over.
    axis : 1 or 2, whose rows these are.
    profile : ``load`` or ``heat``: those alone; None: all others.

    Raises
    ------
    InputError : a package's fault names what the plant does not have.
    """
    figures = {**vars(details), **vars(scales)}
    for name in PLANT_FAULTS:
        for spec in specs:
            state_borne = spec.profile if spec.profile in STATE_BORNE else None
            if spec.fault == name and spec.axis == axis and state_borne == profile:
                severity = spec.over(time)
                for effect in CATALOGUE[name].effects:
                    if effect.goes_with(spec.side, spec.variant, spec.law):
                        _require(name, effect, figures)
                        _change(rows[:, PARAMETERS[effect.parameter]], severity, effect, figures)


def _require(name: str, effect: Effect, figures: Mapping[str, float]) -> None:
    if effect.parameter not in PARAMETERS:
        raise unusable(name, f"the plant has no parameter {effect.parameter!r}", PARAMETERS)
    for number in effect.numbers:
        if isinstance(number, str) and number not in figures:
            raise unusable(name, f"no figure is called {number!r}", figures)


def _change(column: Array, severity: Array, effect: Effect, figures: Mapping[str, float]) -> None:
    by, less, *factors, over = (figures[n] if isinstance(n, str) else n for n in effect.numbers)
    amount = severity * (by - 1.0 if effect.change in ("towards", "shift") else by) * (1.0 - less)
    for i, factor in enumerate(factors):
        amount = amount * (factor if i < len(effect.times) else math.sqrt(factor))
    amount = amount / over
    if effect.change in ("add", "shift"):
        column += amount
    elif effect.change == "lower":
        column *= 1.0 - amount
    elif effect.change == "decades":
        column *= 10.0**-amount
    else:
        column *= 1.0 + amount
