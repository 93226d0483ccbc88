"""Samples: the one currency of the house. All that reads makes them, all that computes takes them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.errors import InputError

Column = NDArray[np.float64]


@dataclass(frozen=True)
class Channel:
    """One measured quantity: its name in the contract, SI unit and meaning."""

    name: str
    unit: str
    dimension: str
    meaning: str


CHANNELS: dict[str, Channel] = {
    c.name: c
    for c in (
        Channel("time", "s", "time", "time since the start of the log"),
        Channel("command", "rad/s", "angular_speed", "demanded pump speed"),
        Channel("pump_angle", "rad", "angle", "pump angle, accumulated"),
        Channel("pump_speed", "rad/s", "angular_speed", "pump speed"),
        Channel("position", "m", "length", "cylinder position"),
        Channel("pressure_difference", "Pa", "pressure", "chamber pressure difference P1 - P2"),
        Channel("pressure_1", "Pa", "pressure", "chamber 1 pressure, gauge"),
        Channel("pressure_2", "Pa", "pressure", "chamber 2 pressure, gauge"),
        Channel("pressure_accumulator", "Pa", "pressure", "accumulator pressure, gauge"),
        Channel("motor_current", "A", "current", "motor current"),
        Channel("oil_temperature", "°C", "temperature", "oil temperature"),
        Channel("load_force", "N", "force", "external load force on the rod"),
        Channel("position_setpoint", "m", "length", "position set-point of the outer loop"),
    )
}

PRESSURES = ("pressure_difference", "pressure_1", "pressure_2", "pressure_accumulator")


def missing_required(channels: Collection[str]) -> list[str]:
    """Groups of channels that a diagnosis cannot do without and that are absent."""
    there, both = set(channels), {"pressure_1", "pressure_2"}
    groups = {
        "position": "position" in there,
        "pump_angle (or pump_speed)": bool(there & {"pump_angle", "pump_speed"}),
        "pressure_difference (or pressure_1 and pressure_2)": "pressure_difference" in there or both <= there,
    }
    return [group for group, found in groups.items() if not found]


class Samples:
    """Columns of one log or of a block of one, validated on construction.

    Parameters
    ----------
    time : (n,) seconds, finite and strictly increasing.
    columns : channel name to (n,) values in the SI unit of `CHANNELS`; NaN where
        a value is missing. Infinite values are refused.

    Raises
    ------
    InputError : names the channel, the row and the reason.

    Examples
    --------
    >>> s = Samples([0.0, 0.001], {"position": [0.0, 1e-6]})
    >>> len(s), s.channels, s["position"][1]
    (2, ('position',), np.float64(1e-06))
    """

    __slots__ = ("_columns", "time")

    time: Column

    def __init__(self, time: ArrayLike, columns: Mapping[str, ArrayLike]) -> None:
        self.time = _column("time", time)
        finite = np.isfinite(self.time)
        if not finite.all():
            raise InputError(f"channel time, row {finite.argmin()}: not a finite number")
        backwards = np.flatnonzero(self.time[1:] <= self.time[:-1])
        if backwards.size:
            row = int(backwards[0]) + 1
            times = f"{self.time[row]:.6f} s after {self.time[row - 1]:.6f} s"
            problem = f"channel time, row {row}: {times}, time must increase"
            raise InputError(problem, mend="sort the log or cut it where its clock was reset")
        self._columns: dict[str, Column] = {}
        for name, values in columns.items():
            if name not in CHANNELS or name == "time":
                known = ", ".join(c for c in CHANNELS if c != "time")
                raise InputError(f"unknown channel {name!r}", mend=f"the channels are: {known}")
            column = _column(name, values)
            if column.size != len(self):
                raise InputError(f"channel {name}: {column.size} values for {len(self)} time stamps")
            infinite = np.isinf(column)
            if np.count_nonzero(infinite):  # of a short column in a fifth of the time of any()
                problem = f"channel {name}, row {infinite.argmax()}: infinite value"
                raise InputError(problem, mend="mark missing values as NaN")
            self._columns[name] = column

    def __len__(self) -> int:
        return int(self.time.size)

    def __contains__(self, name: str) -> bool:
        return name in self._columns

    def __getitem__(self, name: str) -> Column:
        return self._columns[name]

    def __repr__(self) -> str:
        if not len(self):
            return "Samples(empty)"
        span = f"{self.time[0]:.3f} to {self.time[-1]:.3f} s"
        return f"Samples({len(self)} rows, {span}, {', '.join(self.channels)})"

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels present, in the order they were given."""
        return tuple(self._columns)

    @property
    def columns(self) -> dict[str, Column]:
        """The columns by name (a new dict, the same arrays)."""
        return dict(self._columns)

    @property
    def duration(self) -> float:
        """Last time stamp minus the first (s)."""
        return float(self.time[-1] - self.time[0]) if len(self) else 0.0

    def get(self, name: str) -> Column:
        """The channel's column, or a column of NaN where the log has none."""
        found = self._columns.get(name)
        return np.full(len(self), np.nan) if found is None else found

    def rows(self, start: int, stop: int) -> Samples:
        """Rows ``start:stop`` as views."""
        part = object.__new__(Samples)
        part.time = self.time[start:stop]
        part._columns = {k: v[start:stop] for k, v in self._columns.items()}
        return part

    def without(self, rows: Mapping[str, NDArray[np.bool_]]) -> Samples:
        """A copy with NaN in these rows of these channels, (n,) each; the others are the same arrays."""
        part = self.rows(0, len(self))
        part._columns |= {name: np.where(out, np.nan, self[name]) for name, out in rows.items()}
        return part

    def blocks(self, size: int) -> Iterator[Samples]:
        """Consecutive blocks of at most `size` rows."""
        for start in range(0, len(self), size):
            yield self.rows(start, start + size)

    def with_columns(self, columns: Mapping[str, ArrayLike]) -> Samples:
        """A copy with these channels added or replaced."""
        return Samples(self.time, {**self._columns, **columns})

    @staticmethod
    def concatenate(parts: list[Samples]) -> Samples:
        """Join blocks in time order; a channel that a block lacks becomes NaN there."""
        names = list(dict.fromkeys(name for p in parts for name in p.channels))
        time = np.concatenate([p.time for p in parts]) if parts else np.empty(0)
        return Samples(time, {n: np.concatenate([p.get(n) for p in parts]) for n in names})


def _column(name: str, values: ArrayLike) -> Column:
    try:
        column = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"channel {name}: not numbers ({error})") from None
    if column.ndim != 1:
        raise InputError(f"channel {name}: {column.ndim} dimensions where one column is wanted")
    return column
