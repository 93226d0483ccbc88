"""The catalogue's signatures as columns of this unit's balances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.faults import CATALOGUE, unusable
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import Effects
from fdd.residuals.quantities import Scales
from fdd.unit import Unit

Array = NDArray[np.float64]

RECOVERED = "recovered"
"""Stands in a fault's place where the end of one is meant."""
USUAL_SEVERITY = 0.7
"""Standard deviation of a severity before any log is seen: most lie below the gross one."""


@dataclass(frozen=True)
class Hypothesis:
    """One way in which one fault shows on this unit.

    Attributes
    ----------
    fault, label : of the catalogue. columns : balance to (n,) change of its coefficients per severity.
    scale : prior standard deviation of the amplitudes. signed : the amplitude cannot be negative.
    time_profiles : of `fdd.diagnosis.time_profiles`, that the fault may take. prior_weight : prior
        weight among alike ones. ends : the fault that it is the end of.
    """

    fault: str
    label: str
    columns: dict[str, Array]
    scale: float
    signed: bool
    time_profiles: tuple[str, ...] = ("step", "ramp")
    prior_weight: float = 1.0
    side: int | None = None
    variant: str | None = None
    channel: str | None = None
    ends: str | None = None


@dataclass(frozen=True)
class HealthyUnit:
    """What signatures may ask (see `fdd.faults.Healthy`)."""

    effects: dict[str, Effects]
    scales: Scales

    @property
    def leakage_ratio(self) -> float:
        """Internal leakage of severity 1 over the healthy one."""
        return self.scales.fault_leakage / self.scales.leakage

    @property
    def speed_ratio(self) -> float:
        """Largest speed of the drive over 100 rad/s."""
        return self.scales.speed / 100.0

    @property
    def relief_ratio(self) -> float:
        """Relief setting over the drop of a sound refeeding valve at the pump's full flow."""
        return self.scales.pressure / self.scales.valve

    @property
    def charge_ratio(self) -> float:
        """Absolute pressure of the accumulator over that drop."""
        return self.scales.charge / self.scales.valve

    def mean(self, balance: str, column: str) -> float:
        """Coefficient of that column while the unit is healthy."""
        return float(self.effects[balance].mean[BALANCES[balance].columns.index(column)])


def hypotheses(unit: Unit, effects: dict[str, Effects]) -> list[Hypothesis]:
    """All signatures of the catalogue for a unit.

    Raises
    ------
    InputError : a package's fault names what the balances do not have.
    """
    healthy = HealthyUnit(effects, Scales.of(unit))
    out = []
    for entry in CATALOGUE.values():
        for s in entry.signatures:
            columns = {}
            for balance, changes in s.columns(healthy).items():
                if balance not in BALANCES:
                    raise unusable(entry.id, f"there is no balance {balance!r}", BALANCES)
                names = BALANCES[balance].columns
                columns[balance] = np.zeros(len(names))
                for name, change in changes.items():
                    if name not in names:
                        raise unusable(entry.id, f"balance {balance!r} has no column {name!r}", names)
                    columns[balance][names.index(name)] = change
            out.append(
                Hypothesis(
                    entry.id,
                    s.label,
                    columns,
                    USUAL_SEVERITY,
                    s.signed,
                    s.courses,
                    s.commonness,
                    s.side,
                    s.variant,
                    s.channel,
                )
            )
    return out


def end_of(h: Hypothesis, size: float) -> Hypothesis:
    """That a fault of an amplitude is over: all that it changed steps back."""
    columns = {balance: -size * change for balance, change in h.columns.items()}
    return Hypothesis(RECOVERED, h.label, columns, 1.0, signed=True, time_profiles=("step",), ends=h.fault)
