"""``fdd schema``: the JSON Schema of what fdd writes and reads."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

import typer


class Kind(StrEnum):
    """What there is a schema of."""

    DIAGNOSIS = "diagnosis"
    COMPARISON = "comparison"
    TREND = "trend"
    MAP = "map"
    PROFILE = "profile"
    RECIPE = "recipe"
    SERVE = "serve"


def schema(kind: Annotated[Kind, typer.Argument(help="Of what.", show_default=False)]) -> None:
    """Print the JSON Schema of an answer, a comparison, a trend, a map, a profile, a recipe or serve.yaml."""
    import json

    print(json.dumps(schema_of(kind), indent=2, ensure_ascii=False))


def schema_of(kind: Kind) -> dict[str, Any]:
    """A JSON Schema (draft 2020-12), for checking files in editors and answers in other programs.

    It knows types, names and ranges of single values; what values must be to each other only fdd tells.
    YAML is meant as version 1.2 reads it, where ``2e8`` is a number.

    Examples
    --------
    >>> schema_of(Kind.DIAGNOSIS)["title"], "verdict" in schema_of(Kind.DIAGNOSIS)["required"]
    ('fdd.diagnosis/1', True)
    """
    if kind is Kind.DIAGNOSIS:
        from fdd.diagnosis.findings import Diagnosis

        made = Diagnosis.model_json_schema(mode="serialization")
    elif kind in (Kind.COMPARISON, Kind.TREND):
        from fdd.history.answers import Comparison, Life

        model = Comparison if kind is Kind.COMPARISON else Life
        made = model.model_json_schema(mode="serialization")
    elif kind is Kind.MAP:
        made = _map_schema()
    elif kind is Kind.PROFILE:
        from fdd.unit import Unit

        made = Unit.model_json_schema()
    elif kind is Kind.SERVE:
        from fdd.service.config import Serve

        made = Serve.model_json_schema()
    else:
        from fdd.campaign.recipe import Recipe

        made = Recipe.model_json_schema()
    # What the models' docstrings say is for Python.
    made.pop("description", None)
    title = made["properties"]["schema"]["const"]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **made, "title": title}


def _map_schema() -> dict[str, Any]:
    """Channels stand below ``channels:`` or at the top level."""
    from fdd.logs import ChannelMap
    from fdd.samples import CHANNELS

    made = ChannelMap.model_json_schema()
    source = {"$ref": "#/$defs/ChannelSource"}
    each = dict.fromkeys(CHANNELS, source)
    channels = {"type": "object", "properties": each, "additionalProperties": False}
    made["properties"] |= {"channels": channels, **each}
    del made["required"]
    return made
