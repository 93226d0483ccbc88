"""YAML files that users write: bounded, nothing but plain data, and one line where one is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from fdd.errors import InputError


def yaml_text(path: Path, kind: str, most: int, mend: str) -> str:
    """The text of a YAML file.

    Parameters
    ----------
    kind : what it should be, for people: ``"recipe"``.
    most : bytes; larger files are not read.
    mend : what to give instead where there is no such file.

    Raises
    ------
    InputError : no such file, too large, or not readable.

    Examples
    --------
    >>> yaml_text(Path("none.yaml"), "recipe", 1000, "give a YAML file")
    Traceback (most recent call last):
    ...
    fdd.errors.InputError: none.yaml: no such recipe; give a YAML file
    """
    try:
        if not path.is_file():
            raise InputError(f"no such {kind}", where=path, mend=mend)
        if path.stat().st_size > most:
            raise InputError(f"larger than {most} bytes, not a {kind}", where=path)
        return path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", where=path, mend=mend) from None


def yaml_mapping(
    text: str, where: str | Path, kind: str, *, mend: str | None = None, schema: str | None = None
) -> dict[Any, Any]:
    """Parse YAML text that is one mapping.

    Parameters
    ----------
    where : named in errors.
    kind : what it should be, for people.
    mend : what a right one looks like; where None, its first line with the schema.
    schema : what its key ``schema`` must be; None takes any.

    Raises
    ------
    InputError : names the line where it is not YAML; not a mapping; another schema.

    Examples
    --------
    >>> yaml_mapping("position: {column: [}", "map.yaml", "channel map")
    Traceback (most recent call last):
    ...
    fdd.errors.InputError: map.yaml: line 1: not valid YAML (expected the node content, but found '}')
    """
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: dates such as 2020-99-99
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}: " if mark is not None else ""
        problem = getattr(error, "problem", None) or (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"{place}not valid YAML ({problem})", where=where) from None
    if not isinstance(data, dict) or (schema is not None and data.get("schema") != schema):
        raise InputError(
            f"not a {kind}", where=where, mend=mend or f"its first line should be 'schema: {schema}'"
        )
    return data
