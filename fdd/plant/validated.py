"""Base of the plant's input models: whatever is wrong with them is an `InputError`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from fdd.errors import InputError

Ranges = dict[str, tuple[float, float]]
"""Parameter to the range that a campaign draws it from."""


class Validated(BaseModel):
    """A model that refuses unknown fields and tells what is wrong in one line.

    Raises
    ------
    InputError : names the field, what is wrong with it and what is allowed.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    def __init__(self, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise _told(type(self), error) from None

    @classmethod
    def model_validate(cls, *args: Any, **options: Any) -> Self:
        """As pydantic's, but raises `InputError`."""
        try:
            return super().model_validate(*args, **options)
        except ValidationError as error:
            raise _told(cls, error) from None


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
            raise InputError(
                f"{option} {text}: {part!r} is not a parameter", mend="write NAME:key=value,key=value"
            )
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
