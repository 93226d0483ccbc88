"""Sections of a profile: numbers that carry their unit, source and spread.

Every number may be written plain (then it is in the field's SI unit) or with its provenance, which is kept
and written back: ``{value: 35, unit: bar, source: data sheet, std: 2}``.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

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
