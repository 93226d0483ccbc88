"""What an entry of the catalogue holds: words, figures of severity 1, effects on the plant, signatures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, Protocol

FAMILIES = (
    "healthy", "leakage", "seal_wear", "aeration", "check_valve", "relief_valve",
    "friction", "motor", "sensor", "unknown",
)  # fmt: skip
"""Keys of an answer's probabilities, in the contract's order."""

ASSUMED = "assumption: scale chosen so that 1.0 is gross and 0.2 is near the limit of what sensors show"
LEAKAGE = (0.0, 1e-9)
"""m³/(s·Pa), allowed for leakages at the oil's reference temperature."""
ORIFICE_FLOW = (0.0, 1e-1)
"""m³/s at 1 MPa, allowed for orifices."""
SHARE = (0.0, 1.0)
DECADES = (0.0, 9.0)
"""Powers of ten, allowed for what closes."""


@dataclass(frozen=True)
class Figure:
    """A number behind severity 1 that a user may override (`fdd.plant.faults.FaultScales`).

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


@dataclass(frozen=True)
class Amount:
    """A size in the words of a severity that is another on a machine of another size.

    Attributes
    ----------
    number, unit : as they stand there together, e.g. 12 and ``e-12 m³/(s·Pa)``, on the thesis's actuator.
    grows : with which of a unit's own sizes (`fdd.residuals.quantities.Scales`).
    """

    number: float
    unit: str
    grows: Literal["fault_leakage", "orifice", "pressure"]

    def words(self, factor: float = 1.0) -> str:
        """Number and unit, of a machine on which it is `factor` times as large.

        Examples
        --------
        >>> Amount(12, "e-12 m³/(s·Pa)", "fault_leakage").words(0.02)
        '2.4e-13 m³/(s·Pa)'
        """
        number = factor * self.number
        power, _, unit = self.unit.partition(" ")
        while power and 0.0 < number < 1.0:
            number, power = 10.0 * number, f"e{int(power[1:]) - 1}"
        return f"{number:.3g}{power} {unit}"


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


def each_side(*effects: Effect) -> tuple[Effect, ...]:
    """The effects of either side: parameters whose name ends with ``_{side}``."""
    return tuple(
        replace(e, parameter=e.parameter.format(side=side), side=side) for side in (1, 2) for e in effects
    )


Columns = dict[str, dict[str, float]]
"""Balance to column to change of that column's coefficient at severity 1."""


class Healthy(Protocol):
    """What a signature may ask about the healthy unit."""

    @property
    def leakage_ratio(self) -> float:
        """Internal leakage of severity 1 over the healthy one."""

    @property
    def speed_ratio(self) -> float:
        """Largest speed of the drive over 100 rad/s."""

    @property
    def relief_ratio(self) -> float:
        """Relief setting over the drop of a sound refeeding valve at the pump's full flow."""

    @property
    def charge_ratio(self) -> float:
        """Absolute pressure of the accumulator over that drop."""

    def mean(self, balance: str, column: str) -> float:
        """Coefficient of that column while the unit is healthy."""


@dataclass(frozen=True)
class Signature:
    """One way in which a fault shows.

    Attributes
    ----------
    label : for people; unique within the fault.
    columns : from the healthy unit to what changes.
    side, variant : of the fault, where the signature tells them.
    law : of the fault's, that it is made for; None is the first, and what looks like it.
    signed : the amplitude is a severity and cannot be negative.
    channel : the sensor at fault.
    courses : in time, of step, ramp and drift; a step may also come and go.
    commonness : weight among faults that look alike in a log: how often the part fails, with how many there
        are, and what share of its laws look so.
    """

    label: str
    columns: Callable[[Healthy], Columns]
    side: int | None = None
    variant: str | None = None
    law: str | None = None
    signed: bool = True
    channel: str | None = None
    courses: tuple[str, ...] = ("step", "ramp")
    commonness: float = 1.0


def side_signatures(
    label: str, columns: Callable[[int, Healthy], Columns], law: str | None = None, commonness: float = 1.0
) -> tuple[Signature, ...]:
    """A signature of either side: from the side and the healthy unit to what changes."""
    return tuple(
        Signature(f"{label} {side}", partial(columns, side), side=side, law=law, commonness=commonness)
        for side in (1, 2)
    )


def more_current(share: float) -> Callable[[Healthy], Columns]:
    """Columns of a motor that takes so much more current for any torque, as a share of the healthy one."""
    loads = ("pressure", "inertia", "dry", "viscous", "mesh")
    return lambda unit: {"torque": {name: share * unit.mean("torque", name) for name in loads}}


def zero_signatures(label: str, zero: float, course: str) -> tuple[Signature, ...]:
    """How the zero of each pressure transducer shows that is off by `zero`, over the relief setting.

    The pressure difference disagrees with the chambers' pressures, these with the accumulator's too; and a
    pressure that is not there takes no current.
    """

    def of(name: str, channel: str, columns: Callable[[Healthy], Columns]) -> Signature:
        return Signature(f"{label} {name}", columns, signed=False, courses=(course,), channel=channel)

    return (
        of("dp", "pressure_difference", lambda unit: {"coherence": {"zero": zero}}),
        of(
            "dp by torque", "pressure_difference",
            lambda unit: {"torque": {"zero": -zero * unit.mean("torque", "pressure")}},
        ),
        of(
            "p1", "pressure_1",
            lambda unit: {"coherence": {"zero": -zero}, "refeed": {"drop_1": -zero * unit.relief_ratio}},
        ),
        of(
            "p2", "pressure_2",
            lambda unit: {"coherence": {"zero": zero}, "refeed": {"drop_2": -zero * unit.relief_ratio}},
        ),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One entry of the catalogue.

    Attributes
    ----------
    id, family : the contract's words.
    title : for people.
    thesis : where the thesis names or injects it; a package's own fault has none.
    plant : what it does to the plant, in words.
    severity : what severity 1.0 means, in physical units, on an actuator of the thesis's size; campaigns
        scale it for machines of other sizes (`fdd.campaign.sizes.Scale.fault_scales`).
    amounts : what of that is another on another machine; reports say its own.
    source : where that scale comes from, or that it is an assumption.
    next_check : what a technician does to confirm it, one sentence.
    variants, sides : choices that the injection takes; the first is the default.
    laws : name to how the plant may have it, the first by default.
    figures : numbers behind severity 1.
    effects : what they change in the plant.
    in_measurement : `fdd.plant.sensors` injects it, not the plant.
    signatures : how it shows in the balances; any of them speaks for the fault.
    rank : place within the family, as in the contract; a new fault comes last.
    """

    id: str
    family: str
    title: str
    plant: str
    severity: str
    source: str
    next_check: str
    thesis: str = ""
    variants: tuple[str, ...] = ()
    sides: tuple[int, ...] = ()
    laws: Mapping[str, str] = field(default_factory=dict)
    figures: tuple[Figure, ...] = ()
    effects: tuple[Effect, ...] = ()
    in_measurement: bool = False
    signatures: tuple[Signature, ...] = ()
    amounts: tuple[Amount, ...] = ()
    rank: int = 99

    @property
    def simulated(self) -> bool:
        """Whether `fdd.plant` injects it."""
        return bool(self.effects) or self.in_measurement
