"""Which profile a log is diagnosed with."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.logs import Log
    from fdd.unit import Unit

DEFAULT_UNIT = "axis_a"


def unit_of(log: Log | None, given: str | None) -> tuple[Unit, str | None]:
    """The profile to diagnose with, and a note where nobody chose it.

    Parameters
    ----------
    log : its metadata may carry the profile of the unit that it was recorded on.
    given : name or path on the command line; goes first.

    Raises
    ------
    InputError : no such profile, or an unusable one.
    """
    from fdd.bounds import MAX_UNIT_BYTES
    from fdd.unit import Unit, shipped_units

    if given is not None:
        return Unit.load(given), None
    text = None if log is None else log.metadata.get("unit", {}).get("yaml")
    if text is not None and log is not None:
        where = f"{log.name}, unit profile in its metadata"
        if len(text) > MAX_UNIT_BYTES:
            raise InputError(f"larger than {MAX_UNIT_BYTES} bytes", where=where, mend="give --unit")
        try:
            return _parsed(text), None
        except InputError as error:
            raise InputError(error.problem, where=where, mend=error.mend) from None
    axis = None if log is None else log.axis
    taken = axis if axis in shipped_units() else DEFAULT_UNIT
    note = f"no unit profile given: taken for {taken} (give --unit, or make one with fdd identify)"
    return Unit.load(taken), note


@lru_cache(maxsize=4)
def _parsed(text: str) -> Unit:
    """The logs of one rig carry the same profile."""
    from fdd.unit import Unit

    return Unit.from_yaml(text, where="")
