"""Arrays in groups (HDF5, MATLAB, TDMS, MDF, sheets of a workbook) as signals with clocks.

Arrays of one length in one group share the clock that stands beside them under a name like ``time`` or
``stamp``. A group that holds nothing but a value, its time and its unit is one signal, called as the group.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.formats.signals import LogFile, Signal, require_size, seconds_since
from fdd.logs.names import is_time_name, time_unit
from fdd.measures import measure
from fdd.samples import Column

_VALUES = ("value", "values", "data", "y", "signal", "samples")
_PERIODS = ("dt", "ts", "period", "sample_time", "sampletime")
_RATES = ("fs", "rate", "sample_rate", "samplerate")


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

    Attributes
    ----------
    leaves : by the signals' names, and the clocks' columns too.
    clocks : clock to the name of the leaf of its stamps.
    periods : clock to (s, rows), where the file gives a rate in place of stamps.
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
    """Signals of arrays by group, whose name is its path, "" for the top.

    Raises InputError: no arrays of more than one number, or more than is read.
    """
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
