"""Faults of the plant: which one a user asks for, how severe, when and how it comes; and what it changes.

The faults' own modules (`fdd.faults`) say what severity 1 is, which parameters they change and by what; here
this is done. Faults of sensors are in `fdd.plant.sensors.faults`. Severity 0 leaves every number as it was,
bit for bit. Leakages go in at the oil's reference temperature, as all conditions do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field, create_model, model_validator

from fdd.errors import InputError
from fdd.faults import CATALOGUE, Effect, Figure, fault, unusable
from fdd.plant import Array, Validated, named_parameters
from fdd.plant import conditions as c

SIMULATED = tuple(f.id for f in CATALOGUE.values() if f.simulated)
"""Ids of the faults that the plant injects."""

PARAMETERS: dict[str, int] = {
    name.lower(): column for name, column in vars(c).items() if name.isupper() and column in range(c.COLUMNS)
}
"""Name that an effect gives to a parameter, to its column of the conditions."""

STATE_BORNE = ("load", "heat")
"""Profiles that go with the plant's state, which the loop alone knows."""

PLANT_FAULTS = tuple(entry.id for entry in CATALOGUE.values() if entry.effects)
"""Faults of the plant, in the order in which a scenario's faults take effect."""

Profile = Literal["step", "ramp", "intermittent", "exponential", "random", "load", "heat"]


class FaultSpec(Validated):
    """One fault to inject.

    Attributes
    ----------
    fault : id of the catalogue, one of `SIMULATED`.
    severity : 0 to 1; the catalogue says what 1.0 means.
    onset : s after the start of the log; 0 means from the beginning.
    profile : step; ramp (linear over `ramp` s); intermittent (on for the share `duty` of every `period` s);
        exponential (over `ramp` s, a twentieth of the rate at first); random (on and off for times that are
        exponentially distributed, on for that share, `period` s on average, by `seed`); load (in proportion
        to it, whole from half the relief setting on) or heat (whole once the oil is 2 K warmer).
    side, variant, law : what the catalogue lists for the fault; None takes the first.
    seed : of the random profile.
    axis : 1, or 2 for the partner of a dual rig.
    """

    fault: str
    severity: Annotated[float, Field(ge=0.0, le=1.0)]
    onset: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0
    profile: Profile = "step"
    ramp: Annotated[float, Field(gt=0.0, le=3600.0)] = 10.0
    period: Annotated[float, Field(gt=0.0, le=3600.0)] = 4.0
    duty: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.5
    side: int | None = None
    variant: str | None = None
    law: str | None = None
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    axis: Annotated[Literal[1, 2], BeforeValidator(lambda n: int(n) if n in ("1", "2") else n)] = 1

    @model_validator(mode="after")
    def _known(self) -> FaultSpec:
        entry = fault(self.fault)
        if not entry.simulated:
            problem = f"fault {self.fault!r} is not simulated"
            raise InputError(problem, mend=f"the simulated ones: {', '.join(SIMULATED)}")
        for name, given, allowed in (
            ("side", self.side, entry.sides),
            ("variant", self.variant, entry.variants),
            ("law", self.law, tuple(entry.laws)),
        ):
            if given is None:
                object.__setattr__(self, name, allowed[0] if allowed else None)
            elif given not in allowed:
                shown = ", ".join(str(a) for a in allowed)
                mend = f"use one of: {shown}" if allowed else f"leave {name} out"
                raise InputError(f"fault {self.fault}: {name} {given!r} is not possible", mend=mend)
        if entry.in_measurement and self.profile in ("load", "heat"):
            problem = f"fault {self.fault}: a sensor's fault does not come with {self.profile}"
            raise InputError(problem, mend="use one of: step, ramp, intermittent, exponential, random")
        return self

    @property
    def family(self) -> str:
        """The fault's family in the catalogue."""
        return CATALOGUE[self.fault].family

    def over(self, time: Array) -> Array:
        """Severity at each time, (n,) for (n,) seconds; of one that comes with load or heat the most."""
        since = time - self.onset
        begun = since >= -1e-9
        if self.profile == "ramp":
            share = np.clip(since / self.ramp, 0.0, 1.0)
        elif self.profile == "intermittent":
            phase = np.mod(since + 1e-9, self.period)
            share = np.where(phase < self.duty * self.period, 1.0, 0.0)
        elif self.profile == "exponential":
            share = np.expm1(_GROWTH * np.clip(since / self.ramp, 0.0, 1.0)) / np.expm1(_GROWTH)
        elif self.profile == "random":
            changes = np.searchsorted(_changes(self.seed, self.period, self.duty), since + 1e-9, side="right")
            share = np.where(changes % 2 == 0, 1.0, 0.0)
        else:
            share = np.ones_like(since)
        return np.where(begun, self.severity * share, 0.0)

    def label(self) -> dict[str, str | float | int | None]:
        """The label of the fault, as data sets carry it."""
        found: dict[str, Any] = {"fault": self.fault, "family": self.family, "severity": self.severity}
        named = {name: getattr(self, name) for name in ("profile", "side", "variant", "law", "axis")}
        return found | {"onset_s": self.onset} | named


_GROWTH = 3.0
"""Of the exponential profile: its rate grows by e³ = 20 over its time."""
_CHANGES = 4096
"""Times that a random fault comes and goes; then it stays."""


@lru_cache(maxsize=64)
def _changes(seed: int, period: float, duty: float) -> Array:
    """Seconds after the onset at which a random fault goes, comes, goes …"""
    rng = np.random.default_rng([seed, _CHANGES])
    return np.cumsum(rng.exponential(1.0, (_CHANGES, 2)) * period * np.array([duty, 1.0 - duty]))


_FIGURES = [figure for entry in CATALOGUE.values() for figure in entry.figures]


def _field(figure: Figure) -> Any:
    low, high = figure.allowed
    return Annotated[float, Field(ge=low, le=high, description=figure.meaning)], figure.value


if TYPE_CHECKING:
    from fdd.plant.details import Details

    class _Figures(Validated):
        def __getattr__(self, name: str) -> float: ...
else:  # Of the catalogue, so that a figure stands in its fault's module alone.
    _Figures = create_model("_Figures", __base__=Validated, **{f.name: _field(f) for f in _FIGURES})


class FaultScales(_Figures):
    """Effects of the faults at severity 1; between 0 and 1 they go in proportion.

    Its parameters are the figures of the catalogue, whose modules say what each of them means. Leakages are
    those at the oil's reference temperature, orifice flows those at 1 MPa.
    """

    usual: ClassVar[dict[str, tuple[float, float]]] = {f.name: f.usual for f in _FIGURES if f.usual}
    """Ranges that a campaign draws from, see `fdd.faults.Figure`."""


def parse_fault(text: str) -> FaultSpec:
    """Read a fault as the command line gives it: ``ID:severity=0.4,onset=20`` and fields of `FaultSpec`.

    Examples
    --------
    >>> parse_fault("seal_wear:severity=0.3,onset=5,variant=tight").variant
    'tight'
    """
    name, given = named_parameters(text, "--fault")
    try:
        fault(name)  # before the severity is missed: the name is the likelier slip
        if "severity" not in given:
            raise InputError("severity is missing", mend=f"write {name}:severity=0.4 (0 to 1)")
        return FaultSpec(**{"fault": name, **given})
    except InputError as error:
        raise error.at(f"--fault {text}") from None


def inject(
    rows: Array, time: Array, specs: Sequence[FaultSpec], scales: FaultScales, details: Details, *,
    axis: int = 1, profile: str | None = None,
) -> None:  # fmt: skip
    """Put an axis's plant faults into its conditions (n, COLUMNS) at `time` (n,) s, in place.

    Of the scenario's faults those of sensors and of the other axis are passed over. `profile` is ``load`` or
    ``heat`` for those alone, None for all others. An `InputError` where a package's fault names what the
    plant does not have.
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
