"""The options of ``fdd simulate`` that make a scenario, over those of a scenario file."""

from __future__ import annotations

from typing import Any

from fdd.errors import InputError

Data = dict[str, Any]

CONNECT = {"connect_1": "line_1", "connect_2": "line_2", "connect_flow": "flow"}
"""Names of the connect valves on the command line, and in a scenario."""


def named_parameters(text: str, option: str) -> tuple[str, dict[str, object]]:
    """Split ``name:key=value,…``; a value with slashes is a list.

    Raises
    ------
    InputError : a part that is not ``key=value``.

    Examples
    --------
    >>> named_parameters("steps:amplitude=0.03,hold=1", "--profile")
    ('steps', {'amplitude': '0.03', 'hold': '1'})
    """
    name, _, rest = text.partition(":")
    out: dict[str, object] = {}
    for part in filter(None, (p.strip() for p in rest.split(","))):
        key, equals, value = (p.strip() for p in part.partition("="))
        if not equals or not key or key in ("name", "self"):
            raise InputError(
                f"{option} {text}: {part!r} is not a parameter", mend="write NAME:key=value,key=value"
            )
        if key in out:
            raise InputError(f"{option} {text}: {key} is given twice", mend="give it once")
        out[key] = value.split("/") if "/" in value else value
    return name.strip(), out


def section(data: Data, *names: str) -> Data:
    """A part of the scenario to write into; made where it is not there.

    Raises
    ------
    InputError : the file has something else there than fields.
    """
    for name in names:
        inner = data.get(name)
        if inner is not None and not isinstance(inner, dict):
            raise InputError(f"{name} {inner!r:.60} has no fields", where="scenario", mend="write its fields")
        # A copy: what was read from the file stays as it was.
        data[name] = dict(inner or {})
        data = data[name]
    return data


def set_motion(data: Data, profile: str | None, load: str | None, control: str | None) -> None:
    """Take ``--profile``, ``--load`` and ``--control``, where they are given.

    Raises
    ------
    InputError : unknown name or parameter, value out of range.
    """
    from fdd.plant.duty import duty_named
    from fdd.plant.load import load_named

    if profile is not None:
        name, parameters = named_parameters(profile, "--profile")
        data["duty"] = duty_named(name, **parameters).model_dump()
        if control is None and name == "constant_speed":
            control = "speed"
    if load is not None:
        name, parameters = named_parameters(load, "--load")
        data["load"] = load_named(name, **parameters).model_dump()  # type: ignore[arg-type]
    if control is not None:
        section(data, "control")["mode"] = control


def set_partner(data: Data, text: str) -> None:
    """Take ``--partner UNIT:drive=still,power=0``.

    Raises
    ------
    InputError : unknown parameter.
    """
    from fdd.plant.scenario import Partner

    name, parameters = named_parameters(text, "--partner")
    known = [field for field in Partner.model_fields if field not in ("unit", "circuit", "duty")]
    for key in parameters:
        if key not in known:
            raise InputError(
                f"--partner {text}: unknown parameter {key}",
                mend=f"use {' or '.join(known)}; its valves are --valve b.NAME=OPENING",
            )
    section(data, "partner").update({"unit": name, **parameters})


def set_valve(data: Data, text: str) -> None:
    """Take ``--valve connect_1=1``, ``--valve throttle=0:0/5:1`` or ``--valve b.throttle=0.5``.

    ``b.`` is the partner; nothing, or ``a.``, the first axis. Besides openings the other numbers of a
    circuit are taken as well, and those of its external accumulators, which connects them.

    Raises
    ------
    InputError : unknown valve or axis; the partner's, but there is none.
    """
    from fdd.plant.circuit import Circuit, ExternalAccumulators

    where = f"--valve {text}"
    key, equals, value = (part.strip() for part in text.partition("="))
    axis, _, name = key.rpartition(".")
    circuit = [field for field in Circuit.model_fields if field != "accumulators"]
    accumulators = list(ExternalAccumulators.model_fields)
    if not equals or not value or axis not in ("", "a", "b"):
        raise InputError("not a valve", where=where, mend="write NAME=OPENING, or b.NAME=OPENING")
    if name in CONNECT and not axis:
        section(data, "connect")[CONNECT[name]] = value
        return
    if name not in (*circuit, *accumulators):
        known = ", ".join((*CONNECT, *circuit, *accumulators))
        raise InputError(f"unknown valve {key!r}", where=where, mend=f"the valves are: {known}")
    if axis == "b" and data.get("partner") is None:
        raise InputError("there is no partner", where=where, mend="give --partner, such as --partner axis_b")
    path = ("partner", "circuit") if axis == "b" else ("circuit",)
    section(data, *path, *(("accumulators",) if name in accumulators else ()))[name] = value
