"""The API's description, made of its models and one table."""

from __future__ import annotations

from typing import Any

from pydantic.json_schema import models_json_schema

import fdd
from fdd.service.http.answers import ALL, BODIES

REF = "#/components/schemas/{model}"
_STATES = "UNACK, ACKED, RTNUN, SHELVED, OUT_OF_SERVICE (those that stand, if not given), NORMAL, or all"
# method, path, what it does, answer, body, query: name -> (type, what)
_TABLE: list[tuple[str, str, str, Any, str | None, dict[str, tuple[str, str]]]] = [
    ("get", "/api/axes", "Every axis as it stands now", {"axes": "AxisStatus"}, None, {}),
    ("get", "/api/axes/{name}", "One axis with its last ten minutes", "AxisDetail", None,
     {"points": ("integer", "stretches that signals are given in, 10 to 6000")}),
    ("get", "/api/axes/{name}/trend", "A quantity over the axis's life", "Trend", None,
     {"quantity": ("string", "e.g. leakage"), "level": ("string", "minute, hour or day"),
      "since": ("number", "Unix seconds")}),
    ("get", "/api/alarms", "Alarms, the newest first", {"alarms": "Alarm"}, None,
     {"state": ("string", _STATES), "limit": ("integer", "1 to 10000")}),
    ("post", "/api/alarms/{id}/acknowledge", "Acknowledge an alarm", "Alarm", "Note", {}),
    ("post", "/api/alarms/{id}/shelve", "Shelve an alarm for some minutes", "Alarm", "Shelf", {}),
    ("post", "/api/alarms/{id}/unshelve", "Take it off the shelf", "Alarm", "Note", {}),
    ("post", "/api/alarms/{id}/out-of-service", "Take out of service, or back", "Alarm", "OutOfService", {}),
    ("get", "/api/audit", "What was done by whom, the newest first", {"records": "AuditRecord"}, None,
     {"alarm": ("integer", "of one alarm"), "limit": ("integer", "1 to 10000")}),
    ("get", "/api/health", "Whether the service works; without a token the status alone", "Health", None, {}),
    ("get", "/api/events", "Events as they happen, resumed by Last-Event-ID", "text/event-stream", None, {}),
    ("post", "/api/diagnose", "Diagnose a log of any format", "Diagnosis", "application/octet-stream",
     {"name": ("string", "what the log is called; or the header x-fdd-name"),
      "unit": ("string", "profile by name"), "map": ("string", "channel map by name")}),
    ("get", "/api/session", "Who is calling", "Session", None, {}),
    ("post", "/api/login", "A token for the page's cookie", "Session", "Login", {}),
    ("post", "/api/logout", "End the page's session", {}, None, {}),
    ("get", "/metrics", "Counts and figures for Prometheus", "text/plain", None, {}),
]  # fmt: skip


def document() -> dict[str, Any]:
    """The OpenAPI 3.1 document.

    Examples
    --------
    >>> made = document()
    >>> made["openapi"], "/api/axes/{name}/trend" in made["paths"]
    ('3.1.0', True)
    """
    _, answers = models_json_schema([(m, "serialization") for m in ALL], ref_template=REF)
    _, bodies = models_json_schema([(m, "validation") for m in BODIES], ref_template=REF)
    schemas = {**answers["$defs"], **bodies["$defs"], "Login": _object({"token": {"type": "string"}})}
    paths: dict[str, Any] = {}
    for method, path, what, answered, body, query in _TABLE:
        paths.setdefault(path, {})[method] = _operation(path, what, answered, body, query)
    return {
        "openapi": "3.1.0",
        "info": {"title": "fdd serve", "version": fdd.__version__},
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
        "security": [{"token": []}, {}],
    }


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties)}


def _schema(answered: Any) -> dict[str, Any]:
    if isinstance(answered, dict):
        return _object({k: {"type": "array", "items": _schema(v)} for k, v in answered.items()})
    return {"$ref": REF.format(model=answered)}


def _content(what: Any) -> dict[str, Any]:
    if isinstance(what, str) and "/" in what:
        return {what: {"schema": {"type": "string"}}}
    return {"application/json": {"schema": _schema(what)}}


def _operation(
    path: str, what: str, answered: Any, body: str | None, query: dict[str, tuple[str, str]]
) -> dict[str, Any]:
    parameters: list[dict[str, Any]] = [
        {"name": name, "in": "path", "required": True, "schema": {"type": kind}}
        for name, kind in (("name", "string"), ("id", "integer"))
        if f"{{{name}}}" in path
    ]
    parameters += [
        {"name": name, "in": "query", "schema": {"type": kind}, "description": text}
        for name, (kind, text) in query.items()
    ]
    made: dict[str, Any] = {
        "summary": what,
        "parameters": parameters,
        "responses": {
            "200": {"description": what, "content": _content(answered)},
            "default": {"description": "refused", "content": _content("Problem")},
        },
    }
    if body is not None:
        made["requestBody"] = {"required": True, "content": _content(body)}
    return made
