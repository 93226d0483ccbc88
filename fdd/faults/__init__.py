"""The fault catalogue, one module a fault, from which everything else takes ids, families and meanings.

A module holds a fault's words, its figures of severity 1, what it changes in the plant and how it shows in
the balances, both by name: plant and diagnosis read it and never each other. Any module beside `entry` is a
fault and is found by itself, and so is what an installed package names as an entry point of the group
``fdd.faults`` (docs/extending.md).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib import import_module
from pkgutil import iter_modules

from fdd.errors import InputError
from fdd.faults.entry import FAMILIES, Amount, Columns, Effect, Fault, Figure, Healthy, Signature
from fdd.packages import FAULTS, additions, left_out

__all__ = [
    "ADDED_BY", "CATALOGUE", "FAMILIES", "PROFILES", "Amount", "Columns", "Effect", "Fault", "Figure",
    "Healthy", "Signature", "fault", "unusable",
]  # fmt: skip


def _shipped() -> list[Fault]:
    names = (module.name for module in iter_modules(__path__) if module.name != "entry")
    return [import_module(f"{__name__}.{name}").FAULT for name in names]


def _collected(shipped: list[Fault]) -> tuple[dict[str, Fault], dict[str, str]]:
    """The catalogue, and which package each fault that is not fdd's own is of."""
    found = {f.id: f for f in shipped}
    added_by: dict[str, str] = {}
    for addition in additions(FAULTS):
        try:
            entry = addition.load()
            problem = _problem(entry, found)
            if problem:
                raise addition.wrong(problem)
        except InputError as error:
            left_out(error)
            continue
        found[entry.id] = entry
        added_by[entry.id] = addition.package
    ordered = sorted(found.values(), key=lambda f: (FAMILIES.index(f.family), f.id in added_by, f.rank, f.id))
    return {f.id: f for f in ordered}, added_by


def _problem(entry: object, others: dict[str, Fault]) -> str:
    """Why a package's entry cannot stand in the catalogue beside the others; empty where it can."""
    if not isinstance(entry, Fault):
        return f"is a {type(entry).__name__}, not a Fault"
    if not re.fullmatch(r"[a-z][a-z0-9_]*", entry.id):
        return f"the id {entry.id!r} is not of small letters, digits and underscores"
    if entry.id in others or entry.id in FAMILIES:
        return f"the id {entry.id!r} is taken"
    families = [f for f in FAMILIES if f not in ("healthy", "unknown")]
    if entry.family not in families:
        return f"the family {entry.family!r} is none of {', '.join(families)}"
    if entry.in_measurement:
        return "is a fault of a sensor, which needs code in fdd.plant.sensors"
    if not entry.signatures and not entry.effects:
        return "has neither effects nor signatures"
    taken = {figure.name for other in others.values() for figure in other.figures}
    twice = [figure.name for figure in entry.figures if figure.name in taken]
    return f"the figure {twice[0]!r} is taken" if twice else ""


CATALOGUE, ADDED_BY = _collected(_shipped())
"""Id to entry, in the contract's order, within a family first what is shipped; and id to name and version of
the package, of those that an installed package adds."""

PROFILES = ("step", "ramp", "intermittent", "exponential", "random", "load", "heat")
"""How a fault comes: at once, growing over a time, on and off, growing ever quicker, on and off at random,
with the load, or as the oil warms."""


def unusable(name: str, problem: str, has: Iterable[str]) -> InputError:
    """That a fault of the catalogue names what plant or balances do not have, with the package it is of."""
    return InputError(
        f"fault {name!r}: {problem}", where=f"package {ADDED_BY.get(name, 'fdd')}",
        mend=f"there are: {', '.join(has)}",
    )  # fmt: skip


def fault(name: str) -> Fault:
    """Look a fault up; the `InputError` of an unknown id lists the known ones."""
    if name not in CATALOGUE:
        raise InputError(f"unknown fault {name!r}", mend=f"the catalogue has: {', '.join(CATALOGUE)}")
    return CATALOGUE[name]
