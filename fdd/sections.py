"""Sections of a profile: numbers that carry their unit, source and spread; a channel's sensor among them.

Every number may be written plain (then it is in the field's SI unit) or with its provenance, which is kept
and written back: ``{value: 35, unit: bar, source: data sheet, std: 2}``.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from math import pi
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidatorFunctionWrapHandler, model_validator
from pydantic import GetJsonSchemaHandler as Handler
from pydantic_core import CoreSchema

from fdd.errors import InputError
from fdd.measures import measure


@dataclass(frozen=True)
class SI:
    """Marks a field with its SI unit of measure, its dimension, and the unit that profiles write it in."""

    unit: str
    dimension: str
    written: str


def si(unit: str, written: str | None = None) -> SI:
    """A field's SI unit, as ``Annotated[float, si("ohm")]``; `written` is that of plain numbers."""
    return SI(unit=unit, dimension=measure(unit).dimension, written=written or unit)


class Provenance(BaseModel):
    """Where a number comes from and how well it is known (SI)."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    source: str | None = None
    std: float | None = None


QUANTITY = {
    "type": "object",
    "properties": {"value": {"type": "number"}, "unit": {"type": "string"}, "source": {"type": "string"},
                   "std": {"type": "number", "minimum": 0}},
    "required": ["value"],
    "additionalProperties": False,
}  # fmt: skip
"""JSON Schema of a number with its provenance."""


class Section(BaseModel):
    """A part of a profile; its numbers carry their unit, source and spread."""

    model_config = ConfigDict(extra="forbid", validate_assignment=True, allow_inf_nan=False)
    provenance: dict[str, Provenance] = Field(default_factory=dict, exclude=True, repr=False)

    @model_validator(mode="wrap")
    @classmethod
    def _take_provenance(cls, data: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        if not isinstance(data, dict):
            return handler(data)
        plain: dict[str, Any] = {}
        given = data.get("provenance", {})
        if not isinstance(given, dict):
            raise InputError("is not a table", where="provenance", mend="write each source beside its number")
        provenance: dict[str, Provenance] = dict(given)
        for key, entry in data.items():
            field = cls.model_fields.get(key)
            mark = None if field is None else si_of(field)
            if mark is not None and mark.written != mark.unit and isinstance(entry, int | float | str):
                entry = {"value": entry}
            plain[key] = entry
            if isinstance(entry, dict) and "value" in entry and field is not None:
                try:
                    plain[key], provenance[key] = _quantity(entry, mark)
                except InputError as error:
                    raise InputError(error.problem, where=key, mend=error.mend) from None
        plain["provenance"] = provenance
        return handler(plain)

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: Handler) -> dict[str, Any]:
        """As pydantic's, with numbers that are plain or carry their unit, source and spread."""
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema)["properties"]
        del properties["provenance"]
        for name, plain in properties.items():
            marked = si_of(cls.model_fields[name])
            if marked is not None:
                properties[name] = {"anyOf": [plain, QUANTITY], "description": f"in {marked.written}"}
        return schema

    def std_of(self, name: str) -> float | None:
        """Standard deviation of a number, where the profile gives one (SI)."""
        found = self.provenance.get(name)
        return None if found is None else found.std

    def to_plain(self) -> dict[str, Any]:
        """The section as YAML would show it, numbers with unit, source and std."""
        out: dict[str, Any] = {}
        for name, field in type(self).model_fields.items():
            value, si = getattr(self, name), si_of(field)
            if value is None or name == "provenance":
                continue
            if isinstance(value, Section):
                out[name] = value.to_plain()
            elif isinstance(value, dict) and value and all(isinstance(v, Section) for v in value.values()):
                out[name] = {k: v.to_plain() for k, v in value.items()}
            elif si is not None:
                shown = float(value) / (1.0 if si.written == si.unit else measure(si.written).factor)
                out[name] = {"value": float(f"{shown:.8g}"), "unit": si.written}
                known = self.provenance.get(name, Provenance())
                if known.std is not None:
                    out[name]["std"] = float(f"{known.std:.4g}")
                if known.source is not None:
                    out[name]["source"] = known.source
            else:
                out[name] = value
        return out


def _quantity(entry: dict[str, Any], si: SI | None) -> tuple[float, Provenance]:
    """A number written with its unit and provenance, in SI."""
    unknown = set(entry) - {"value", "unit", "source", "std"}
    if si is None:
        raise InputError("takes no unit", mend="write the plain value")
    if unknown:
        raise InputError(f"unknown {sorted(map(str, unknown))}", mend="use value, unit, source and std")
    m = measure(str(entry.get("unit", si.written)), si.dimension)
    value, std, source = _number(entry, "value"), entry.get("std"), entry.get("source")
    if source is not None and not isinstance(source, str):
        raise InputError(f"source {source!r} is not text", mend="put it in quotes")
    if std is not None:
        std = m.factor * _number(entry, "std")
        if std < 0.0:
            raise InputError("std is negative", mend="give the standard deviation, or leave it out")
    return m.factor * value + m.offset, Provenance(source=source, std=std)


def _number(entry: dict[str, Any], name: str) -> float:
    # YAML 1.1 reads 1e-3 (no dot) as text, so text that is a number is taken too.
    given, number = entry[name], np.nan
    with suppress(ValueError, OverflowError):
        number = float(given) if isinstance(given, int | float | str) else np.nan
    if isinstance(given, bool) or not np.isfinite(number):
        raise InputError(f"{name} {given!r} is not a finite number", mend="correct that field")
    return number


def si_of(field: Any) -> SI | None:
    """The SI unit that a pydantic field is marked with, None for a plain one."""
    return next((item for item in field.metadata if isinstance(item, SI)), None)


LIVE_ZERO, FULL_SCALE = 4e-3, 20e-3
"""A, the currents at both ends of a transmitter's range (thesis A.1.1; IEC 60381-1)."""


class CurrentLoop(Section):
    """A 4 to 20 mA transmitter over a resistor into a converter (thesis A.1.1, eqs A.1 to A.4).

    `low` and `high` are what it measures at 4 and 20 mA, in the channel's SI unit; all else follows.
    """

    low: float
    high: float
    resistance: Annotated[float, si("ohm"), Field(gt=0)]
    converter_range: Annotated[float, si("V"), Field(gt=0)] = 10.0
    """The converter takes ± this voltage."""
    converter_bits: Annotated[int, Field(ge=4, le=32)] = 16
    reversible: bool = False
    """The transmitter is turned round for the other sign (quick couplings, thesis A.1.1), so the log
    holds both: the range ends at the converter's limit on either side, instead of at 0 mA below."""

    @model_validator(mode="after")
    def _rises(self) -> CurrentLoop:
        if self.high <= self.low:
            problem = f"high {self.high:g} (at 20 mA) is not above low {self.low:g} (at 4 mA)"
            raise InputError(problem, mend="give what the transmitter measures at both currents")
        return self

    @property
    def sensitivity(self) -> float:
        """Channel units per volt, eq. A.3."""
        return (self.high - self.low) / ((FULL_SCALE - LIVE_ZERO) * self.resistance)

    @property
    def offset(self) -> float:
        """What is taken off the voltage's reading, eq. A.4: a dead loop (0 mA) shows ``-offset``."""
        return self.sensitivity * LIVE_ZERO * self.resistance - self.low

    @property
    def resolution(self) -> float:
        """One step of the converter in channel units."""
        return abs(self.sensitivity) * 2.0 * self.converter_range / 2.0**self.converter_bits

    @property
    def largest(self) -> float:
        """Reading of the converter's highest code."""
        share = 1.0 - 2.0 ** (1 - self.converter_bits)
        return self.sensitivity * self.converter_range * share - self.offset

    @property
    def smallest(self) -> float:
        """Reading of a dead loop, or the mirror image of `largest` where the transmitter is turned."""
        return -self.largest if self.reversible else -self.offset


class Sensor(Section):
    """One channel as it is measured: value = gain·truth + zero, noise, then rounding."""

    noise: Annotated[float, Field(ge=0)] = 0.0
    """White noise, standard deviation in the channel's SI unit."""
    resolution: Annotated[float, Field(ge=0)] = 0.0
    """Smallest step; where it is not given, that of `lines` or of the `loop`."""
    zero: float = 0.0
    gain: Annotated[float, Field(gt=0)] = 1.0
    low: float | None = None
    high: float | None = None
    bandwidth_hz: Annotated[float | None, Field(gt=0)] = None
    tones: list[tuple[float, float]] = Field(default_factory=list)
    """Pairs of frequency (Hz) and amplitude (SI) that ride on the signal."""
    shaft_orders: list[tuple[float, float]] = Field(default_factory=list)
    """Pairs of order (waves per turn of the pump) and amplitude (SI): vibration that the sensor picks up."""
    lines: Annotated[int | None, Field(gt=0, le=10**9)] = None
    """Lines per turn of a rotary encoder; in quadrature each gives four counts (thesis A.1.2)."""
    loop: CurrentLoop | None = None
    source: str | None = None

    @model_validator(mode="after")
    def _step_follows(self) -> Sensor:
        # Not by assignment, which would validate again without end.
        if self.resolution == 0.0 and self.loop is not None:
            self.__dict__["resolution"] = self.loop.resolution
        elif self.resolution == 0.0 and self.lines is not None:
            self.__dict__["resolution"] = 2.0 * pi / (4 * self.lines)
        return self
