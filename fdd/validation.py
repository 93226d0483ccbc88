"""What pydantic finds wrong with a file of a user's, in one line."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from fdd.errors import InputError
from fdd.near_misses import did_you_mean


def input_error(error: ValidationError, where: str | Path, mend: str | None) -> InputError:
    """The first thing that is wrong; an unknown key goes before the one that is missing for it.

    Parameters
    ----------
    where : the file. mend : what helps, where the error itself does not say.
    """
    found = error.errors(include_url=False)
    first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
    place, cause = [str(part) for part in first["loc"]], first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        place, problem, mend = [*place, cause.where or ""], cause.problem, cause.mend or mend
    elif first["type"] == "extra_forbidden":
        absent = [str(e["loc"][-1]) for e in found if e["type"] == "missing"]
        problem = f"unknown key{did_you_mean(place[-1], absent)}"
    else:
        problem = str(first["msg"]).removeprefix("Value error, ")
    told = ".".join(filter(None, place))
    return InputError(f"{told}: {problem}" if told else problem, where=where, mend=mend)
