"""Names with paths, and what they tell: times and units; and arrays in groups as signals with clocks.

Of HDF5, MATLAB, TDMS, MDF and sheets of a workbook, arrays of one length in one group share the clock that
stands beside them under a name like ``time`` or ``stamp``. A group that holds nothing but a value, its time
and its unit is one signal, called as the group.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import LONGEST_NAME
from fdd.errors import InputError
from fdd.logs.formats import LogFile, Signal, require_size
from fdd.logs.formats.text_layout import seconds_since
from fdd.measures import MEASURES, find_measure, measure
from fdd.samples import Column

_TIMES = {
    "time", "times", "t", "zeit", "temps", "stamp", "stamps", "timestamp", "timestamps", "zeitstempel",
    "zeitpunkt", "uhrzeit", "elapsed", "seconds", "sec", "sekunden", "clock", "datetime", "date", "datum",
    "tempo", "tiempo", "tid", "tijd", "date time", "log time", "logtime", "horodatage", "heure", "xtime",
    "master", "epoch", "tick", "ticks",
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
_VALUES = ("value", "values", "data", "y", "signal", "samples")
_PERIODS = ("dt", "ts", "period", "sample_time", "sampletime")
_RATES = ("fs", "rate", "sample_rate", "samplerate")


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
    """The unit of a time: the file's, the one in its name, or one by which its usual step is that of a log,
    which is not slower than 50 Hz.

    Examples
    --------
    >>> time_unit("Zeit [ms]", None, 1.0), time_unit("t", None, 1.0), time_unit("t", None, 0.001)
    ('ms', 'ms', 's')
    """
    for said in (unit, unit_in_name(name)):
        if said and find_measure(said, "time") is not None:
            return said
    return next((u for u in ("s", "ms", "us", "ns") if step * MEASURES[u].factor <= 0.0201), "s")


@dataclass(frozen=True)
class Leaf:
    """An array of a group: its length, how it is loaded, and its unit."""

    size: int
    load: Callable[[], NDArray[np.generic]]
    unit: str | None = None


@dataclass
class Group:
    """Arrays by name, single numbers, and the unit of arrays that have none and are no time."""

    leaves: dict[str, Leaf] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)
    unit: str | None = None

    def period(self) -> float | None:
        """s; by a single number that is called a period or a rate."""
        for name, value in self.scalars.items():
            if name.lower() in _PERIODS and 0.0 < value < 1e3:
                return value
            if name.lower() in _RATES and 1e-3 < value < 1e9:
                return 1.0 / value
        return None


@dataclass
class TreeFile(LogFile):
    """Signals that are loaded one by one.

    `leaves`: by the signals' names, and the clocks' columns too. `clocks`: clock to the name of the leaf of
    its stamps. `periods`: clock to (s, rows), where the file gives a rate in place of stamps.
    """

    leaves: dict[str, Leaf] = field(default_factory=dict)
    clocks: dict[str, str] = field(default_factory=dict)
    periods: dict[str, tuple[float, int]] = field(default_factory=dict)

    def read(self, names: Iterable[str]) -> dict[str, Column]:
        return {name: self._loaded(name) for name in dict.fromkeys(names)}

    def stamps(self, clock: str) -> Column | None:
        if clock in self.periods:
            period, rows = self.periods[clock]
            return np.arange(rows, dtype=np.float64) * period
        if clock not in self.clocks:
            return None
        name = self.clocks[clock]
        # Several rates without a unit count in one: the fastest tells which.
        values, last, unit = self._loaded(name), name.rsplit("/", 1)[-1], self.leaves[name].unit
        alike = {name} if unit else {n for n in self.clocks.values() if n.rsplit("/", 1)[-1] == last}
        steps = (np.diff(values if n == name else self._loaded(n)) for n in alike)
        step = min(float(np.median(s)) if s.size else np.inf for s in steps)
        return values * measure(time_unit(name, unit, step), "time").factor

    def _loaded(self, name: str) -> Column:
        raw = np.asarray(self.leaves[name].load()).reshape(-1)
        if raw.dtype.kind == "M":
            values, first = seconds_since(raw)
            self.start_ns = self.start_ns or first
            return values
        if raw.dtype.kind not in "fiub":
            raise InputError(f"column {name!r} holds text, not numbers", where=self.path)
        return raw.astype(np.float64)


def tree_file(path: Path, groups: Mapping[str, Group]) -> TreeFile:
    """Signals of arrays by group, whose name is its path, "" for the top. An InputError where there are no
    arrays of more than one number, or more than is read."""
    log = TreeFile(path)
    for group, content in groups.items():
        prefix = f"{group}/" if group else ""
        by_size: dict[int, dict[str, Leaf]] = {}
        for name, leaf in content.leaves.items():
            if leaf.size > 1 and name:
                unit = leaf.unit or (content.unit if name.lower() not in ("time", "t") else None)
                by_size.setdefault(leaf.size, {})[name] = replace(leaf, unit=unit)
        for size, leaves in by_size.items():
            times = [n for n in leaves if is_time_name(n)]
            values = [n for n in leaves if n not in times]
            clock = group if len(by_size) == 1 else f"{group}#{size}"
            log.leaves |= {prefix + n: leaf for n, leaf in leaves.items()}
            if times:
                log.clocks[clock] = prefix + times[0]
            elif (period := content.period()) is not None:
                log.periods[clock] = (period, size)
            if group and len(values) == 1 and times and values[0].lower() in _VALUES:
                log.leaves[group] = leaves[values[0]]
                log.signals[group] = Signal(group, clock, leaves[values[0]].unit)
                continue
            for n in (*times, *values):
                log.signals[prefix + n] = Signal(prefix + n, clock, leaves[n].unit)
    if not log.signals:
        raise InputError("no signals (arrays of numbers with more than one value)", where=path)
    require_size(max(leaf.size for leaf in log.leaves.values()), len(log.leaves), path)
    return log
