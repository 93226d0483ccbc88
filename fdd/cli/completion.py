"""What the shell offers for an option's value; nothing here is imported before it is asked for.

Names that a scenario has are written down here: loading the simulator takes longer than typing them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

DUTIES = (
    "standstill", "steps", "sines", "sweep", "prbs", "sawtooth", "strokes", "flight", "constant_speed",
    "one_way", "levels", "resting", "mission",
)  # fmt: skip
LOADS = ("none", "constant", "spring", "press", "hinge", "inertia", "gust", "changing", "throttle")
CONTROLS = ("position", "speed")


def begins(names: Iterable[str]) -> Callable[[str], list[str]]:
    """Completion from fixed names.

    Examples
    --------
    >>> begins(LOADS)("s")
    ['spring']
    """
    return lambda incomplete: [name for name in names if name.startswith(incomplete)]


def faults(incomplete: str) -> list[tuple[str, str]]:
    """Ids of the catalogue's faults, with their titles.

    Examples
    --------
    >>> faults("aer")
    [('aeration', 'air in the oil')]
    """
    from fdd.faults import CATALOGUE

    return [(name, fault.title) for name, fault in CATALOGUE.items() if name.startswith(incomplete)]


def units(incomplete: str) -> list[str]:
    """Shipped profiles; where none fits the shell offers files.

    Examples
    --------
    >>> units("axis")
    ['axis_a', 'axis_b']
    """
    from importlib import resources

    files = (resources.files("fdd") / "units").iterdir()
    names = sorted(f.name.removesuffix(".yaml") for f in files if f.name.endswith(".yaml"))
    return begins(names)(incomplete)
