"""Scenario files: a whole scenario as YAML (or the JSON that travels with a log)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fdd.bounds import MAX_SCENARIO_BYTES
from fdd.errors import InputError
from fdd.plant.scenario import Scenario
from fdd.yaml_reading import yaml_mapping, yaml_of, yaml_text

SCENARIO_SCHEMA = "fdd.scenario/1"
"""First line of the files that `scenario_yaml` writes; may be left out in others."""

_MEND = "give a YAML file with a scenario's fields: duration, duty, faults, partner, …"


def scenario_data(path: str | Path) -> dict[str, Any]:
    """The fields that a scenario file gives, not yet validated.

    Raises
    ------
    InputError : no such file, not YAML, or of another schema.
    """
    path = Path(path)
    text = yaml_text(path, "scenario", MAX_SCENARIO_BYTES, _MEND)
    data = yaml_mapping(text, path, "scenario", mend=_MEND)
    schema = data.pop("schema", SCENARIO_SCHEMA)
    if schema != SCENARIO_SCHEMA:
        raise InputError(f"schema {schema!r:.60} is not a scenario", where=path, mend=_MEND)
    return data


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file.

    Raises
    ------
    InputError : names the file, the field and what is allowed.
    """
    data = scenario_data(path)
    try:
        return Scenario(**data)
    except InputError as error:
        raise error.at(path) from None


def scenario_yaml(scenario: Scenario) -> str:
    """The whole scenario as YAML, defaults filled in; `load_scenario` gives the same one back.

    Examples
    --------
    >>> scenario_yaml(Scenario()).splitlines()[:2]
    ['schema: fdd.scenario/1', 'unit: axis_a']
    """
    plain = {"schema": SCENARIO_SCHEMA, **scenario.model_dump(mode="json")}
    return yaml_of(plain)
