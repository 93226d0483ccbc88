"""What names tell: which signal is a time, and the unit that stands in a name."""

from __future__ import annotations

import re

from fdd.bounds import LONGEST_NAME
from fdd.measures import MEASURES, find_measure

_TIMES = {
    "time", "times", "t", "zeit", "temps", "stamp", "stamps", "timestamp", "timestamps", "zeitstempel",
    "zeitpunkt", "uhrzeit", "elapsed", "seconds", "sec", "sekunden", "clock", "datetime", "date", "datum",
    "tempo", "tiempo", "tid", "tijd", "date time", "log time", "logtime", "horodatage", "heure",
    "xtime", "master", "epoch", "tick", "ticks",
}  # fmt: skip
_SUFFIX = re.compile(
    r"[_ .\-/]+(m|cm|mm|um|in|s|ms|us|ns|rad|deg|rev|rpm|hz|pa|kpa|mpa|bar|mbar|psi|n|kn|lbf|a|ma|v|mv|c|f|k"
    r"|degc|degf|rad_s|rads|deg_s|rps|radps|degps|barg|bara|psig|psia|pct)$",
    re.IGNORECASE,
)
_BRACKETED = re.compile(r"[\[(]\s*([^\[\]()]{1,24}?)\s*[\])]?[\])]\s*$|[,/]\s*([^\s,/]{1,12})\s*$")
_WRITTEN = {
    "pa": "Pa", "kpa": "kPa", "mpa": "MPa", "n": "N", "kn": "kN", "a": "A", "ma": "mA", "v": "V", "mv": "mV",
    "c": "degC", "f": "degF", "k": "K", "degc": "degC", "degf": "degF", "rad_s": "rad/s", "rads": "rad/s",
    "deg_s": "deg/s", "rps": "rev/s", "radps": "rad/s", "degps": "deg/s", "pct": "%", "hz": "Hz",
}  # fmt: skip


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
    if rate := _RATE.search(last):
        return rate[1]
    found = _BRACKETED.search(last)
    if found is not None and "[" in last + "[" and (text := found.group(1)):
        return text
    suffix = _SUFFIX.search(last)
    if suffix is None:
        return None
    text = suffix.group(1)
    return _WRITTEN.get(text.lower(), text.lower())


def is_time_name(name: str) -> bool:
    """Whether a signal of this name is a time.

    Examples
    --------
    >>> is_time_name("Zeit [s]"), is_time_name("t_ms"), is_time_name("T_oil")
    (True, True, False)
    """
    return bare_name(name).strip("_ ") in _TIMES


def time_unit(name: str, unit: str | None, step: float) -> str:
    """The unit of a time: the file's, the one in its name, or one by which its step is that of a log.

    Parameters
    ----------
    name, unit : of the signal, as the file has them. step : usual one between rows, in that unit.

    Examples
    --------
    >>> time_unit("Zeit [ms]", None, 1.0), time_unit("t", None, 1.0), time_unit("t", None, 0.001)
    ('ms', 'ms', 's')
    """
    for said in (unit, unit_in_name(name)):
        if said in MEASURES and find_measure(said, "time") is not None:
            return said
    return next((u for u in ("s", "ms", "us", "ns") if step * MEASURES[u].factor <= 0.0201), "s")
