"""What names tell: which signal is a time, and the unit that stands in a name."""

from __future__ import annotations

import re

from fdd.bounds import LONGEST_NAME

_TIMES = {
    "time", "times", "t", "zeit", "temps", "stamp", "stamps", "timestamp", "timestamps", "zeitstempel",
    "zeitpunkt", "uhrzeit", "elapsed", "seconds", "sec", "sekunden", "clock", "datetime", "date", "datum",
    "date time", "log time", "logtime", "horodatage", "heure", "xtime", "master", "epoch", "tick", "ticks",
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


def bare_name(name: str) -> str:
    """The last part of a path, in small letters, without the unit that stands behind it.

    Examples
    --------
    >>> bare_name("daq/fast/Kolbenweg [mm]"), bare_name("cyl_mm"), bare_name("/daq.motor.w")
    ('kolbenweg', 'cyl', 'motor.w')
    """
    last = name.rsplit("/", 1)[-1]
    if name.startswith("/") and "." in last:
        last = last.split(".", 1)[1]
    last = last[-LONGEST_NAME:]
    last = _BRACKETED.sub("", last).strip() or last
    return (_SUFFIX.sub("", last).strip() or last).lower()


def unit_in_name(name: str) -> str | None:
    """The unit that stands in a signal's name, as it is written there.

    Examples
    --------
    >>> [unit_in_name(n) for n in ("Druck A [bar]", "cyl_mm", "w_rad_s", "position")]
    ['bar', 'mm', 'rad/s', None]
    """
    last = name.rsplit("/", 1)[-1] if "[" not in name and "(" not in name else name
    last = last[-LONGEST_NAME:]
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
