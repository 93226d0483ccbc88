"""What a fault changes in the plant, as data: names of the plant's parameters and figures of severity 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Figure:
    """A number behind severity 1 that a user may override, see `fdd.plant.faults.spec.FaultScales`.

    Attributes
    ----------
    name : unique in the catalogue.
    value : what it is unless it is overridden, SI.
    allowed : least and most that are accepted.
    meaning : with its unit; an assumption where no source is named.
    usual : range that a campaign draws from, for what comes along with a fault. What the catalogue gives as
        severity 1 is not drawn, or a severity would not mean the same in two logs of a data set.
    grows : with what of a machine's size it goes in proportion, see `fdd.campaign.sizes.Scale.fault_scales`;
        shares and angles do not. ``charge`` is the accumulator's pressure, ``torque`` torque over speed.
    """

    name: str
    value: float
    allowed: tuple[float, float]
    meaning: str
    usual: tuple[float, float] | None = None
    grows: Literal["", "leakage", "speed_leakage", "orifice", "flow", "pressure", "charge", "torque"] = ""


LEAKAGE = (0.0, 1e-9)
"""m³/(s·Pa), allowed for leakages at the oil's reference temperature."""
ORIFICE_FLOW = (0.0, 1e-1)
"""m³/s at 1 MPa, allowed for orifices."""
SHARE = (0.0, 1.0)
DECADES = (0.0, 9.0)
"""Powers of ten, allowed for what closes."""


@dataclass(frozen=True)
class Effect:
    """How one parameter of the plant changes with the severity s.

    Its amount is ``s * by * (1 - less) * times... * root(roots)... / over``, in this order. Where a name
    stands for a number it is one of the catalogue's figures or a detail of the plant.

    Attributes
    ----------
    parameter : a column of `fdd.plant.conditions`, in small letters.
    change : ``add`` the amount; ``raise`` or ``lower`` by it, as a share of what the parameter was;
        ``towards`` scales the parameter by `by` at severity 1, ``shift`` adds `by` - 1; ``decades`` lets it
        fall by as many powers of ten, for what has to be nearly gone before anything shows.
    by : figure or number.
    less, times, roots, over : further figures or numbers.
    side, variants, laws : which of the fault's it goes with; left out, it goes with all.
    """

    parameter: str
    change: Literal["add", "raise", "lower", "towards", "shift", "decades"]
    by: str | float
    less: str | float = 0.0
    times: tuple[str | float, ...] = ()
    roots: tuple[str | float, ...] = ()
    over: str | float = 1.0
    side: int | None = None
    variants: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()

    @property
    def numbers(self) -> tuple[str | float, ...]:
        """Figures and numbers that the amount is made of."""
        return (self.by, self.less, *self.times, *self.roots, self.over)

    def goes_with(self, side: int | None, variant: str | None, law: str | None) -> bool:
        """Whether the fault has it on that side, in that variant and by that law."""
        return (
            self.side in (None, side)
            and (not self.variants or variant in self.variants)
            and (not self.laws or law in self.laws)
        )
