"""What names tell: which signal is a time, and the unit that stands in a name."""

from __future__ import annotations

import re

import numpy as np

from fdd.bounds import LONGEST_NAME
from fdd.measures import MEASURES, find_measure
from fdd.samples import Column

_TIMES = {
    "time", "times", "t", "zeit", "temps", "stamp", "stamps", "timestamp", "timestamps", "zeitstempel",
    "zeitpunkt", "uhrzeit", "elapsed", "seconds", "sec", "sekunden", "clock", "datetime", "date", "datum",
    "tempo", "tiempo", "tid", "tijd", "date time", "log time", "logtime", "horodatage", "heure",
    "xtime", "master", "epoch", "tick", "ticks",
}  # fmt: skip
_UNITS = {
    **{u.lower(): u for u in (
        "m", "cm", "mm", "um", "in", "s", "ms", "us", "ns", "rad", "deg", "rev", "rpm", "Hz", "Pa", "kPa",
        "MPa", "bar", "mbar", "barg", "bara", "psi", "psig", "psia", "N", "kN", "lbf", "A", "mA", "V", "mV",
        "degC", "degF",
    )},
    "c": "degC", "f": "degF", "k": "K", "rad_s": "rad/s", "rads": "rad/s", "radps": "rad/s", "deg_s": "deg/s",
    "degps": "deg/s", "rps": "rev/s", "pct": "%",
}  # fmt: skip
"""What ends a name, in small letters, and the unit that it stands for."""
_SUFFIX = re.compile(rf"[_ .\-/]+({'|'.join(_UNITS)})$", re.IGNORECASE)
_BRACKETED = re.compile(r"[\[(]\s*([^\[\]()]{1,24}?)\s*[\])]?[\])]\s*$|[,/]\s*([^\s,/]{1,12})\s*$")
_RATE = re.compile(r"[\s,/]+((?:1|u|umdr|tr|r|rev|rad|deg|°|m|mm)/(?:min|s))\s*$", re.IGNORECASE)
"""A unit with a slash, which is none of a path."""


def path_parts(name: str) -> tuple[str, str]:
    """What stands before a signal's own name in a path, and the name.

    Examples
    --------
    >>> path_parts("daq/fast/Drehzahl [1/min]"), path_parts("Drehzahl (1/min)"), path_parts("w rad/s")
    (('daq/fast', 'Drehzahl [1/min]'), ('', 'Drehzahl (1/min)'), ('', 'w rad/s'))
    """
    rate, depth = _RATE.search(name[-LONGEST_NAME:]), 0
    for at in range(len(name) - (len(rate[0]) if rate else 0) - 1, -1, -1):
        depth = max(0, depth + (name[at] in "])") - (name[at] in "[("))
        if name[at] == "/" and not depth and name[at - 1 : at] != " ":  # p / bar
            return name[:at], name[at + 1 :]
    return "", name


def bare_name(name: str) -> str:
    """The last part of a path, in small letters, without the unit that stands behind it.

    Examples
    --------
    >>> [bare_name(n) for n in ("daq/fast/Kolbenweg [mm]", "p A [bar]", "n / 1/min", "/daq.motor.w")]
    ['kolbenweg', 'p a', 'n', 'motor.w']
    """
    last = path_parts(name)[1]
    if name.startswith("/") and "." in last:
        last = last.split(".", 1)[1]
    last = last[-LONGEST_NAME:]
    # One of them: the A of "Druck A [bar]" is a port.
    unit = next((u for u in (_RATE, _BRACKETED) if u.search(last)), _SUFFIX)
    return (unit.sub("", last).strip(" /") or last).lower()


def unit_in_name(name: str) -> str | None:
    """The unit that stands in a signal's name, as it is written there.

    Examples
    --------
    >>> [unit_in_name(n) for n in ("Druck A [bar]", "cyl_mm", "w_rad_s", "position")]
    ['bar', 'mm', 'rad/s', None]
    """
    last = path_parts(name)[1][-LONGEST_NAME:]
    for written in (_RATE, _BRACKETED):
        if (found := written.search(last)) and found[1]:
            return found[1]
    suffix = _SUFFIX.search(last)
    return None if suffix is None else _UNITS.get(suffix[1].lower(), suffix[1].lower())


def is_time_name(name: str) -> bool:
    """Whether a signal of this name is a time.

    Examples
    --------
    >>> is_time_name("Zeit [s]"), is_time_name("t_ms"), is_time_name("T_oil")
    (True, True, False)
    """
    return bare_name(name).strip("_ ") in _TIMES


def grows(values: Column) -> bool:
    """Whether (n,) values never fall, but for a few rows, as a clock does not."""
    steps = np.diff(values[np.isfinite(values)])
    return steps.size > 0 and float((steps >= 0.0).mean()) >= 0.95


def time_unit(name: str, unit: str | None, step: float) -> str:
    """The unit of a time: the file's, the one in its name, or one by which its step is that of a log.

    A log is not slower than 50 Hz. `step`: usual one between rows, in that unit.

    Examples
    --------
    >>> time_unit("Zeit [ms]", None, 1.0), time_unit("t", None, 1.0), time_unit("t", None, 0.001)
    ('ms', 'ms', 's')
    """
    for said in (unit, unit_in_name(name)):
        if said and find_measure(said, "time") is not None:
            return said
    return next((u for u in ("s", "ms", "us", "ns") if step * MEASURES[u].factor <= 0.0201), "s")
