"""``fdd schema``: the JSON Schema of what fdd writes and reads."""

from __future__ import annotations

import json
from importlib import import_module
from typing import Annotated, Literal

from fdd.cli.options import argument

Kind = Literal["diagnosis", "comparison", "trend", "map", "profile", "recipe", "serve"]
MODELS: dict[Kind, str] = {
    "diagnosis": "fdd.diagnosis.findings:Diagnosis",
    "comparison": "fdd.history:Comparison",
    "trend": "fdd.history:Life",
    "map": "fdd.logs:ChannelMap",
    "profile": "fdd.unit:Unit",
    "recipe": "fdd.campaign.recipe:Recipe",
    "serve": "fdd.service.config:Serve",
}
ANSWERS = ("diagnosis", "comparison", "trend")


def schema(kind: Annotated[Kind, argument("Of what.")]) -> None:
    """Print the JSON Schema of an answer, a comparison, a trend, a map, a profile, a recipe or serve.yaml."""
    # It knows types, names and ranges of single values; what values must be to each other only fdd tells.
    # YAML is meant as version 1.2 reads it, where ``2e8`` is a number.
    from fdd.samples import CHANNELS

    module, name = MODELS[kind].split(":")
    model = getattr(import_module(module), name)
    # Answers are written, the others are read.
    made = model.model_json_schema(mode="serialization" if kind in ANSWERS else "validation")
    if kind == "map":  # channels stand below ``channels:`` or at the top level
        each = {name: {"$ref": "#/$defs/ChannelSource"} for name in CHANNELS}
        channels = {"type": "object", "properties": each, "additionalProperties": False}
        made["properties"] |= {"channels": channels, **each}
        del made["required"]
    # What the models' docstrings say is for Python.
    made.pop("description", None)
    title = made["properties"]["schema"]["const"]
    told = {"$schema": "https://json-schema.org/draft/2020-12/schema", **made, "title": title}
    print(json.dumps(told, indent=2, ensure_ascii=False))
