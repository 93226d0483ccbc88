"""The faulty-plant simulator: hydraulics, drive, friction, oil, sensors, controllers, scenarios.

Here is what its inputs have in common: whatever is wrong with them is an `InputError`, and numbers may change
over a run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_serializer
from pydantic.functional_validators import AfterValidator, BeforeValidator, model_validator

from fdd.errors import InputError

Array = NDArray[np.float64]

Constants = Any
"""Constants of one run, SI: a NumPy record, which compiled functions read by name without copying."""

PERIOD = 1e-3
"""s, of controller and usual recording."""

Ranges = dict[str, tuple[float, float]]
"""Parameter to the range that a campaign draws it from."""


class Validated(BaseModel):
    """A model that refuses unknown fields; an `InputError` names the field, what is wrong with it and what is
    allowed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def __init__(self, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise _told(type(self), error) from None


V = TypeVar("V", bound=Validated)


def named(kinds: Mapping[str, type[V]], word: str, name: str) -> type[V]:
    """The kind of that name; an `InputError` lists all there are, as `word` calls them."""
    if name not in kinds:
        raise InputError(f"unknown {word} {name!r}", mend=f"use one of: {', '.join(kinds)}")
    return kinds[name]


def named_parameters(text: str, option: str) -> tuple[str, dict[str, object]]:
    """Split ``name:key=value,…``; a value with slashes is a list.

    Examples
    --------
    >>> named_parameters("steps:amplitude=0.03,hold=1", "--profile")
    ('steps', {'amplitude': '0.03', 'hold': '1'})
    """
    name, _, rest = text.partition(":")
    out: dict[str, object] = {}
    for part in filter(None, (p.strip() for p in rest.split(","))):
        key, equals, value = (p.strip() for p in part.partition("="))
        if not equals or not key or key in ("name", "self", "fault"):
            problem = f"{option} {text}: {part!r} is not a parameter"
            raise InputError(problem, mend="write NAME:key=value,key=value")
        if key in out:
            raise InputError(f"{option} {text}: {key} is given twice", mend="give it once")
        out[key] = value.split("/") if "/" in value else value
    return name.strip(), out


def _told(model: type[BaseModel], error: ValidationError) -> InputError:
    """The first thing that is wrong, as one line."""
    first = error.errors()[0]
    cause = first.get("ctx", {}).get("error")
    place = ".".join(str(part) for part in first["loc"])
    where = f"{model.__name__.lower()} {place}".strip()
    if isinstance(cause, InputError):
        return InputError(cause.problem, where=cause.where or where, mend=cause.mend)
    if first["type"] == "extra_forbidden":
        known = ", ".join(model.model_fields)
        return InputError("unknown parameter", where=where, mend=f"the parameters are: {known}")
    given = first.get("input")
    shown = f" (given {given!r:.60})" if isinstance(given, str | int | float | bool) else ""
    return InputError(f"{first['msg']}{shown}", where=where, mend="correct that value")


_MAX_POINTS = 10_000

_MEND = "write a number, or pairs [[time_s, value], …], or time:value/time:value"

Second = Annotated[float, Field(ge=0.0, le=3600.0)]
Value = Annotated[float, Field(allow_inf_nan=False)]


class Programme(Validated):
    """A value over time: constant before the first point and after the last, linear in between.

    `points` are (time in s, value), times ascending. Two points at the same time are a jump; from that time
    on the second one holds.
    """

    points: Annotated[tuple[tuple[Second, Value], ...], Field(min_length=1, max_length=_MAX_POINTS)]

    @model_validator(mode="after")
    def _ascending(self) -> Programme:
        times = [t for t, _ in self.points]
        for k in range(1, len(times)):
            if times[k] < times[k - 1]:
                problem = f"time {times[k]:g} s comes after {times[k - 1]:g} s"
                raise InputError(problem, mend="sort the points by time")
            if k > 1 and times[k] == times[k - 2]:
                raise InputError(f"three points at {times[k]:g} s", mend="a jump takes two")
        return self

    @model_serializer
    def _plain(self) -> float | list[list[float]]:
        """As users write it: a number where there is one point."""
        return self.points[0][1] if len(self.points) == 1 else [list(p) for p in self.points]

    def over(self, time: Array) -> Array:
        """The value at each time, (n,) for (n,) seconds."""
        if len(self.points) == 1:
            return np.full(np.shape(time), self.points[0][1])
        times, values = np.array(self.points).T
        before = np.searchsorted(times, time, side="right") - 1
        left = np.clip(before, 0, times.size - 2)
        length = times[left + 1] - times[left]
        share = np.divide(time - times[left], length, out=np.ones(np.shape(time)), where=length > 0.0)
        share = np.clip(share, 0.0, 1.0)
        a, b = values[left], values[left + 1]
        # Two products meet both ends exactly; rounding must not lead beyond them.
        return np.clip((1.0 - share) * a + share * b, np.minimum(a, b), np.maximum(a, b))

    @property
    def least(self) -> float:
        """Smallest value that it ever has."""
        return min(v for _, v in self.points)

    @property
    def most(self) -> float:
        """Largest value that it ever has."""
        return max(v for _, v in self.points)


def programme(given: Any) -> Programme:
    """A programme from a number, pairs or text such as ``0:0/10:1``, or an `InputError`."""
    if isinstance(given, Programme):
        return given
    if isinstance(given, str) and ("/" in given or ":" in given):
        given = given.split("/")
    if isinstance(given, bool) or not isinstance(given, int | float | str | Sequence):
        raise InputError(f"{given!r:.60} is no programme", mend=_MEND)
    pairs = [(0.0, given)] if isinstance(given, int | float | str) else [_pair(point) for point in given]
    try:
        return Programme(points=tuple(pairs))
    except InputError as error:  # the field that it is for says more than "programme"
        raise InputError(error.problem, mend=error.mend) from None


def _pair(point: Any) -> tuple[Any, Any]:
    parts = point.split(":") if isinstance(point, str) else point
    if not isinstance(parts, list | tuple) or len(parts) != 2:
        raise InputError(f"{point!r:.60} is no pair of time and value", mend=_MEND)
    return parts[0], parts[1]


def _share(found: Programme) -> Programme:
    if found.least < 0.0 or found.most > 1.0:
        problem = f"{found.least if found.least < 0.0 else found.most:g} is out of range"
        raise InputError(problem, mend="use 0 (shut, off) to 1 (fully open, on)")
    return found


AnyProgramme = Annotated[Programme, BeforeValidator(programme)]
"""Field of a model that takes all that `programme` reads."""

ShareProgramme = Annotated[Programme, BeforeValidator(programme), AfterValidator(_share)]
"""The same with values from 0 to 1: openings of valves, power."""

SHUT = Programme(points=((0.0, 0.0),))
"""Zero, all the time."""

FULL = Programme(points=((0.0, 1.0),))
"""One, all the time."""
