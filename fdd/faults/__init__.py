"""The fault catalogue, one module a fault, from which everything else takes ids, families and meanings.

A module holds a fault's words, its figures of severity 1, what it changes in the plant and how it shows in
the balances, both by name: plant and diagnosis read it and never each other. Any module beside `entry`,
`effect` and `signature` is a fault and is found by itself.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from fdd.errors import InputError
from fdd.faults.effect import Effect, Figure
from fdd.faults.entry import FAMILIES, Fault
from fdd.faults.signature import Healthy, Signature

__all__ = [
    "CATALOGUE",
    "FAMILIES",
    "PROFILES",
    "Effect",
    "Fault",
    "Figure",
    "Healthy",
    "Signature",
    "fault",
    "faults_of",
]

_PARTS = {"effect", "entry", "signature"}


def _collected() -> dict[str, Fault]:
    names = (module.name for module in iter_modules(__path__) if module.name not in _PARTS)
    found: list[Fault] = [import_module(f"{__name__}.{name}").FAULT for name in names]
    return {f.id: f for f in sorted(found, key=lambda f: (FAMILIES.index(f.family), f.rank, f.id))}


CATALOGUE: dict[str, Fault] = _collected()
"""Id to entry, in the contract's order."""

PROFILES = ("step", "ramp", "intermittent")
"""How a fault comes: at once, growing over a time, or on and off."""


def fault(name: str) -> Fault:
    """Look a fault up.

    Raises
    ------
    InputError : unknown id; the line lists the known ones.
    """
    found = CATALOGUE.get(name)
    if found is None:
        raise InputError(f"unknown fault {name!r}", mend=f"the catalogue has: {', '.join(CATALOGUE)}")
    return found


def faults_of(family: str) -> tuple[str, ...]:
    """Ids of a family's faults, in the catalogue's order."""
    return tuple(f.id for f in CATALOGUE.values() if f.family == family)
